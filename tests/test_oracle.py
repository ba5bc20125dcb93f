"""The oracle against itself, against closed forms, and against laws of its own kind.

Nothing here imports the package: if these tests fail, the ground truth is wrong.
"""
import meshes
import numpy as np
import oracle
import pytest
from meshes import BoxTree, Mesh, bumpy_sphere, dot, icosphere, norm

LIGHT = np.array([0.31, 0.53, 2.71])       # generic: no ray from it meets an edge exactly


def unit(x):
    return x / norm(x)


def chords(mesh, count, seed):
    """First interior segments of straight rays through a mesh: o, d (n,3), t_max (n,)."""
    rng = np.random.default_rng(seed)
    o = 3 * unit(rng.normal(size=(count, 3)))
    d = unit(0.7 * unit(rng.normal(size=(count, 3))) * rng.random((count, 1)) ** (1 / 3) - o)
    tree, skip = BoxTree([mesh]), np.full(count, -1)
    _, tri, t, _, _ = tree.closest(o, d, skip)
    o = o + t * d
    return o, d, tree.closest(o, d, tri)[2][:, 0]


def relative(a, b):
    """The project's error measure, sum |a - b| / sum b."""
    return np.abs(a - b).sum() / b.sum()


# ---- the tools ------------------------------------------------------------------------------

@pytest.mark.parametrize("mesh", [icosphere(3), bumpy_sphere(3, 0.2), meshes.box((-1, -2, 0), (1, 1, 3))])
def test_meshes_are_closed_and_wound_outward(mesh):
    edges = np.concatenate([mesh.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    assert set(map(tuple, edges)) == set(map(tuple, edges[:, ::-1]))
    assert len(set(map(tuple, edges))) == len(edges)
    p = mesh.corners
    assert dot(p[:, 0], np.cross(p[:, 1], p[:, 2])).sum() > 0
    if mesh.normals is not None:
        assert dot(mesh.normals[mesh.faces], mesh.facet_normals[:, None]).min() > 0.6


def test_bumpy_normals_are_those_of_the_surface():
    coarse, fine = (bumpy_sphere(level, 0.1) for level in (4, 5))
    error = [np.abs(unit(m.normals[m.faces].mean(1)) - m.facet_normals).max() for m in (coarse, fine)]
    assert error[1] < 0.55 * error[0] < 0.04        # facets tend to it as the edge


def test_box_tree_finds_the_hits_of_a_plain_loop():
    rng = np.random.default_rng(0)
    parts = [bumpy_sphere(2, 0.2), Mesh(icosphere(1).vertices + [2, 0, 0], icosphere(1).faces)]
    tree, p = BoxTree(parts), np.concatenate([m.corners for m in parts])
    o, d = rng.normal(size=(300, 3)), unit(rng.normal(size=(300, 3)))
    d[:3] = np.eye(3)
    length, skip = rng.uniform(0.5, 4, 300), rng.integers(-1, len(p), 300)
    ray, tri, tuv = tree.hits(o, d, length, skip)
    volume = [np.stack([dot(np.cross(p[None, :, i] - o[:, None], p[None, :, j] - o[:, None]),
                            d[:, None])[..., 0] for i, j in ((0, 1), (1, 2), (2, 0))])][0]
    ng = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    t = dot(p[None, :, 0] - o[:, None], ng)[..., 0] / (d @ ng.T)
    crossed = ((volume > 0).all(0) | (volume < 0).all(0)) & (t > 0) & (t < length[:, None])
    crossed[np.arange(300), skip] &= skip < 0
    assert len(ray) > 200
    assert sorted(zip(ray, tri)) == sorted(zip(*np.nonzero(crossed)))
    assert np.allclose(tuv[:, 0], t[ray, tri], atol=1e-12)
    point = p[tri, 0] + tuv[:, 1:2] * (p[tri, 1] - p[tri, 0]) + tuv[:, 2:] * (p[tri, 2] - p[tri, 0])
    assert np.allclose(point, o[ray] + tuv[:, :1] * d[ray], atol=1e-12)


@pytest.mark.parametrize("g", [-0.7, 0.0, 0.4, 0.9])
def test_phase_is_normalised_and_g_is_its_mean_cosine(g):
    x, w = np.polynomial.legendre.leggauss(400)
    assert np.isclose(2 * np.pi * w @ oracle.phase(g, x), 1, rtol=1e-12)
    assert np.isclose(2 * np.pi * w @ (x * oracle.phase(g, x)), g, atol=1e-12)


# ---- the integrand: laws at a point ---------------------------------------------------------

def random_meetings(eta, count=400, seed=1):
    """Random refracted light on a bumpy sphere and lines that meet it: patch, uv, x, s, o, d."""
    rng = np.random.default_rng(seed)
    patches = meshes.make_patches(bumpy_sphere(2, 0.1), eta)
    tri = rng.integers(0, len(patches.p), 20 * count)
    patch = meshes.Patch(*(x[tri] for x in patches))
    uv = rng.random((len(tri), 2))
    uv = np.where(uv.sum(1, keepdims=True) > 1, 1 - uv, uv)
    x = oracle.light_ray(patch, uv, LIGHT, eta)
    good = (dot(LIGHT - patch.p, patch.ng) > 0) & (x.c_l > 0.05) & (x.radicand > 0.05)
    good = np.flatnonzero(good & (dot(x.omega, patch.ng) < -0.05))[:count]
    assert len(good) == count
    patch = meshes.Patch(*(a[good] for a in patch))
    uv, x = uv[good], oracle.LightRay(*(a[good] for a in x))
    s, d = rng.uniform(0.2, 1.5, (count, 1)), unit(rng.normal(size=(count, 3)))
    return patch, uv, x, s, x.point + s * x.omega - 0.5 * d, d


@pytest.mark.parametrize("eta", [0.7, 1.0, 1.001, 1.5])
def test_gap_gradient_and_meeting_point(eta):
    patch, uv, x, s, o, d = random_meetings(eta)
    gap, gradient = oracle.beam_gap(patch, uv, LIGHT, eta, o, d)
    assert np.abs(gap).max() < 1e-13
    t_scaled, s_scaled, scale = oracle.meeting(x, o, d)
    assert np.allclose(t_scaled / scale, 0.5, rtol=1e-9)
    assert np.allclose(s_scaled / scale, s, rtol=1e-9)
    o, h = o + 0.1, 1e-5                            # the gradient holds off the curve, too
    gradient = oracle.beam_gap(patch, uv, LIGHT, eta, o, d)[1]
    for k in range(2):
        step = h * np.eye(2)[k]
        slope = (oracle.beam_gap(patch, uv + step, LIGHT, eta, o, d)[0]
                 - oracle.beam_gap(patch, uv - step, LIGHT, eta, o, d)[0]) / (2 * h)
        assert np.allclose(gradient[:, k], slope, atol=2e-8)


def snell_out(v, direction, patch, eta):
    """A ray from v inside, refracted out at the triangle's plane with its interpolated normal."""
    t = dot(patch.p - v, patch.ng) / dot(direction, patch.ng)
    point = v + t * direction
    a, b = point - patch.p, patch.area2
    u = dot(np.cross(a, patch.e2), patch.ng) / b
    w = dot(np.cross(patch.e1, a), patch.ng) / b
    n = unit(patch.n + u * patch.m1 + w * patch.m2)
    tangential = eta * (direction - dot(direction, n) * n)
    return point, tangential + n * np.sqrt(1 - dot(tangential, tangential))


def camera_side_d(patch, x, s, eta, h=1e-5):
    """D of the point form by definition: area at the light per solid angle at V, differences."""
    v, axis = x.point + s * x.omega, -x.omega
    a = unit(np.cross(axis, np.array([0.3, 0.5, 0.8])))
    landed = []
    for side in (a, np.cross(axis, a)):
        ends = []
        for sign in (1, -1):
            point, out = snell_out(v, unit(axis + sign * h * side), patch, eta)
            ends.append(point + out * dot(LIGHT - point, x.w_l) / dot(out, x.w_l))
        landed.append((ends[0] - ends[1]) / (2 * h))
    return np.abs(dot(np.cross(*landed), x.w_l))


@pytest.mark.parametrize("eta", [0.7, 1.1, 1.5, 2.0])
def test_curve_density_is_the_camera_side_density(eta):
    """T A2 |w.Ng| / d_L^2 / |grad g| dl/dt = (1 - F) eta^2 / D: holds kappa and |d x omega|, too."""
    patch, uv, x, s, o, d = random_meetings(eta)
    gradient = oracle.beam_gap(patch, uv, LIGHT, eta, o, d)[1]
    slope, h = norm(gradient), 1e-5
    tangent = gradient[:, ::-1] * [-1, 1] / slope
    ahead, back = (oracle.meeting(oracle.light_ray(patch, uv + k * h * tangent, LIGHT, eta), o, d)
                   for k in (1, -1))
    dt_dl = np.abs(ahead[0] / ahead[2] - back[0] / back[2]) / (2 * h)
    transmitted = (1 - oracle.interface(-x.w_l, x.n, eta)[0]) * x.c_l / x.c_v
    curve = transmitted * patch.area2 * np.abs(dot(x.omega, patch.ng)) / x.d_l ** 2 / slope / dt_dl
    point = transmitted * x.c_v / x.c_l * eta ** 2 / camera_side_d(patch, x, s, eta)
    assert np.allclose(curve, point, rtol=1e-4)
    assert np.median(np.abs(curve / point - 1)) < 1e-7


@pytest.mark.parametrize("eta", [0.7, 1.5])
def test_flat_and_sphere_d_of_the_design(eta):
    patch, uv, x, s, _, _ = random_meetings(eta)
    flat = meshes.Patch(patch.p, patch.e1, patch.e2, patch.ng, 0 * patch.ng, 0 * patch.ng,
                        patch.ng, patch.area2)
    x = oracle.light_ray(flat, uv, LIGHT, eta)
    good = (x.c_l > 0.05)[:, 0] & (x.radicand > 0.05)[:, 0]
    ratio = x.c_l / np.where(good[:, None], x.c_v, 1)
    formula = (s + eta * x.d_l) * (ratio * s + eta * x.d_l / ratio)
    assert good.sum() > 300
    assert np.allclose(formula[good], camera_side_d(flat, x, s, eta)[good], rtol=1e-6)
    # a patch that touches the unit sphere at P and whose normal turns as the sphere's does
    p = unit(patch.p)
    e1 = unit(np.cross(p, [0.1, 0.2, 0.9]))
    e2 = np.cross(p, e1)
    ball = meshes.Patch(p, e1, e2, p, e1, e2, p, np.ones((len(p), 1)))
    x = oracle.light_ray(ball, np.zeros((len(p), 2)), LIGHT, eta)
    good = (x.c_l > 0.05)[:, 0] & (x.radicand > 0.05)[:, 0]
    k = eta * x.c_v - x.c_l
    tangential = np.abs(1 - s * (k - x.c_l ** 2 / x.d_l) / (eta * np.maximum(x.radicand, 1e-9)))
    sagittal = np.abs(1 - s * (k - 1 / x.d_l) / eta)
    formula = eta ** 2 * x.d_l ** 2 * x.c_v / x.c_l * tangential * sagittal
    assert good.sum() > 150
    assert np.allclose(formula[good], camera_side_d(ball, x, s, eta)[good], rtol=1e-5, atol=1e-6)


# ---- radiance of segments against closed forms ----------------------------------------------

@pytest.mark.parametrize("mesh", [icosphere(3), bumpy_sphere(4, 0.05), bumpy_sphere(3, 0.3)])
def test_straight_line_at_eta_one(mesh):
    o, d, t_max = chords(mesh, 40, 2)
    medium = ([0.5, 0.9], [0.7, 0.2], 0.3, LIGHT, [10.0, 3.0], o, d, t_max)
    truth = oracle.straight_line_radiance(mesh, *medium)
    assert relative(oracle.straight_line_radiance(mesh, *medium, panels=1024), truth) < 1e-5
    curve = oracle.segment_radiance(mesh, 1.0, *medium)
    assert relative(curve, truth) < 3e-4
    assert abs(curve.sum() / truth.sum() - 1) < 1e-4
    facets = Mesh(mesh.vertices, mesh.faces)        # normals play no part
    assert np.array_equal(oracle.segment_radiance(facets, 1.0, *medium), curve)


def test_straight_line_in_a_sphere_against_the_exact_exit():
    """On a fine sphere the quadrature tends to the one with the analytic way out."""
    mesh = icosphere(5)
    o, d, t_max = chords(mesh, 10, 3)
    t, w = oracle._panels(np.linspace(0, 1, 65), 8)
    v = o[:, None] + (t_max[:, None] * t)[..., None] * d[:, None]
    r, u = norm(LIGHT - v), unit(LIGHT - v)
    way = -dot(v, u) + np.sqrt(np.maximum(dot(v, u) ** 2 - dot(v, v) + 1, 0))
    lit = dot(v + way * u, u) > 0
    value = lit * oracle.phase(0.3, dot(u, d[:, None])) / r ** 2
    value = value * np.exp(-0.7 * (way + (t_max[:, None] * t)[..., None]))
    truth = 0.5 * 10 * (value[..., 0] * w).sum(1) * t_max
    found = oracle.straight_line_radiance(mesh, 0.5, 0.7, 0.3, LIGHT, 10.0, o, d, t_max)
    assert relative(found[:, 0], truth) < 1e-3


@pytest.mark.parametrize("eta", [0.8, 1.0, 1.33, 2.5])
def test_water_surface(eta):
    """A wide flat mesh: 200 triangles of size 6, so it also holds the adaptive splitting."""
    grid, faces = meshes.triangle_grid(10)
    water = Mesh(np.column_stack([60 * grid - 25, 0 * grid[:, 0]]), faces)
    rng = np.random.default_rng(3)
    o, d = rng.uniform(-2, 2, (20, 3)), rng.normal(size=(20, 3))
    o[:, 2], d[:, 2] = -rng.uniform(0.02, 2, 20), -np.abs(d[:, 2]) / 2
    medium = ([0.5, 1.0], [0.7, 0.1], 0.4, np.array([0.3, 0.2, 2.0]), [10.0, 3.0],
              o, unit(d), rng.uniform(0.5, 4, 20))
    truth = oracle.plane_radiance(eta, *medium)
    assert relative(oracle.plane_radiance(eta, *medium, panels=64), truth) < 1e-12
    for normals in (None, np.tile([0, 0, 2.0], (len(water.vertices), 1))):
        curve = oracle.segment_radiance(Mesh(water.vertices, faces, normals), eta, *medium, 16)
        assert relative(curve, truth) < 3e-4
        assert np.abs(curve / truth - 1).max() < 3e-3


def sphere_segments(o, d):
    """Chords of the unit sphere along lines o + t d: o, t_max."""
    along = dot(o, d)
    half = np.sqrt(along ** 2 - dot(o, o) + 1)
    return o - (along + half) * d, 2 * half[:, 0]


@pytest.mark.parametrize("eta", [0.7, 1.05, 1.5])
def test_sphere_mesh_tends_to_the_sphere(eta):
    medium, o, d = ([0.5], [0.7], 0.3, LIGHT, [10.0]), *chords(icosphere(3), 60, 4)[:2]
    exact, t_max = sphere_segments(o, d)
    truth = oracle.sphere_radiance(1.0, eta, *medium, exact, d, t_max)
    assert relative(oracle.sphere_radiance(1.0, eta, *medium, exact, d, t_max, 50001), truth) < 1e-5
    error = []
    for level in (2, 4, 5):
        mesh = icosphere(level)
        _, tri, t, _, _ = BoxTree([mesh]).closest(exact - d, d, np.full(60, -1))
        start = exact + (t - 1) * d
        end = BoxTree([mesh]).closest(start, d, tri)[2][:, 0]
        error.append(oracle.segment_radiance(mesh, eta, *medium, start, d, end, 4) / truth - 1)
    error = [np.average(e[:, 0], weights=truth[:, 0]) for e in error], [
        np.average(np.abs(e[:, 0]), weights=truth[:, 0]) for e in error]
    assert abs(error[0][2]) < 4e-4 and abs(error[0][0]) < 6e-3
    assert error[1][2] < 0.2 * error[1][0] < 3e-3


def test_sphere_closed_form_against_the_point_form():
    """Where one root is found per point of the segment: quadrature over t with the sphere's D."""
    eta, far = 1.3, np.linalg.norm(LIGHT)
    axis = LIGHT / far
    side = unit(np.cross(axis, [1.0, 0.2, 0.1]))
    start = 0.55 * axis - 0.35 * side + 0.15 * np.cross(axis, side)
    d = unit(side + 0.2 * np.cross(axis, side) - 0.1 * axis)
    t, w = oracle._panels(np.linspace(0, 0.7, 9), 6)
    v = start + t[:, None] * d
    phi = np.arccos(1 / far) * np.linspace(-1, 1, 200001)[1:-1]
    total = 0
    for point, weight, way in zip(v, w, t):
        e = unit(point - (point @ axis) * axis)     # the great circle through light and V
        p = np.cos(phi)[:, None] * axis + np.sin(phi)[:, None] * e
        w_l, u = unit(LIGHT - p), unit(point - p)
        c_l, c_v = dot(w_l, p)[:, 0], -dot(u, p)[:, 0]
        turn = np.cross(axis, e)                    # sin of both angles, signed
        f = np.cross(w_l, p) @ turn + eta * np.cross(u, p) @ turn
        root = np.flatnonzero((f[1:] * f[:-1] < 0) & (c_l[1:] > 0) & (c_v[1:] > 0))
        assert len(root) == 1
        i = root[0]
        a = f[i] / (f[i] - f[i + 1])
        c_l, c_v = c_l[i] + a * (c_l[i + 1] - c_l[i]), c_v[i] + a * (c_v[i + 1] - c_v[i])
        p, u = unit(p[i] + a * (p[i + 1] - p[i])), u[i]
        d_l, d_v, k = norm(LIGHT - p)[0], norm(point - p)[0], eta * c_v - c_l
        big_d = eta ** 2 * d_l ** 2 * c_v / c_l * abs(1 - d_v * (k - 1 / d_l) / eta) * abs(
            1 - d_v * (k - c_l ** 2 / d_l) / (eta * c_v ** 2))
        fresnel = oracle.interface(-unit(LIGHT - p)[None], p[None], eta)[0][0, 0]
        total += (weight * (1 - fresnel) * eta ** 2 / big_d * oracle.phase(0.3, -u @ d)
                  * np.exp(-0.7 * (way + d_v)))
    truth = oracle.sphere_radiance(1.0, eta, 0.5, 0.7, 0.3, LIGHT, 10.0, start[None], d[None], [0.7])
    assert np.isclose(truth[0, 0], 5 * total, rtol=2e-5)


@pytest.mark.parametrize("eta", [0.75, 1.5])
def test_facets_against_the_point_form_with_the_flat_d(eta):
    """Every face of an icosahedron alone: Snell in its plane by bisection, kept if P is on it."""
    body = Mesh(icosphere(0).vertices, icosphere(0).faces)
    o, d, t_max = chords(body, 6, 5)
    share, count = (np.arange(20000) + 0.5) / 20000, 0
    truth = np.zeros(len(o))
    for corners, n in zip(body.corners, body.facet_normals):
        h_l = (LIGHT - corners[0]) @ n
        if h_l <= 0:
            continue
        count += 1
        t = t_max[:, None] * share
        v = o[:, None] + t[..., None] * d[:, None]
        h_v = -(v - corners[0]) @ n
        foot = LIGHT - h_l * n
        offset = v + h_v[..., None] * n - foot
        rho = norm(offset)[..., 0]
        lo, hi = 0 * rho, rho
        for _ in range(50):
            x = (lo + hi) / 2
            short = x / np.hypot(x, h_l) < eta * (rho - x) / np.hypot(rho - x, h_v)
            lo, hi = np.where(short, x, lo), np.where(short, hi, x)
        p = foot + (x / rho)[..., None] * offset
        on = np.all([dot(np.cross(corners[k - 2] - corners[k], p - corners[k]), n)[..., 0] > 0
                     for k in range(3)], axis=0)
        d_l, d_v = np.hypot(x, h_l), np.hypot(rho - x, h_v)
        c_l, c_v = h_l / d_l, h_v / d_v
        big_d = (d_v + eta * d_l) * (c_l / c_v * d_v + c_v / c_l * eta * d_l)
        through = 1 - (((c_l - eta * c_v) / (c_l + eta * c_v)) ** 2
                       + ((eta * c_l - c_v) / (eta * c_l + c_v)) ** 2) / 2
        cosine = -dot((v - p) / d_v[..., None], d[:, None])[..., 0]
        value = through * eta ** 2 / big_d * oracle.phase(0.3, cosine) * np.exp(-0.7 * (t + d_v))
        truth += 0.5 * 10 * (on * value).mean(1) * t_max
    curve = oracle.segment_radiance(body, eta, 0.5, 0.7, 0.3, LIGHT, 10.0, o, d, t_max, 16)[:, 0]
    assert count >= 5 and truth.min() > 0
    assert np.abs(curve / truth - 1).max() < 2e-3
    assert relative(curve, truth) < 5e-4


# ---- energy, shadows, convergence -----------------------------------------------------------

def light_through_tube(mesh, eta, light, o, d, length, radius, count, rng):
    """Mean radiance over a thin tube about a segment by random light rays, and its error.

    Shares with the oracle the records and the box tree, not the optics nor the integral."""
    p, n = mesh.corners, mesh.corner_normals(eta)
    double = norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]))[:, 0]
    lit = np.flatnonzero(dot(light - p[:, 0], mesh.facet_normals) > 0)
    tri = rng.choice(lit, count, p=double[lit] / double[lit].sum())
    bary = rng.dirichlet([1, 1, 1], count)
    point = np.einsum("nk,nkx->nx", bary, p[tri])
    normal = unit(np.einsum("nk,nkx->nx", bary, n[tri]))
    to_light, d_l = unit(light - point), norm(light - point)
    c_l = dot(to_light, normal)
    tangential = (c_l * normal - to_light) / eta
    c_v = np.sqrt(np.maximum(1 - dot(tangential, tangential), 0))
    omega = tangential - c_v * normal
    towards = -dot(omega, mesh.facet_normals[tri])
    r_s, r_p = (c_l - eta * c_v) / (c_l + eta * c_v), (eta * c_l - c_v) / (eta * c_l + c_v)
    power = (1 - (r_s ** 2 + r_p ** 2) / 2) * c_l * towards / np.maximum(c_v, 1e-9) / d_l ** 2
    power = power * ((c_l > 0) & (c_v > 0) & (towards > 0)) * double[lit].sum() / 2 / count
    away = point - o
    a, w = away - (away @ d)[:, None] * d, omega - (omega @ d)[:, None] * d
    root = np.maximum(dot(a, w) ** 2 - dot(w, w) * (dot(a, a) - radius ** 2), 0) ** 0.5
    ends = [(-dot(a, w) + sign * root) / dot(w, w) for sign in (-1, 1)]
    caps = np.sort([-(away @ d) / (omega @ d), (length - away @ d) / (omega @ d)], axis=0)[..., None]
    low, high = np.maximum(np.maximum(ends[0], caps[0]), 0), np.minimum(ends[1], caps[1])
    hit = np.flatnonzero((high > low) & (root > 0) & (power > 0))
    s, inside = ((low + high) / 2)[hit], (high - low)[hit]
    point, omega, tri = point[hit], omega[hit], tri[hit]
    v, tree = point + s * omega, BoxTree([mesh])
    free = [tree.clear(point, np.broadcast_to(light, v.shape), tri), tree.clear(point, v, tri)]
    value = 5 * power[hit] * inside * oracle.phase(0.3, -(omega @ d))[:, None]
    value = value * np.exp(-0.7 * (s + ((v - o) @ d)[:, None])) / (np.pi * radius ** 2)
    value = value * (free[0] & free[1])[:, None]
    shadowed = [(~f).mean() for f in free]
    return value.sum(), np.sqrt((value ** 2).sum()), shadowed


@pytest.mark.parametrize("amplitude, eta, seed", [(0.2, 1.5, 1), (0.5, 0.8, 11), (0.5, 1.3, 10)])
def test_energy_and_shadows_against_random_light_rays(amplitude, eta, seed):
    mesh, light = bumpy_sphere(3, amplitude), np.array([0.3, 1.5, 1.6])
    rng = np.random.default_rng(seed)
    d = unit(rng.normal(size=3))
    o, length, radius, count = -0.4 * d + 0.15 * rng.normal(size=3), 0.7, 0.08, 600
    x = unit(np.cross(d, [0.3, 0.9, 0.1]))
    r, turn = radius * np.sqrt((np.arange(count) + 0.5) / count), np.arange(count) * 2.39996323
    start = o + (r * np.cos(turn))[:, None] * x + (r * np.sin(turn))[:, None] * np.cross(d, x)
    along = np.tile(d, (count, 1))
    ray = BoxTree([mesh]).hits(start, along, np.full(count, np.inf), np.full(count, -1))
    assert (ray[2][:, 0] > length).all() and (np.bincount(ray[0], minlength=count) % 2 == 1).all()
    truth, error, _ = light_through_tube(mesh, eta, light, o, d, length, radius, 1_500_000, rng)
    value = oracle.segment_radiance(mesh, eta, 0.5, 0.7, 0.3, light, 10.0, start, along,
                                    np.full(count, length), 4)
    assert error < 0.03 * truth
    assert abs(value.mean() - truth) < 3 * error + value.std() / np.sqrt(count)


def test_screens_shadow_outside_and_inside():
    """Two half screens: what passes the one and what passes the other is what passes none."""
    mesh = bumpy_sphere(3, 0.05)
    o, d, t_max = chords(mesh, 20, 6)
    def radiance(*screens):
        return oracle.segment_radiance(mesh, 1.4, 0.5, 0.7, 0.0, LIGHT, 10.0, o, d, t_max, 4, screens)
    plain = radiance()
    for height, size in ((1.6, 3), (0.213, 2)):
        left, right = (meshes.box((x, -size, height), (x + size, size, height + 1e-6))
                       for x in (0.0517 - size, 0.0517))
        parts = radiance(left), radiance(right)
        above = o[:, 2] + np.minimum(t_max * d[:, 2], 0) > height      # before the inner screen
        shaded = radiance(left, right)
        assert np.allclose(parts[0] + parts[1], plain + shaded, rtol=1e-2)
        assert relative(parts[0] + parts[1], plain + shaded) < 1e-3
        assert 0.1 < parts[0].sum() / plain.sum() < 1
        if height > 1:
            assert np.all(shaded == 0)
        else:
            assert np.allclose(shaded[above], plain[above], rtol=2e-2) and above.any()


@pytest.mark.parametrize("mesh, eta", [(bumpy_sphere(3, 0.1), 1.5), (bumpy_sphere(3, 0.1), 0.75)])
def test_subdivision_converges(mesh, eta):
    o, d, t_max = chords(mesh, 60, 7)
    value = [oracle.segment_radiance(mesh, eta, 0.5, 0.7, 0.3, LIGHT, 10.0, o, d, t_max, m)
             for m in (1, 4, 16)]
    assert relative(value[1], value[2]) < 1e-3
    assert relative(value[0], value[2]) < 1e-2
    assert abs(value[1].sum() / value[2].sum() - 1) < 3e-4


def test_moved_and_scaled_scene():
    """Shift: the same radiance.  Scale by k with sigma / k: 1/k^2 (intensity per area)."""
    mesh = bumpy_sphere(3, 0.1)
    o, d, t_max = chords(mesh, 20, 8)
    plain = oracle.segment_radiance(mesh, 1.4, 0.5, 0.7, 0.3, LIGHT, 10.0, o, d, t_max, 4)
    move = np.array([1000.0, -500.0, 200.0])
    moved = Mesh(mesh.vertices + move, mesh.faces, mesh.normals)
    value = oracle.segment_radiance(moved, 1.4, 0.5, 0.7, 0.3, LIGHT + move, 10.0, o + move, d, t_max, 4)
    assert np.allclose(value, plain, rtol=1e-6)
    k = 1e3
    large = Mesh(k * mesh.vertices, mesh.faces, 3 * mesh.normals)
    value = oracle.segment_radiance(large, 1.4, 0.5 / k, 0.7 / k, 0.3, k * LIGHT, 10.0, k * o, d,
                                    k * t_max, 4)
    assert np.allclose(k ** 2 * value, plain, rtol=1e-9)


# ---- camera paths ---------------------------------------------------------------------------

def test_interface_obeys_snell_and_keeps_energy():
    rng = np.random.default_rng(9)
    d, n = unit(rng.normal(size=(500, 3))), unit(rng.normal(size=(500, 3)))
    fresnel, reflected, refracted, scale = oracle.interface(d, n, 1.5)
    out = (dot(d, n) > 0)[:, 0]
    index = np.where(out, 1 / 1.5, 1.5)[:, None]    # of the far side against the near one
    sine = norm(np.cross(d, n)) / index
    total = (sine > 1)[:, 0]
    assert np.all(out[total]) and 50 < total.sum() < 200
    assert np.all(fresnel[total] == 1) and np.all(fresnel[~total] < 1)
    assert np.allclose(norm(reflected), 1) and np.allclose(norm(refracted[~total]), 1)
    assert np.allclose(np.cross(refracted, n)[~total] * index[~total], np.cross(d, n)[~total])
    assert np.all(dot(refracted, n)[~total] * dot(d, n)[~total] > 0)
    assert np.allclose(np.cross(reflected, n), np.cross(d, n))
    assert np.allclose(dot(reflected, n), -dot(d, n)) and np.allclose(scale * index ** 2, 1)
    back = oracle.interface(-refracted[~total], n[~total], 1.5)      # F is the same both ways
    assert np.allclose(back[0], fresnel[~total]) and np.allclose(back[2], -d[~total])
    head_on = oracle.interface(np.array([[0, 0, -1.0]]), np.array([[0, 0, 1.0]]), 1.5)[0]
    assert np.isclose(head_on[0, 0], 0.04)


def test_slab_chain_has_the_weights_of_the_design():
    slab = oracle.Body(meshes.box((-50, -50, -1), (50, 50, 0)), 1.5, np.ones(2), np.array([0.7, 0.1]))
    d = unit(np.array([[0.6, 0.2, -0.7]]))
    o = np.array([[0.12, 0.23, 1.0]])
    fresnel = oracle.interface(d, np.array([[0, 0, 1.0]]), 1.5)[0][0, 0]
    cosine = np.sqrt(1 - (1 - d[0, 2] ** 2) / 1.5 ** 2)
    for bounces in range(5):
        legs = oracle.camera_segments([slab], o, d, bounces)
        assert len(legs.ray) == bounces + 1
        assert np.allclose(legs.t_max, 1 / cosine)
        k = np.arange(bounces + 1)[:, None]
        weight = (1 - fresnel) / 1.5 ** 2 * fresnel ** k * np.exp(-slab.sigma_t * k / cosine)
        assert np.allclose(legs.weight, weight, rtol=1e-12)
        assert np.allclose(legs.d[:, 2], cosine * (-1.0) ** (k[:, 0] + 1))


def test_leaving_one_slab_and_entering_another():
    upper = oracle.Body(meshes.box((-50, -50, -1), (50, 50, 0)), 1.5, np.ones(1), np.array([0.7]))
    lower = oracle.Body(meshes.box((-50, -50, -3), (50, 50, -2)), 1.33, np.ones(1), np.array([0.3]))
    o, d = np.array([[0.12, 0.23, 1.0]]), unit(np.array([[0.6, 0.2, -0.7]]))
    f = [oracle.interface(d, np.array([[0, 0, 1.0]]), eta)[0][0, 0] for eta in (1.5, 1.33)]
    assert len(oracle.camera_segments([upper, lower], o, d, 0).ray) == 1
    legs = oracle.camera_segments([upper, lower], o, d, 1)
    way = 1 / np.sqrt(1 - (1 - d[0, 2] ** 2) / 1.5 ** 2)
    direct = (1 - f[0]) ** 2 * np.exp(-0.7 * way) * (1 - f[1]) / 1.33 ** 2
    found = legs.weight[legs.body == 1][:, 0]
    # straight through; reflected in the lower; once up and down in the gap is one hit too many,
    # and so is the light path's return into the upper slab after the lower one's reflection
    assert np.isclose(found[0], direct, rtol=1e-12)
    once = direct * f[1] * np.exp(-0.3 / np.sqrt(1 - (1 - d[0, 2] ** 2) / 1.33 ** 2))
    assert len(found) == 2 and np.isclose(found[1], once, rtol=1e-12)
    wall = meshes.box((-50, -50, -1.6), (50, 50, -1.5))
    assert not (oracle.camera_segments([upper, lower], o, d, 1, [wall]).body == 1).any()


def test_total_reflection_keeps_the_weight():
    cube = oracle.Body(meshes.box((-50, -1, -1), (50, 1, 1)), 1.5, np.ones(1), np.array([0.7]))
    d = unit(np.array([[0.8, 0.011, -0.6]]))        # through the end face, then beyond critical
    legs = oracle.camera_segments([cube], np.array([[-51, 0.012, 0.5]]), d, 3)
    assert len(legs.ray) == 4
    passed = np.concatenate([[0], np.cumsum(legs.t_max)[:-1]])
    assert np.allclose(legs.weight[:, 0], legs.weight[0, 0] * np.exp(-0.7 * passed))


def test_eta_one_body_transmits_all_and_may_be_entered_again():
    mesh = bumpy_sphere(3, 0.5)
    body = oracle.Body(mesh, 1.0, np.array([0.5, 0.2]), np.array([0.7, 0.0]), 0.3)
    rng = np.random.default_rng(10)
    o = 4 * unit(rng.normal(size=(300, 3)))
    d = unit(0.9 * unit(rng.normal(size=(300, 3))) - o)
    ray, _, tuv = BoxTree([mesh]).hits(o, d, np.full(300, np.inf), np.full(300, -1))
    order = np.lexsort((tuv[:, 0], ray))
    ray, start, end = ray[order][::2], tuv[order, 0][::2], tuv[order, 0][1::2]
    legs = oracle.camera_segments([body], o, d, 5)
    order = np.lexsort((norm(legs.o - o[legs.ray])[:, 0], legs.ray))
    assert len(ray) > len(set(ray)) + 20            # some rays enter more than once
    assert np.array_equal(legs.ray[order], ray)
    assert np.allclose(legs.t_max[order], end - start)
    passed = np.array([(end - start)[:k][ray[:k] == ray[k]].sum() for k in range(len(ray))])
    assert np.allclose(legs.weight[order], np.exp(-passed[:, None] * body.sigma_t))
    value = oracle.camera_radiance([body], [(LIGHT, [10.0, 3.0])], o, d, 5, 4)
    straight = oracle.straight_line_radiance(
        mesh, body.sigma_s, body.sigma_t, 0.3, LIGHT, [10.0, 3.0], o[ray] + start[:, None] * d[ray],
        d[ray], end - start, 128)
    truth = np.zeros((300, 2))
    np.add.at(truth, ray, straight * np.exp(-passed[:, None] * body.sigma_t))
    assert relative(value, truth) < 1e-3


def test_lights_add_and_other_bodies_shadow():
    glass = oracle.Body(bumpy_sphere(3, 0.1), 1.4, np.array([0.5]), np.array([0.7]))
    other = Mesh(icosphere(2).vertices * 0.6 + 0.6 * LIGHT, icosphere(2).faces)
    o = np.array([[-4.0, 0.1, 0.2], [-4.0, 0.3, 0.1], [-4, 0.2, -0.6]])
    d = unit(np.array([[0.05, 0.12, 0.03]]) - o)
    lights = [(LIGHT, [10.0]), (np.array([-1.0, -2.5, 0.4]), [7.0])]
    both = oracle.camera_radiance([glass], lights, o, d, 2, 4)
    each = [oracle.camera_radiance([glass], [light], o, d, 2, 4) for light in lights]
    assert np.allclose(each[0] + each[1], both, rtol=1e-12) and min(e.min() for e in each) > 0
    # nothing seen through the front face alone grows with the bounces' bound but by more terms
    assert np.all(oracle.camera_radiance([glass], lights, o, d, 0, 4) < both)
    clear = oracle.Body(other, 1.2, np.array([0.0]), np.array([0.0]))
    shaded = [oracle.camera_radiance([glass, clear], lights, o, d, 0, 4),
              oracle.camera_radiance([glass], lights, o, d, 0, 4, [other])]
    assert np.allclose(shaded[0], shaded[1], rtol=1e-12)
    assert np.all(shaded[0] < oracle.camera_radiance([glass], lights, o, d, 0, 4))
    wall = meshes.box((-3, -5, -5), (-2.9, 5, 5))
    assert np.all(oracle.camera_radiance([glass], lights, o, d, 2, 4, [wall]) == 0)

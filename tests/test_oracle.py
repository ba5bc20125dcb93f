"""The oracle against closed forms, laws and itself.  Imports nothing of the package."""

from collections import namedtuple

import closed_forms
import meshes
import numpy as np
import oracle
import pytest
from comparison import bias, l1
from meshes import BoxTree, Mesh, bumpy_sphere, dot, icosphere, norm, unit
from oracle import Beams, Body, CameraRays, Medium

LIGHT = np.array([0.31, 0.53, 2.71])  # generic: no ray from it meets an edge exactly
GREY, WHITE_LIGHT = Medium(0.5, 0.7, 0.3), (LIGHT, 10.0)
COLOUR, COLOURED_LIGHT = Medium([0.5, 0.9], [0.7, 0.2], 0.3), (LIGHT, [10.0, 3.0])


def chords(mesh, count, seed):
    """First interior segments of straight rays through a mesh."""
    rng = np.random.default_rng(seed)
    o = 3 * unit(rng.normal(size=(count, 3)))
    d = unit(0.7 * unit(rng.normal(size=(count, 3))) * rng.random((count, 1)) ** (1 / 3) - o)
    _, tri, t, _, _ = BoxTree([mesh]).closest(o, d, np.full(count, -1))
    o = o + t * d
    return CameraRays(o, d, BoxTree([mesh]).closest(o, d, tri)[2][:, 0])


def slow(*values):
    """A case that ``make test-all`` runs, and ``make test`` doesn't: another of the same kind is quicker."""
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize("g", [-0.7, 0.0, 0.9])
def test_phase_is_normalised_and_g_is_its_mean_cosine(g):
    x, w = np.polynomial.legendre.leggauss(400)
    assert np.allclose(2 * np.pi * w @ (np.array([1 + 0 * x, x]) * oracle.phase(g, x)).T, [1, g])


def random_meetings(eta, count=400):
    """Random refracted light on a bumpy sphere and lines that meet it at s, t = 0.5."""
    rng = np.random.default_rng(1)
    patches = meshes.make_patches(bumpy_sphere(2, 0.1), eta)
    tri, uv = rng.integers(0, len(patches.p), 20 * count), rng.random((20 * count, 2))
    uv = np.where(uv.sum(1, keepdims=True) > 1, 1 - uv, uv)
    patch = meshes.take(patches, tri)
    x = oracle.light_ray(patch, uv, LIGHT, eta)
    good = (dot(LIGHT - patch.p, patch.ng) > 0) & (dot(x.omega, patch.ng) < -0.05)
    good = np.flatnonzero(good & (x.c_l > 0.1) & (x.radicand > 0.05))[:count]
    patch, uv, x = meshes.take(patch, good), uv[good], oracle.LightRay(*(a[good] for a in x))
    s, d = rng.uniform(0.2, 1.5, (count, 1)), unit(rng.normal(size=(count, 3)))
    return patch, uv, x, s, x.point + s * x.omega - 0.5 * d, d


@pytest.mark.parametrize("eta", [0.7, 1.0, 1.001, 1.5])
def test_gap_gradient_and_meeting_point(eta):
    patch, uv, x, s, o, d = random_meetings(eta)
    assert np.abs(oracle.beam_gap(patch, uv, LIGHT, eta, o, d)[0]).max() < 1e-13
    t_scaled, s_scaled, scale = oracle.meeting(x, o, d)
    assert np.allclose(t_scaled / scale, 0.5) and np.allclose(s_scaled / scale, s)
    o, h = o + 0.1, 1e-5  # the gradient holds off the curve, too
    gradient = oracle.beam_gap(patch, uv, LIGHT, eta, o, d)[1]
    for k in range(2):
        ends = [oracle.beam_gap(patch, uv + h * e, LIGHT, eta, o, d)[0] for e in (np.eye(2)[k], -np.eye(2)[k])]
        assert np.allclose(gradient[:, k], (ends[0] - ends[1]) / (2 * h), atol=2e-8)


def camera_side_d(patch, x, s, eta, h=1e-6):
    """D by its definition: area at the light per solid angle at V, by refracting rays out of V."""
    v, axis, landed = x.point + s * x.omega, -x.omega, []
    side = unit(np.cross(axis, np.array([0.3, 0.5, 0.8])))
    for turn in (side, np.cross(axis, side)):
        ends = []
        for direction in (unit(axis + h * turn), unit(axis - h * turn)):
            point = v + direction * dot(patch.p - v, patch.ng) / dot(direction, patch.ng)
            a = point - patch.p
            u = dot(np.cross(a, patch.e2), patch.ng) / patch.area2
            w = dot(np.cross(patch.e1, a), patch.ng) / patch.area2
            n = unit(patch.n + u * patch.m1 + w * patch.m2)
            tangential = eta * (direction - dot(direction, n) * n)
            out = tangential + n * np.sqrt(1 - dot(tangential, tangential))
            ends.append(point + out * dot(LIGHT - point, x.w_l) / dot(out, x.w_l))
        landed.append((ends[0] - ends[1]) / (2 * h))
    return np.abs(dot(np.cross(*landed), x.w_l))


@pytest.mark.parametrize("eta", [0.7, 1.1, 1.5, 2.0])
def test_curve_density_is_the_camera_side_density(eta):
    """T A2 |w.Ng| / d_L^2 / |grad g| dl/dt = (1 - F) eta^2 / D: kappa is right where n != Ng."""
    patch, uv, x, s, o, d = random_meetings(eta)
    gradient = oracle.beam_gap(patch, uv, LIGHT, eta, o, d)[1]
    slope, h = norm(gradient), 1e-6
    tangent = gradient[:, ::-1] * [-1, 1] / slope
    ahead, back = (oracle.meeting(oracle.light_ray(patch, uv + k * tangent, LIGHT, eta), o, d) for k in (h, -h))
    dt_dl = np.abs(ahead[0] / ahead[2] - back[0] / back[2]) / (2 * h)
    medium, rays = Medium(np.array([2.0]), np.array([0.3]), 0.6), CameraRays(o, d, np.full(len(o), 9.0))
    curve = oracle._integrand(Beams(patch, LIGHT, eta), rays, uv, medium, np.array([7.0])) / slope / dt_dl
    point = 14 * (1 - oracle.interface(-x.w_l, x.n, eta)[0]) * eta**2 * np.exp(-0.3 * (0.5 + s))
    point = point / camera_side_d(patch, x, s, eta) * oracle.phase(0.6, -dot(x.omega, d))
    assert np.allclose(curve, point, rtol=1e-4)
    assert np.median(np.abs(curve / point - 1)) < 1e-7


@pytest.mark.parametrize("eta", [0.7, 1.5])
def test_flat_and_sphere_d(eta):
    patch, uv, _, s, _, _ = random_meetings(eta)
    flat = patch._replace(n=patch.ng, m1=0 * patch.ng, m2=0 * patch.ng)
    p = unit(patch.p)  # the unit sphere to second order at P
    e1 = unit(np.cross(p, [0.1, 0.2, 0.9]))
    e2, zero, one = np.cross(p, e1), np.zeros_like(uv), np.ones((len(p), 1))
    for ball, uv in ((flat, uv), (meshes.Patch(p, e1, e2, p, e1, e2, p, one), zero)):
        x = oracle.light_ray(ball, uv, LIGHT, eta)
        good = ((x.c_l > 0.1) & (x.radicand > 0.05))[:, 0]
        c_l, c_v, d_l = x.c_l, np.maximum(x.c_v, 0.1), x.d_l
        if ball is flat:
            formula = (s + eta * d_l) * (c_l / c_v * s + c_v / c_l * eta * d_l)
        else:
            k = eta * c_v - c_l
            tangential = 1 - s * (k - c_l**2 / d_l) / (eta * c_v**2)
            sagittal = 1 - s * (k - 1 / d_l) / eta
            formula = eta**2 * d_l**2 * c_v / c_l * np.abs(tangential * sagittal)
        definition = camera_side_d(ball, x, s, eta)
        assert good.sum() > 100
        assert np.allclose(formula[good], definition[good], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("mesh", [icosphere(2), bumpy_sphere(3, 0.05), bumpy_sphere(3, 0.3)])
def test_straight_line_at_eta_one(mesh):
    rays = chords(mesh, 20, 2)
    truth = closed_forms.straight_line_radiance(mesh, COLOUR, COLOURED_LIGHT, rays)
    curve = oracle.segment_radiance(Body(mesh, 1.0, *COLOUR), COLOURED_LIGHT, rays, 4)
    assert l1(curve, truth) < 1e-4 and np.abs(curve / truth - 1).max() < 1e-3
    facets = Mesh(mesh.vertices, mesh.faces)  # normals play no part
    assert np.array_equal(oracle.segment_radiance(Body(facets, 1.0, *COLOUR), COLOURED_LIGHT, rays, 4), curve)


@pytest.mark.parametrize("eta", [0.8, 1.0, 1.33, 2.5])
def test_water_surface(eta):
    """A wide flat mesh of 100 triangles of size 6: holds the adaptive splitting, and the facets."""
    (grid, faces), rng = meshes.triangle_grid(10), np.random.default_rng(3)
    water = np.column_stack([60 * grid - 25, 0 * grid[:, 0]])
    o, d = rng.uniform(-2, 2, (20, 3)), rng.normal(size=(20, 3))
    o[:, 2], d[:, 2] = -rng.uniform(0.02, 2, 20), -np.abs(d[:, 2]) / 2
    light, rays = (np.array([0.3, 0.2, 2.0]), [10.0, 3.0]), CameraRays(o, unit(d), rng.uniform(0.5, 4, 20))
    truth = closed_forms.plane_radiance(eta, COLOUR, light, rays)
    assert l1(closed_forms.plane_radiance(eta, COLOUR, light, rays, steps=64), truth) < 1e-12
    for normals in (None, np.tile([0, 0, 2.0], (len(water), 1))):
        curve = oracle.segment_radiance(Body(Mesh(water, faces, normals), eta, *COLOUR), light, rays, 16)
        assert l1(curve, truth) < 1e-5 and np.abs(curve / truth - 1).max() < 3e-4


@pytest.mark.parametrize("eta", [slow(0.7), slow(1.05), 1.5])
def test_sphere_mesh_tends_to_the_sphere(eta):
    rng, count, error = np.random.default_rng(4), 40, []
    d = unit(rng.normal(size=(count, 3)))
    middle = 0.7 * np.cross(d, unit(rng.normal(size=(count, 3))))
    half = np.sqrt(1 - dot(middle, middle))
    rays = CameraRays(middle - half * d, d, 2 * half[:, 0])
    truth = closed_forms.sphere_radiance(1.0, eta, GREY, WHITE_LIGHT, rays)
    assert l1(closed_forms.sphere_radiance(1.0, eta, GREY, WHITE_LIGHT, rays, 50001), truth) < 1e-5
    for mesh in map(icosphere, (3, 5)):
        _, tri, t, _, _ = BoxTree([mesh]).closest(middle - 2 * d, d, np.full(count, -1))
        start = middle + (t - 2) * d
        end = BoxTree([mesh]).closest(start, d, tri)[2][:, 0]
        value = oracle.segment_radiance(Body(mesh, eta, *GREY), WHITE_LIGHT, CameraRays(start, d, end), 1)
        error.append(l1(value, truth))
    assert abs(bias(value, truth)) < 1e-3 and error[1] < 0.2 * error[0] < 4e-3


# A thin cylinder from o (3,) on along d (3,), which stands for the camera rays in it.
Tube = namedtuple("Tube", "o d length radius")


def light_through_tube(mesh, eta, light, tube, count, rng):
    """Mean radiance over a tube by random light rays, and its error; own optics, no curve."""
    o, d, length, radius = tube
    p, n = mesh.corners, mesh.corner_normals(eta)
    double = meshes.make_patches(mesh, eta).area2[:, 0]
    lit = np.flatnonzero(dot(light - p[:, 0], mesh.facet_normals) > 0)
    area, bary = double[lit].sum() / 2, rng.dirichlet([1, 1, 1], count)
    tri = rng.choice(lit, count, p=double[lit] / 2 / area)
    point, normal = (np.einsum("nk,nkx->nx", bary, x[tri]) for x in (p, n))
    normal = unit(normal)
    to_light, d_l = unit(light - point), norm(light - point)
    c_l = dot(to_light, normal)
    tangential = (c_l * normal - to_light) / eta
    c_v = np.sqrt(np.maximum(1 - dot(tangential, tangential), 0))
    omega = tangential - c_v * normal
    towards = -dot(omega, mesh.facet_normals[tri])
    r_s, r_p = (c_l - eta * c_v) / (c_l + eta * c_v), (eta * c_l - c_v) / (eta * c_l + c_v)
    power = (1 - (r_s**2 + r_p**2) / 2) * c_l * towards / np.maximum(c_v, 1e-9) / d_l**2
    power = power * ((c_l > 0) & (c_v > 0) & (towards > 0)) * area / count
    away = point - o
    a, w = away - (away @ d)[:, None] * d, omega - (omega @ d)[:, None] * d
    root = np.maximum(dot(a, w) ** 2 - dot(w, w) * (dot(a, a) - radius**2), 0) ** 0.5
    ends = [(-dot(a, w) + sign * root) / dot(w, w) for sign in (-1, 1)]
    caps = np.sort([(x - away @ d) / (omega @ d) for x in (0, length)], axis=0)[..., None]
    low, high = np.maximum(np.maximum(ends[0], caps[0]), 0), np.minimum(ends[1], caps[1])
    hit = np.flatnonzero((high > low) & (root > 0) & (power > 0))
    point, omega, tri, low, high, power = (x[hit] for x in (point, omega, tri, low, high, power))
    tree, s = BoxTree([mesh]), (low + high) / 2
    v = point + s * omega
    free = tree.clear(point, np.broadcast_to(light, v.shape), tri) & tree.clear(point, v, tri)
    value = 5 * power * (high - low) * oracle.phase(0.3, -(omega @ d))[:, None] * free[:, None]
    value = value * np.exp(-0.7 * (s + ((v - o) @ d)[:, None])) / (np.pi * radius**2)
    return value.sum(), np.sqrt((value**2).sum())


@pytest.mark.parametrize(
    "amplitude, eta, smooth, seed",
    [(0.2, 1.5, True, 4), slow(0.5, 0.8, True, 12), slow(0.5, 1.3, True, 10), (0.2, 1.4, False, 1)],
)
def test_energy_and_shadows_against_random_light_rays(amplitude, eta, smooth, seed):
    mesh, light = bumpy_sphere(2, amplitude), np.array([0.3, 1.5, 1.6])
    mesh, rng = mesh if smooth else Mesh(mesh.vertices, mesh.faces), np.random.default_rng(seed)
    d = unit(rng.normal(size=3))
    o, length, radius, count = -0.4 * d + 0.15 * rng.normal(size=3), 0.7, 0.08, 100
    x, k = unit(np.cross(d, [0.3, 0.9, 0.1])), np.arange(count)
    r, turn = radius * np.sqrt((k + 0.5) / count), k * 2.39996323
    start = o + (r * np.cos(turn))[:, None] * x + (r * np.sin(turn))[:, None] * np.cross(d, x)
    along = np.tile(d, (count, 1))
    ray, _, tuv = BoxTree([mesh]).hits(start, along, np.full(count, np.inf), np.full(count, -1))
    assert (tuv[:, 0] > length).all() and (np.bincount(ray, minlength=count) % 2 == 1).all()
    truth, error = light_through_tube(mesh, eta, light, Tube(o, d, length, radius), 400_000, rng)
    rays = CameraRays(start, along, np.full(count, length))
    value = oracle.segment_radiance(Body(mesh, eta, *GREY), (light, 10.0), rays, 4)
    assert error < 0.04 * truth
    assert abs(value.mean() - truth) < 3 * error + value.std() / np.sqrt(count)


def test_screens_shadow_outside_and_inside():
    """Two half screens: one + other = none + both, as each ray meets one of them at most."""
    mesh = bumpy_sphere(3, 0.05)
    o, d, t_max = rays = chords(mesh, 20, 6)
    body = Body(mesh, 1.4, *GREY)
    plain = oracle.segment_radiance(body, WHITE_LIGHT, rays, 4)
    for height, size in ((1.6, 3), (-0.213, 2)):
        left, right = (meshes.box((x, -size, height), (x + size, size, height + 1e-6)) for x in (0.0517 - size, 0.0517))
        one, other, both = (
            oracle.segment_radiance(body, WHITE_LIGHT, rays, 4, screens)
            for screens in ((left,), (right,), (left, right))
        )
        assert l1(one + other, plain + both) < 1e-4
        assert 0.1 < one.sum() / plain.sum() < 0.9
        above = (o[:, 2] > height) & (o[:, 2] + t_max * d[:, 2] > height)  # of the inner screen
        assert above.sum() == 0 if height > 1 else above.sum() > 3
        assert np.allclose(both[above], plain[above]) and (height < 1 or np.all(both == 0))


@pytest.mark.parametrize("level, eta", [(1, 1.5), slow(3, 1.5), (2, 0.75)])
def test_subdivision_converges_and_segments_add(level, eta):
    mesh = bumpy_sphere(level, 0.1)
    body, rays = Body(mesh, eta, *GREY), chords(mesh, 100, 7).take(slice(20))  # two at the critical angle
    value = [oracle.segment_radiance(body, WHITE_LIGHT, rays, m) for m in (1, 4, 12)]
    assert l1(value[0], value[2]) < 1e-3
    assert l1(value[1], value[2]) < 5e-5 and np.abs(value[1] / value[2] - 1).max() < 1e-3
    parts, count, (o, d, t_max) = 0, 4, rays
    for k in range(count):
        start = (t_max * k / count)[:, None]
        part = CameraRays(o + start * d, d, t_max / count)
        parts = parts + np.exp(-0.7 * start) * oracle.segment_radiance(body, WHITE_LIGHT, part, 4)
    assert l1(parts, value[1]) < 1e-4


def test_moved_and_scaled_scene():
    mesh, move, k = bumpy_sphere(3, 0.1), np.array([1000.0, -500.0, 200.0]), 1e3
    o, d, t_max = rays = chords(mesh, 20, 8)
    plain = oracle.segment_radiance(Body(mesh, 1.4, *GREY), WHITE_LIGHT, rays, 4)
    there = Body(Mesh(mesh.vertices + move, mesh.faces, mesh.normals), 1.4, *GREY)
    moved = oracle.segment_radiance(there, (LIGHT + move, 10.0), CameraRays(o + move, d, t_max), 4)
    assert np.allclose(moved, plain, rtol=1e-6)
    giant = Body(Mesh(k * mesh.vertices, mesh.faces, 3 * mesh.normals), 1.4, 0.5 / k, 0.7 / k, 0.3)
    large = oracle.segment_radiance(giant, (k * LIGHT, 10.0), CameraRays(k * o, d, k * t_max), 4)
    assert np.allclose(k**2 * large, plain, rtol=1e-6)  # intensity per area


def test_interface_obeys_snell_and_keeps_energy():
    rng = np.random.default_rng(9)
    d, n = unit(rng.normal(size=(500, 3))), unit(rng.normal(size=(500, 3)))
    fresnel, reflected, refracted, scale = oracle.interface(d, n, 1.5)
    out = (dot(d, n) > 0)[:, 0]
    index = np.where(out, 1 / 1.5, 1.5)[:, None]  # of the far side against the near one
    total = (norm(np.cross(d, n)) > index)[:, 0]
    assert np.all(out[total]) and 50 < total.sum() < 250
    assert np.all(fresnel[total] == 1) and np.all(fresnel[~total] < 1)
    assert np.allclose(reflected, d - 2 * dot(d, n) * n) and np.allclose(scale * index**2, 1)
    d, n, fresnel, refracted, index = (x[~total] for x in (d, n, fresnel, refracted, index))
    assert np.allclose(norm(refracted), 1) and np.all(dot(refracted, n) * dot(d, n) > 0)
    assert np.allclose(np.cross(refracted, n) * index, np.cross(d, n))
    back = oracle.interface(-refracted, n, 1.5)  # F is the same both ways
    assert np.allclose(back[0], fresnel) and np.allclose(back[2], -d)
    assert np.allclose(oracle.interface(-n, n, 1.5)[0], 0.04)


def slab(top, eta, sigma_t):
    return Body(meshes.box((-50, -50, top - 1), (50, 50, top)), eta, np.ones(2), sigma_t)


O, D = np.array([[0.12, 0.23, 1.0]]), unit(np.array([[0.6, 0.2, -0.7]]))


def through(eta):
    """Reflectance of a horizontal face for D, and the length of D's way through a slab."""
    way = 1 / np.sqrt(1 - (1 - D[0, 2] ** 2) / eta**2)
    return oracle.interface(D, np.array([[0, 0, 1.0]]), eta)[0][0, 0], way


@pytest.mark.parametrize("bounces", range(4))
def test_slab_chain_has_the_weights_of_the_formulas(bounces):
    body, (f, way) = slab(0, 1.5, np.array([0.7, 0.1])), through(1.5)
    legs, k = oracle.camera_segments([body], O, D, bounces), np.arange(bounces + 1)[:, None]
    weight = (1 - f) / 1.5**2 * f**k * np.exp(-body.sigma_t * k * way)
    assert legs.weight.shape == weight.shape and np.allclose(legs.weight, weight, rtol=1e-12)
    assert np.allclose(legs.t_max, way) and np.allclose(legs.d[:, 2], (-1.0) ** (k[:, 0] + 1) / way)


def test_leaving_one_slab_and_entering_another():
    bodies = [slab(0, 1.5, np.array([0.7, 0.7])), slab(-2, 1.33, np.array([0.3, 0.3]))]
    (f, way), (f2, way2) = through(1.5), through(1.33)
    assert len(oracle.camera_segments(bodies, O, D, 0).ray) == 1
    legs = oracle.camera_segments(bodies, O, D, 1)
    direct = (1 - f) ** 2 * np.exp(-0.7 * way) * (1 - f2) / 1.33**2
    again = direct * f2 * np.exp(-0.3 * way2)
    # the lower slab down and up; other ways into it hit from outside or reflect too often
    assert np.allclose(legs.weight[legs.body == 1][:, 0], [direct, again])
    wall = meshes.box((-50, -50, -1.6), (50, 50, -1.5))
    assert not (oracle.camera_segments(bodies, O, D, 1, [wall]).body == 1).any()


def test_total_reflection_keeps_the_weight():
    cube = Body(meshes.box((-50, -1, -1), (50, 1, 1)), 1.5, np.ones(1), np.array([0.7]))
    o, d = np.array([[-51, 0.012, 0.5]]), unit(np.array([[0.8, 0.011, -0.6]]))  # by the end face
    legs = oracle.camera_segments([cube], o, d, 3)
    passed = np.concatenate([[0], np.cumsum(legs.t_max)[:-1]])
    assert len(passed) == 4
    assert np.allclose(legs.weight[:, 0] / legs.weight[0, 0], np.exp(-0.7 * passed))


def test_eta_one_body_transmits_all_and_may_be_entered_again():
    mesh, rng = bumpy_sphere(2, 0.5), np.random.default_rng(10)
    body = Body(mesh, 1.0, np.array([0.5, 0.2]), np.array([0.7, 0.0]), 0.3)
    o = 4 * unit(rng.normal(size=(60, 3)))
    d = unit(0.9 * unit(rng.normal(size=(60, 3))) - o)
    ray, _, tuv = BoxTree([mesh]).hits(o, d, np.full(60, np.inf), np.full(60, -1))
    order, legs = np.lexsort((tuv[:, 0], ray)), oracle.camera_segments([body], o, d, 5)
    ray, start, end = ray[order][::2], tuv[order, 0][::2], tuv[order, 0][1::2]
    order = np.lexsort((norm(legs.o - o[legs.ray])[:, 0], legs.ray))
    assert len(ray) > len(set(ray)) + 5 and np.array_equal(legs.ray[order], ray)
    assert np.allclose(legs.t_max[order], end - start)
    passed = np.array([(end - start)[:k][ray[:k] == ray[k]].sum() for k in range(len(ray))])
    weight = np.exp(-passed[:, None] * body.sigma_t)
    assert np.allclose(legs.weight[order], weight)
    truth, rays = np.zeros((60, 2)), CameraRays(o[ray] + start[:, None] * d[ray], d[ray], end - start)
    np.add.at(truth, ray, weight * closed_forms.straight_line_radiance(mesh, body, COLOURED_LIGHT, rays, 64))
    value = oracle.camera_radiance([body], [COLOURED_LIGHT], o, d, 5, 4)
    assert l1(value, truth) < 5e-4


def test_lights_add_and_other_bodies_shadow():
    glass = Body(bumpy_sphere(2, 0.1), 1.4, np.array([0.5]), np.array([0.7]))
    ball = Mesh(icosphere(2).vertices * 0.6 + 0.6 * LIGHT, icosphere(2).faces)
    clear = Body(ball, 1.2, np.array([0.0]), np.array([0.0]))
    o = np.array([[-4.0, 0.1, 0.2], [-4.0, 0.3, 0.1], [-4, 0.2, -0.6]])
    d = unit([0.05, 0.12, 0.03] - o)
    lights = [(LIGHT, [10.0]), (np.array([-1.0, -2.5, 0.4]), [7.0])]

    def radiance(bodies, lights, bounces, *opaque):
        return oracle.camera_radiance(bodies, lights, o, d, bounces, 4, opaque=opaque)

    both, each = radiance([glass], lights, 2), [radiance([glass], [x], 2) for x in lights]
    assert np.allclose(each[0] + each[1], both, rtol=1e-12) and np.min(each) > 0
    once, shaded = radiance([glass], lights, 0), radiance([glass, clear], lights, 0)
    assert np.allclose(shaded, radiance([glass], lights, 0, ball), rtol=1e-12)
    assert np.all(shaded < once) and np.all(once < both)
    assert np.all(radiance([glass], lights, 2, meshes.box((-3, -5, -5), (-2.9, 5, 5))) == 0)

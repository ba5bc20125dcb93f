"""Light beams that are quadratic between their nodes: bounds lose nothing, sums are integrals, and refinement keeps
flux and error."""

from dataclasses import replace

import drjit as dr
import meshes
import mitsuba as mi
import numpy as np
import pytest
from build import mesh_shape, point_light, slow_ones
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pairs import bevelled_box
from test_scene_kinds_against_volpath import ball_light, empty, glass, sky, spot, sun, to

from mitsuba_refscatter import example_scenes, probing, tolerances
from mitsuba_refscatter.core.cache import Cache
from mitsuba_refscatter.culling import beam_tree, light_beams
from mitsuba_refscatter.culling.bundles import bundles_of
from mitsuba_refscatter.estimators import wavefront
from mitsuba_refscatter.estimators.beam_curve import BeamCurve
from mitsuba_refscatter.geometry import bvh
from mitsuba_refscatter.integrators.hooks import Hooks
from mitsuba_refscatter.integrators.prepared import prepare
from mitsuba_refscatter.light import beams, light_samples, refinement
from mitsuba_refscatter.optics import LocalLight
from mitsuba_refscatter.options import Options
from mitsuba_refscatter.transport.segments import LocalSegments

pytestmark = pytest.mark.usefixtures("rgb")

SLOW = pytest.mark.slow
NODES = np.array([(0, 0), (1, 0), (0, 1), (0.5, 0), (0.5, 0.5), (0, 0.5)])


class Everywhere:
    """What the estimator asks of an illumination that is the same everywhere."""

    emission = None

    @property
    def light(self):
        return LocalLight(mi.Point3f(0, 0, 5))

    def at(self, _segment):
        return self

    def phase(self, _omega, _d):
        return mi.Float(1 / (4 * np.pi))

    def extinction(self, sigma_t, _omega, _d):
        return sigma_t


class Bounds:
    """What the tree's bounds ask of a body."""

    box_low, box_high = [-20.0] * 3, [20.0] * 3


def random_beams(rng, n, bend):
    """Values at the nodes of n cells of edge 0.3 at the origin with light that goes about along -z, each (n, 6, k)."""
    corner = rng.normal(size=(n, 1, 3)) * (0.5, 0.5, 0)
    edges = rng.normal(size=(n, 2, 3)) * 0.3
    P = corner + NODES @ edges + bend * rng.normal(size=(n, 6, 3)) * 0.03
    omega = np.array([0, 0, -1]) + 0.2 * rng.normal(size=(n, 1, 3)) + NODES @ (0.3 * rng.normal(size=(n, 2, 3)))
    omega += bend * 0.05 * rng.normal(size=(n, 6, 3))
    omega /= np.linalg.norm(omega, axis=2, keepdims=True)
    phi = 1 + NODES @ rng.uniform(-0.4, 0.4, (n, 2, 1)) + bend * 0.05 * rng.normal(size=(n, 6, 1))
    length = 3 + NODES @ rng.uniform(-1, 1, (n, 2, 1))
    return [x.astype(np.float32) for x in (P, omega, phi, length)]


def packed(P, omega, phi, length):
    """``LightBeams`` of values at nodes, with their tree."""
    n = len(P)
    vectors = [[mi.Vector3f(x[:, k].T) for k in range(6)] for x in (P, omega)]
    scalars = [[mi.Float(x[:, k, 0]) for k in range(6)] for x in (phi, length)]
    room = -(-n // bvh.LEAF) * bvh.LEAF
    order = dr.minimum(dr.arange(mi.UInt32, room), n - 1)
    exists = dr.arange(mi.UInt32, room) < n
    numbers = beams.pack(*[[dr.gather(type(v), v, order) for v in x] for x in (*vectors, *scalars)], exists)
    records = dr.empty(mi.Float, room * beams.BEAM)
    beams.write(records, numbers, 0, room)
    dr.eval(records)
    tree = beam_tree.tree_of(n, lambda index: light_beams.bounds(beams.LightBeams.gather(records, index), Bounds))
    return light_beams.LightBeams(records, tree, 0.3, 0.0)


def quadratic(uv, nodes):
    """The quadratic through values at the nodes (6, ...) at points uv (m, 2), in float64 and barycentric form."""
    w = np.column_stack([1 - uv.sum(1), uv])
    shape = np.column_stack([w * (2 * w - 1), 4 * w[:, 0] * w[:, 1], 4 * w[:, 1] * w[:, 2], 4 * w[:, 2] * w[:, 0]])
    return shape @ nodes


def lines_at(P, omega, uv):
    """(omega, m) of the light lines at points uv (m, 2)."""
    P, omega = P.astype(float), omega.astype(float)
    return quadratic(uv, omega), quadratic(uv, np.cross(P, omega))


def grid(n):
    """Corners of n^2 equal triangles of the unit triangle, (n^2, 3, 2)."""
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    up = np.stack([np.stack([i + a, j + b], -1)[i + j < n] for a, b in ((0, 0), (1, 0), (0, 1))], 1)
    down = np.stack([np.stack([i + a, j + b], -1)[i + j < n - 1] for a, b in ((1, 1), (0, 1), (1, 0))], 1)
    return np.concatenate([up, down]) / n


def integral(values, ray, sigma_t, n):
    """The sum over fine plane triangles of F / |grad g| along g = 0: by where a linear g vanishes on their edges."""
    (P, omega, phi, length), (o, d, t_max) = values, ray
    uv = grid(n)
    flat = uv.reshape(-1, 2)
    W, M = lines_at(P, omega, flat)
    g = (-(M @ d) - W @ np.cross(o, d)).reshape(-1, 3)
    crossing = (g.min(1) < 0) & (g.max(1) >= 0)
    total, uv, g = 0.0, uv[crossing], g[crossing]
    for corners, values in zip(uv, g):
        alone = np.argmax(np.abs(np.sign(values) - np.median(np.sign(values))) > 0)
        a, b, c = (values[(alone + k) % 3] for k in range(3))
        A, B, C = (corners[(alone + k) % 3] for k in range(3))
        ends = [A + a / (a - b) * (B - A), A + a / (a - c) * (C - A)]
        area = 1 / n**2
        measure = area * abs(a) / abs((a - b) * (a - c)) if a != 0 else 0.0
        middle = 0.5 * (ends[0] + ends[1])[None]
        (w,), (m,) = lines_at(P, omega, middle)
        bary = np.array([1 - middle.sum(), *middle[0]])
        shape = np.array([*(bary * (2 * bary - 1)), *(4 * bary * np.roll(bary, -1))])
        normal, size = np.cross(d, w), np.linalg.norm(w)
        t = (m - np.cross(o, w)) @ normal / (normal @ normal)
        e = np.einsum("ki,ki->k", P.astype(float), omega.astype(float))
        s = ((o + t * d) @ w - shape @ e) / size
        if 0 < t < t_max and 0 < s < shape @ length[:, 0]:
            total += measure * (shape @ phi[:, 0]) * size / (4 * np.pi) * np.exp(-sigma_t * (t + s))
    return total


def random_segments(rng, n):
    o = rng.normal(size=(n, 3)) * 0.6 + (0, 0, -1.0)
    d = rng.normal(size=(n, 3)) * (1, 1, 0.4)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return o.astype(np.float32), d.astype(np.float32), rng.uniform(0.5, 3, n).astype(np.float32)


def local(o, d, t_max, sigma_t=0.5):
    return LocalSegments(mi.Point3f(o.T), mi.Vector3f(d.T), mi.Float(t_max), mi.Spectrum(sigma_t))


@pytest.mark.parametrize("bend", [pytest.param(0.0, marks=SLOW), 0.5, pytest.param(2.0, marks=SLOW)])
def test_sums_are_integrals(bend):
    """Of single beams, nearly linear to strongly bent, against fine triangles in float64: curves that cut a beam once,
    several times, not at all, and closed ones."""
    rng = np.random.default_rng(int(10 * bend))
    n = 24
    values, rays = random_beams(rng, n, bend), random_segments(rng, 40)
    accuracy = tolerances.accuracy(1e-4)
    found, expected = np.zeros((n, 40)), np.zeros((n, 40))
    for i in range(n):
        one = [x[i : i + 1] for x in values]
        sums, _ = wavefront.scatter(local(*rays), packed(*one), Everywhere(), BeamCurve(), wavefront.Run(accuracy))
        found[i] = np.array(sums.value)[0]
        expected[i] = [integral([x[0] for x in one], ray, 0.5, 96) for ray in zip(*(x.astype(float) for x in rays))]
    assert (expected > 0).sum() > 60
    assert np.abs(found - expected).sum() < 4e-3 * expected.sum()
    assert abs(found.sum() / expected.sum() - 1) < 2e-3


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**31), bend=st.sampled_from([0.0, 0.25, 0.5]))
def test_no_beam_is_lost(rgb, seed, bend):
    """Every beam on which g changes its sign, and t and s are right there, is found by the tree and by the test after
    it. Most beams are not."""
    rng = np.random.default_rng(seed)
    values, (o, d, t_max) = random_beams(rng, 61, bend), random_segments(rng, 48)
    culling, segments = packed(*values), local(o, d, t_max)
    work = wavefront.Work(wavefront.Sums.nothing(48), segments, bundles_of(segments, culling.bundle, culling.width),
                          culling, Everywhere(), tolerances.accuracy(0.01), BeamCurve())  # fmt: skip
    lane, leaf, found = work.traverse(0, len(work.bundles))
    pairs, _ = work.filter(lane, leaf, found) if found else ([], [])
    looked_at = set(zip(pairs.segment.numpy().tolist(), pairs.beam.numpy().tolist())) if found else set()
    uv = grid(12).reshape(-1, 2)
    uv = uv[np.lexsort(uv.T)]
    missing = 0
    for i in range(61):
        W, M = lines_at(values[0][i], values[1][i], grid(12).reshape(-1, 2))
        g = -(M @ d.astype(float).T) - W @ np.cross(o, d).astype(float).T  # (points, segments)
        signs = (g.reshape(-1, 3, 48).min(1) < -1e-5) & (g.reshape(-1, 3, 48).max(1) > 1e-5)
        w, m = W.reshape(-1, 3, 3).mean(1), M.reshape(-1, 3, 3).mean(1)
        nodes = np.einsum("ki,ki->k", values[0][i].astype(float), values[1][i].astype(float))
        e = quadratic(grid(12).reshape(-1, 2), nodes).reshape(-1, 3).mean(1)
        for k in np.flatnonzero(signs.any(0)):
            lines, normal = m[signs[:, k]] - np.cross(o[k], w[signs[:, k]]), np.cross(d[k], w[signs[:, k]])
            t = np.einsum("ni,ni->n", lines, normal) / (normal**2).sum(1)
            V = o[k] + t[:, None] * d[k]
            s = (np.einsum("ni,ni->n", V, w[signs[:, k]]) - e[signs[:, k]]) / np.linalg.norm(w[signs[:, k]], axis=1)
            # Quadratics of both of Plücker's vectors are no lines exactly: nearly parallel ones may miss each other.
            meet = np.linalg.norm(np.cross(V, w[signs[:, k]]) - m[signs[:, k]], axis=1) < 0.02
            reaches = meet & (t > 0.1) & (t < t_max[k] - 0.1) & (s > 0.1) & (s < values[3][i].min() - 0.1)
            missing += reaches.any() and (k, i) not in looked_at
    assert missing == 0
    assert len(looked_at) < 0.8 * 61 * 48


def smooth_ball(n, tmp_path, **more):
    mesh = meshes.icosphere(n)
    return mi.load_dict({"type": "scene", "body": mesh_shape(mesh, tmp_path / "ball.ply", **more),
                         "light": point_light((0, 3, 0), (1, 1, 1))}, optimize=False)  # fmt: skip


def traced(scene, tolerance, coarse):
    """Cells of the light in the scene's body, and the ``Tracing``."""
    prepared = prepare(scene, Options(tolerance=tolerance), Cache(), lambda: 0, changes={"coarse": coarse})
    body, (emitter,) = prepared.scene.bodies[0], prepared.scene.emitters
    shadows = prepared.shadows(body, light_samples.exact(emitter))
    maker = light_beams._Maker(body, shadows, prepared.structures, 0)
    tracing = maker.sheets if coarse else maker.facets
    return refinement.refine(tracing, tolerance, None)


@pytest.mark.parametrize("coarse", [False, True])
def test_flux_of_a_ball(tmp_path, coarse):
    """What comes into a ball of index 1.5 by a light two radii above it, from triangles and from a coarse mesh: the
    light that arrives times Fresnel's transmission, integrated over the cap that sees it."""
    cells, _ = traced(smooth_ball(5, tmp_path), 0.01, coarse)
    theta = np.linspace(0, np.arccos(1 / 3), 20001)
    P = np.stack([np.sin(theta), np.cos(theta)], 1)
    to = np.array([0, 3]) - P
    distance = np.linalg.norm(to, axis=1)
    c = np.einsum("ni,ni->n", to, P) / distance
    inside = np.sqrt(1 - (1 - c**2) / 2.25)
    F = 0.5 * (((c - 1.5 * inside) / (c + 1.5 * inside)) ** 2 + ((1.5 * c - inside) / (1.5 * c + inside)) ** 2)
    # phi is radiant flux through the surface times the cosine inside over it: kappa of both cosines (Snell).
    density = (1 - F) * c / distance**2 * 2 * np.pi * np.sin(theta)
    expected = np.sum(0.5 * (density[1:] + density[:-1]) * np.diff(theta))
    assert cells.flux[cells.leaf].sum() == pytest.approx(expected, rel=4e-3)


def test_errors_fall_as_asked(tmp_path):
    """What is expected is at most what was asked for, cells become more, and their flux stays."""
    scene, last = smooth_ball(5, tmp_path), None
    for tolerance in (0.1, 0.03, 0.01):
        cells, estimate = traced(scene, tolerance, True)
        count, flux = (cells.leaf & cells.lit).sum(), cells.flux[cells.leaf].sum()
        assert estimate <= tolerance
        assert last is None or (count >= last[0] and flux == pytest.approx(last[1], rel=0.02))
        last = count, flux


@pytest.mark.parametrize("tolerance", [0.1, 0.01, 1e-3])
def test_shipped_body_within_the_tolerance(tolerance):
    """Against the triangles themselves, and what was expected before."""
    scene = example_scenes.load("scenes/bumpy_sphere/scene.xml", res=48)

    def render(tolerance):
        hooks = Hooks(silent=True)
        integrator = mi.load_dict({"type": "refscatter", "tolerance": tolerance, "surfaces": False})
        return np.array(integrator.render(scene, spp=1, hooks=hooks))[..., :3], hooks.counts.estimated_error

    (exact, nothing), (found, expected) = render(0.0), render(tolerance)
    error = np.abs(found - exact).sum() / exact.sum()
    print(f"asked {tolerance:g}, expected {expected:.2e}, found {error:.2e}")
    assert nothing == 0
    assert error < tolerance and error < expected < 10 * error


# ---- Images against the exact triangles -----------------------------------------------------

TOLERANCES = (0.1, 0.03, 0.01, 3e-3, 1e-3)


def lamp():
    return point_light((-2.6, 2.4, -0.9))


def block(at, size):
    return {"type": "cube", "to_world": to(("translate", at), ("scale", size)), "bsdf": {"type": "diffuse"}}


def bubble():
    return empty(glass(1.3), ("translate", [-1.2, 1.0, 0]), ("scale", 0.4))


def one_triangle():
    return meshes.Mesh(np.array([[-1.0, 0, -1], [2, 0, 0], [0, 0.3, 2]]), np.array([[0, 2, 1]]), None)


def faceted(mesh):
    return replace(mesh, normals=None)


def needles():
    """A long prism of slivers."""
    a = np.linspace(0, 2 * np.pi, 25)[:-1]
    ring = np.stack([np.cos(a), 0 * a, np.sin(a)], 1)
    vertices = np.concatenate([0.8 * ring + (0, -1.2, 0), 0.8 * ring + (0, 1.2, 0), [(0, -1.2, 0), (0, 1.2, 0)]])
    i = np.arange(24)
    j = (i + 1) % 24
    faces = [
        np.stack(x, 1) for x in ((i, i + 24, j), (j, i + 24, j + 24), (0 * i + 48, i, j), (0 * i + 49, j + 24, i + 24))
    ]
    return meshes.Mesh(vertices, np.concatenate(faces), None)


def waves(n=30):
    """An open surface, its inside below."""
    uv, faces = meshes.triangle_grid(n)
    x, y = 6 * uv.T - 3
    normals = np.stack([-0.2 * np.cos(2 * x), np.ones_like(x), -0.2 * np.cos(3 * y)], 1)
    vertices = np.stack([x, 0.1 * np.sin(2 * x) + 0.067 * np.sin(3 * y), y], 1)
    return meshes.Mesh(vertices, faces[:, ::-1], normals / np.linalg.norm(normals, axis=1, keepdims=True))


SCENES = {
    "facets": lambda: (faceted(meshes.bumpy_sphere(3, 0.1, 4.0)), {}),
    "cut": lambda: (bevelled_box(), {}),
    "concave": lambda: (meshes.bumpy_sphere(4, 0.25, 5.0), {}),
    "needles": lambda: (needles(), {}),
    "one triangle": lambda: (one_triangle(), {}),
    "open": lambda: (waves(), {"lamp": point_light((0.5, 3, 0.3))}),
    "shadow outside": lambda: (meshes.icosphere(4), {"block": block([-1.2, 1.4, -0.4], 0.2)}),
    "shadow inside": lambda: (meshes.icosphere(4), {"block": block([0.2, 0.1, 0], 0.25)}),
    "area light": lambda: (meshes.icosphere(4), {"lamp": ball_light()}),
    "sky": lambda: (meshes.bumpy_sphere(3, 0.1, 4.0), {"lamp": sky()}),
    # Made up last.
    "spot": lambda: (meshes.bumpy_sphere(4, 0.05, 6.0), {"lamp": spot()}),
    "sun": lambda: (faceted(meshes.box((-0.8, -0.9, -0.7), (0.9, 0.6, 0.8))), {"lamp": sun()}),
    "two": lambda: (meshes.icosphere(3, 0.7), {"other": bubble()}),
    "water": lambda: (meshes.icosphere(5), {"eta": 1.33, "g": 0.8}),
    "less dense than outside": lambda: (meshes.bumpy_sphere(3, 0.05, 4.0), {"eta": 0.8}),
}  # fmt: skip


def rendered(scene, tolerance):
    """The image, and the error that it expects of itself."""
    integrator = mi.load_dict({"type": "refscatter", "tolerance": tolerance, "surfaces": False, "light_samples": 4})
    return np.array(integrator.render(scene, spp=1, seed=3, hooks=Hooks(silent=True)))[
        ..., :3
    ], integrator.estimated_error


@pytest.mark.parametrize("name", slow_ones(SCENES, [x for x in SCENES if x not in ("cut", "shadow outside")]))
def test_images_are_within_the_tolerance(tmp_path, name):
    """Against the triangles themselves; and what was expected is not too far off."""
    mesh, parts = SCENES[name]()
    extras = {key: parts.pop(key) for key in ("eta", "g") if key in parts}
    body = mesh_shape(mesh, tmp_path / "m.ply", **extras)
    view = mi.ScalarTransform4f().look_at([0.4, 1.1, 5], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 48, "height": 48, "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "fov": 40, "to_world": view, "film": film}
    scene = mi.load_dict({"type": "scene", "body": body, "lamp": lamp(), "sensor": sensor, **parts}, optimize=False)
    exact, nothing = rendered(scene, 0.0)
    assert nothing == 0 and exact.mean() > 0
    for tolerance in TOLERANCES:
        found, expected = rendered(scene, tolerance)
        error = np.abs(found - exact).sum() / exact.sum()
        bias = found.sum() / exact.sum() - 1
        print(f"{name}: asked {tolerance:g}, expected {expected:.2e}, found {error:.2e}, bias {bias:+.1e}")
        assert error <= tolerance


def test_cells_lie_on_the_body(tmp_path):
    """As probes show them: on a fine ball all nodes are at its radius, and cells do not overlap: their areas are that
    of the cap that sees the light."""
    scene, cap = smooth_ball(5, tmp_path), 2 * np.pi * (1 - 1 / 3)
    for tolerance, more in ((0.03, 0.3), (0.003, 0.15)):  # cells at the cap's rim stand out
        (cells,) = probing.light_beams(scene, tolerance)
        assert cells.estimate <= tolerance
        radius = np.linalg.norm(cells.nodes, axis=2)
        assert radius.min() > 0.995 and radius.max() < 1.001
        a, b, c, ab, bc, ca = cells.nodes.transpose(1, 0, 2)
        quarters = (a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab)
        area = sum(0.5 * np.linalg.norm(np.cross(q - p, r - p), axis=1).sum() for p, q, r in quarters)
        assert 0.98 * cap < area < (1 + more) * cap


@pytest.mark.slow
def test_a_moving_light_does_not_pop(tmp_path):
    """From frame to frame the image changes as by exact triangles, give or take the tolerance."""
    body = mesh_shape(meshes.bumpy_sphere(4, 0.1, 4.0), tmp_path / "m.ply")
    view = mi.ScalarTransform4f().look_at([0.4, 1.1, 5], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 48, "height": 48, "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "fov": 40, "to_world": view, "film": film}
    frames = []
    for step in range(6):
        light = point_light((-2.6 + 0.002 * step, 2.4, -0.9 - 0.001 * step))
        scene = mi.load_dict({"type": "scene", "body": body, "lamp": light, "sensor": sensor}, optimize=False)
        frames.append([rendered(scene, tolerance)[0] for tolerance in (0.0, 0.01, 0.1)])
    exact, *others = np.diff(np.array(frames), axis=0).swapaxes(0, 1)
    for tolerance, changes in zip((0.01, 0.1), others):
        pops = np.abs(changes - exact).sum((1, 2, 3)) / np.abs(frames[0][0]).sum()
        print(f"tolerance {tolerance:g}: pops of {pops.max():.1e}")
        assert pops.max() < tolerance

"""Culling loses nothing that contributes, looks at little in vain, and its proofs of visibility hold."""

from types import SimpleNamespace

import build
import mitsuba as mi
import numpy as np
import oracle
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from meshes import BoxTree, Mesh, bumpy_sphere, dot, make_patches, norm, take
from pairs import Culling, bevelled_box, chords, lost_and_looked_at, one_body, random_case, torus, wavy
from test_rays_against_oracle_and_formulas import read_mesh

from mitsuba_refscatter import example_scenes, tolerances
from mitsuba_refscatter.culling import beam
from mitsuba_refscatter.culling import beams as light_beams
from mitsuba_refscatter.geometry import mesh as mesh_facts
from mitsuba_refscatter.geometry import silhouette
from mitsuba_refscatter.optics import Incidence, LocalLight

LOST = 1e-5
"""Largest share of a body's light that may come from pairs that the culling drops: the rounding of float32."""


# ---- No pair is lost ------------------------------------------------------------------------


def no_pair_is_lost(examples, folder, culling):
    """The same examples at every run; prints how loose the culling is."""
    looked_at = []

    # One seed, not a draw for each number: Hypothesis would vary one of them at a time, and need many more examples.
    @settings(max_examples=examples, derandomize=True, deadline=None, database=None, phases=[Phase.generate],
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(st.integers(0, 2**32 - 1))
    def check(seed):
        mesh, eta, light, tolerance, segments = random_case(seed)
        lost, ratio = lost_and_looked_at(
            mesh, eta, light, one_body(mesh, eta, light, folder, tolerance=tolerance, culling=culling), segments
        )
        looked_at.append(ratio)
        assert lost < LOST

    check()
    print(
        f"{culling}: candidates per contributing pair: median {np.median(looked_at):.1f}, largest {max(looked_at):.1f}"
    )


CULLINGS = pytest.mark.parametrize("culling", ["beams", "spindle"])


@CULLINGS
def test_no_pair_is_lost(rgb, tmp_path, culling):
    no_pair_is_lost(30, tmp_path, culling)


@pytest.mark.slow
@CULLINGS
def test_no_pair_is_lost_in_many_bodies(rgb, tmp_path, culling):
    no_pair_is_lost(500, tmp_path, culling)


def test_beams_into_a_corner(rgb, tmp_path):
    """Through the cut edge of a box into the edge opposite: rays in the middle of a beam run further than those
    at its corners."""
    mesh, eta, light = bevelled_box(), 1.3, np.array([-11.6, -11.6, -13.7])
    n = 40
    o = build.rounded(np.stack([np.ones(n), np.full(n, 0.8), np.linspace(-0.9, 0.9, n)], axis=1))
    d = build.rounded(np.tile([-1, 1, 0], (n, 1)) / 2**0.5)
    culling = one_body(mesh, eta, light, tmp_path)
    lost, _ = lost_and_looked_at(mesh, eta, light, culling, (o, d, build.rounded(np.full(n, 0.2 * 2**0.5))))
    assert lost < LOST


def test_little_is_looked_at_in_vain(rgb):
    """On the shipped bumpy sphere at most 6 candidates per contributing pair are wanted; there are 1.1 to 1.3."""
    scene = example_scenes.load("scenes/bumpy_sphere/scene.xml", res=64)
    mesh, light = read_mesh(scene), np.array(mi.traverse(scene.emitters()[0])["position"]).ravel().astype(float)
    rays = build.rays_at((0.0, 1.1, 5.2), 0.95, 120, seed=5)
    legs = oracle.camera_segments([oracle.Body(mesh, 1.5, np.ones(1), np.ones(1))], *rays, 1)
    lost, ratio = lost_and_looked_at(mesh, 1.5, light, Culling(scene), (legs.o, legs.d, legs.t_max))
    integrator = mi.load_dict({"type": "refscatter", "surfaces": False, "aovs": "candidates, contributions"})
    counts = np.array(integrator.render(scene, spp=1))[..., -2:].sum((0, 1))
    print(f"candidates per contributing pair: {ratio:.2f}; in the image, shadows out: {counts[0] / counts[1]:.2f}")
    assert lost < LOST
    assert 1 <= ratio < 2 and 1 <= counts[0] / counts[1] < 2


# ---- Proofs of visibility -------------------------------------------------------------------

INSIDE = np.array([(i + 0.5, j + 0.5) for i in range(6) for j in range(6) if i + j < 5]) / 6.5
"""Points (u, v) spread over a triangle."""


def concave_bodies():
    """Lists of bodies, of which all are tested together."""
    rng, ball = np.random.default_rng(3), bumpy_sphere(2)
    beside = Mesh(build.rounded(0.6 * ball.vertices + [2.2, 0.3, 0.1]), ball.faces, ball.normals)
    return {
        "torus": [torus(60, 30, 0.4)],
        "wavy": [wavy(rng, 3, 0.35, 1.5, True)],
        "bumpy": [bumpy_sphere(4, 0.12, 6.0)],
        "two": [bumpy_sphere(3, 0.12, 6.0), beside],
        "coarse": [wavy(rng, 2, 0.4, 2.0, False)],
    }


LIT_SHARE = {"torus": 0.3, "wavy": 0.2, "bumpy": 0.3, "two": 0.25, "coarse": 0.08}
"""Least share of the facets towards the light that is proven: two thirds of what it is now. None of them is where the
light is so near that its view is too wide."""
FREE_SHARE = {"torus": 0.6, "wavy": 0.25, "bumpy": 0.5, "coarse": 0.2}
"""Least share of a ray's way through the body that is proven, in the mean: about two thirds of what it is now."""


def lights_around(mesh, distances=(1.1, 2.0, 6.0)):
    middle = mesh.vertices.mean(0)
    radius = norm(mesh.vertices - middle).max()
    directions = np.random.default_rng(8).normal(size=(len(distances), 3)) * [1, 0.4, 0.4]
    return [build.rounded(middle + f * radius * w / norm(w)) for f, w in zip(distances, directions)]


@pytest.mark.parametrize("distant", [False, True], ids=["near", "distant"])
@pytest.mark.parametrize("name", concave_bodies())
def test_uniform_triangles_are_lit_or_dark_throughout(name, distant):
    """No triangle that is said to be lit uniformly has points in the light and in shadow."""
    meshes, shares = concave_bodies()[name], []
    tree = BoxTree(meshes)
    for light in lights_around(meshes[0]):
        light = light / np.linalg.norm(light) if distant else light
        far = 1e5 * light if distant else light
        edges = np.concatenate([edges_seen(m, light, distant) for m in meshes])
        for k, mesh in enumerate(meshes):
            facing = np.flatnonzero(dot(far - mesh.corners[:, 0], mesh.facet_normals) > 0)
            claimed = silhouette.uniform(mesh.corners[facing], edges, light, distant)
            tri, uv = np.repeat(facing, len(INSIDE)), np.tile(INSIDE, (len(facing), 1))
            point = oracle.light_ray(take(make_patches(mesh, 1.5), tri), uv, far, 1.5).point
            free = tree.clear(point, np.broadcast_to(far, point.shape), tri + tree.first[k]).reshape(len(facing), -1)
            mixed = free.any(1) & ~free.all(1)
            assert not (claimed & mixed).any()
            shares.append(claimed.mean())
    print(f"{name}: proven {np.round(shares, 2)}")
    assert np.mean(shares) > LIT_SHARE[name]


def edges_seen(mesh, light, distant):
    twin = mesh_facts.twins(mesh_facts.weld(mesh.vertices, mesh.faces))
    return silhouette.silhouette_edges(mesh.corners, mesh.facet_normals, twin, light, distant)


@pytest.mark.parametrize("eta", [0.8, 1.5, *(pytest.param(x, marks=pytest.mark.slow) for x in (1.2, 2.2))])
@pytest.mark.parametrize("name", FREE_SHARE)
def test_beams_are_free_as_far_as_said(rgb, tmp_path, name, eta):
    """No ray of a beam leaves its body before the beam's clear length."""
    mesh, proven = concave_bodies()[name][0], []
    for light in lights_around(mesh):
        culling = one_body(mesh, eta, light, tmp_path)
        record = culling.culling.records.numpy().reshape(-1, beam.BEAM).astype(float)
        triangle = culling.culling.triangles.numpy().astype(int) - culling.body.first_record
        record, triangle = (x[record[:, 19] >= 0] for x in (record, triangle))  # without empty places
        uv = np.concatenate([INSIDE, np.eye(3)[:, :2]])
        index = np.repeat(np.arange(len(record)), len(uv))
        uv = record[index, 20:22] + record[index, 22:23] * np.tile(uv, (len(record), 1))
        patch, clear = take(make_patches(mesh, eta), triangle[index]), record[index, 23]
        x = oracle.light_ray(patch, uv, light, eta)
        enters = ((x.c_l > 0) & (x.radicand > 0) & (dot(x.omega, patch.ng) < 0))[:, 0]
        skip = triangle[index][enters]
        ray, _, t, _, _ = BoxTree([mesh]).closest(x.point[enters], x.omega[enters], skip)
        way, said = t[:, 0], clear[enters][ray]
        # float32 places the points to 1e-7 of their coordinates.
        assert (way > said * (1 - 1e-5) - 1e-5).all()
        proven.append(np.mean(np.minimum(said, way) / way))
    print(f"{name}, eta {eta}: proven {np.round(proven, 2)}")
    assert np.mean(proven) > FREE_SHARE[name] * (1 if eta > 1 else 0.5)


# ---- Chunks, and nothing to do --------------------------------------------------------------


def scattered(culling, o, d, t_max):
    """The sums along the segments, and after what part of them each chunk ended."""
    ends = []
    sums, _ = culling.scatter(culling.segments(o, d, t_max), progress=ends.append)
    return np.array(sums.value).T, ends


def test_chunks_do_not_matter(rgb, tmp_path, monkeypatch):
    """Buffers so small that they overflow, and chunks of a few segments, give the same sums."""
    mesh, rng = bumpy_sphere(3, 0.12, 6.0), np.random.default_rng(6)
    culling = one_body(mesh, 1.5, np.array([-2.6, 2.4, -0.9]), tmp_path)
    rays = chords(mesh, rng, 40)
    lane, _, found = culling.leaves(culling.segments(*rays))
    most = int(np.bincount(lane.numpy()[:found]).max())
    whole, ends = scattered(culling, *rays)
    assert len(ends) == 1 and whole.min() >= 0 and whole.max() > 0
    for changes in ({"CHUNK_PAIRS": most}, {"CHUNK_PAIRS": 5 * most}, {"FIRST_CHUNK": 1}, {"PIECES": 1 << 12},
                    {"FIRST_CHUNK": 8, "CHUNK_BUNDLES": 3, "CHUNK_PAIRS": 2 * most, "PIECES": 1 << 11}):  # fmt: skip
        with monkeypatch.context() as patch:
            for name, value in changes.items():
                patch.setattr(tolerances, name, value)
            parts, ends = scattered(culling, *rays)
        assert ends[-1] == 1 and (len(ends) > 1 or "PIECES" in changes), changes
        np.testing.assert_allclose(parts, whole, rtol=1e-5, atol=1e-5 * whole.mean(), err_msg=str(changes))
    monkeypatch.setattr(tolerances, "CHUNK_PAIRS", most - 1)
    with pytest.raises(RuntimeError, match=f"meets {most} .*CHUNK_PAIRS"):
        scattered(culling, *rays)


def test_no_lit_triangles(rgb, tmp_path):
    """Without lit triangles there are no beams; a body wholly in the shadow of another is dark."""
    big, small = bumpy_sphere(3), bumpy_sphere(2)
    small = Mesh(build.rounded(0.3 * small.vertices + [0, 0, -2]), small.faces, small.normals)
    scene = mi.load_dict({
        "type": "scene", "light": build.point_light((0, 0, 3)),
        "a": build.mesh_shape(small, tmp_path / "small.ply", eta=1.3), "b": build.mesh_shape(big, tmp_path / "big.ply"),
    })  # fmt: skip
    o, d = build.rounded(np.array([[3.0, 0.02, -2.01]])), np.array([[-1.0, 0, 0]])
    assert (build.single_scattering(scene, o, d, internal_bounces=0) == 0).all()
    culling = Culling(scene)
    body, structures = culling.body, culling.prepared.structures

    def beams(light, seen):
        shadows = SimpleNamespace(incidence=Incidence(LocalLight(mi.Point3f(light)), mi.Float(1.5)), seen=seen)
        return light_beams.build(body, shadows, structures)

    from_inside = beams(0, lambda triangles: pytest.fail("none is lit"))
    unseen = beams(9, lambda triangles: (mi.UInt32(), mi.Bool()))
    assert from_inside is None and unseen is None


@pytest.fixture
def ball(rgb, tmp_path):
    shape = build.mesh_shape(bumpy_sphere(2), tmp_path / "mesh.ply")
    return mi.load_dict({"type": "scene", "body": shape, "light": build.point_light((-2.6, 2.4, -0.9))})


@pytest.mark.parametrize("surfaces", [False, True])
def test_one_camera_ray(ball, surfaces):
    """One ray alone gives what it gives among others."""
    o, d = build.rays_at((0.0, 1.1, 5.2), 0.6, 3, seed=7)
    options = {"surfaces": surfaces, "internal_bounces": 1}
    together = build.single_scattering(ball, o, d, **options)
    alone = np.concatenate([build.single_scattering(ball, o[k : k + 1], d[k : k + 1], **options) for k in range(3)])
    assert together.min() > 0
    np.testing.assert_allclose(alone, together, rtol=1e-5)


@pytest.mark.parametrize("surfaces", [False, True])
def test_camera_that_misses_the_body(ball, surfaces):
    o = np.tile([0.0, 0.0, 5.0], (5, 1))
    assert (build.single_scattering(ball, o, np.tile([0.0, 0.6, -0.8], (5, 1)), surfaces=surfaces) == 0).all()

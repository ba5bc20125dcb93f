"""The chain of segments that camera rays run along inside bodies, and their weights."""

from types import SimpleNamespace

import build
import drjit as dr
import mitsuba as mi
import numpy as np
import oracle
import pytest
from meshes import BoxTree, Mesh, bumpy_sphere, icosphere
from scipy.optimize import linear_sum_assignment

from mitsuba_refscatter import tolerances
from mitsuba_refscatter.core.cache import Cache
from mitsuba_refscatter.scene import NONE, SceneError, read
from mitsuba_refscatter.transport import camera_paths
from mitsuba_refscatter.transport.camera_refusals import refuse_overlaps

CAMERA = (0.0, 1.1, 5.2)
SAME = 1e-2
"""Largest difference of origin plus direction of two segments that count as the same: a curved boundary doubles an
error several times on the way, so the float32 of Mitsuba's hits is far below it, and another branch far above."""


def bodies(name):
    """Bodies for the oracle; meshes as Mitsuba reads them."""
    small = icosphere(2)
    meshes = {
        "convex": [icosphere(3)],
        "concave": [bumpy_sphere(3, 0.12, 6.0)],
        "facets": [Mesh(bumpy_sphere(2, 0.2, 5.0).vertices, small.faces, None)],
        "two": [bumpy_sphere(3), Mesh(0.7 * small.vertices + [0.9, 1.5, 0.6], small.faces, small.normals)],
    }[name]
    meshes = [Mesh(*(x if x is None or x.dtype == int else build.rounded(x) for x in vars(m).values())) for m in meshes]
    sigma_t = np.array(build.SIGMA_T)
    return [oracle.Body(m, eta, sigma_t * build.ALBEDO, sigma_t) for m, eta in zip(meshes, (1.5, 1.3))]


def scene(bodies, folder, **properties):
    """The same bodies as the package reads them, in the same order."""
    parts = {"type": "scene", "light": build.point_light((0, 50, 0))}
    for k, body in enumerate(bodies):
        parts[f"body{k}"] = build.mesh_shape(body.mesh, folder / f"{k}.ply", eta=body.eta, **properties)
    found = read(mi.load_dict(parts, optimize=False), 0.01, Cache())
    assert [round(body.eta, 5) for body in found.bodies] == [body.eta for body in bodies]
    return found


def trace(scene, o, d, internal_bounces, surfaces=False, min_weight=0.0):
    ray = mi.Ray3f(mi.Point3f(o.astype(np.float32).T), mi.Vector3f(d.astype(np.float32).T))
    return camera_paths.trace(scene, ray, True, NONE, camera_paths.ChainLimits(internal_bounces, surfaces, min_weight))


def segments(paths):
    """All segments of ``camera_paths.Paths`` as the oracle gives them."""
    parts = []
    for index, found in enumerate(paths.parts):
        for part in found:
            n = len(part)
            weight = np.broadcast_to(np.array(part.weight).T, (n, 3))
            arrays = (x.numpy().T for x in (part.start(), part.direction, part.length))
            parts.append([part.sample.numpy().astype(int), np.full(n, index), *arrays, weight])
    return oracle.Segments(*(np.concatenate(x) for x in zip(*parts)))


def assign(ours, theirs):
    """Pairs of segments that are the same, one to one, ray by ray: two index arrays."""
    pairs = [np.zeros((2, 0), int)]
    for ray in np.intersect1d(ours.ray, theirs.ray):
        i, j = (np.flatnonzero(x.ray == ray) for x in (ours, theirs))
        apart = np.abs(ours.o[i, None] - theirs.o[j]).sum(2) + np.abs(ours.d[i, None] - theirs.d[j]).sum(2)
        apart += np.abs(ours.t_max[i, None] - theirs.t_max[j]) + 10 * (ours.body[i, None] != theirs.body[j])
        a, b = linear_sum_assignment(apart)
        same = apart[a, b] < SAME
        pairs.append(np.stack([i[a[same]], j[b[same]]]))
    return np.concatenate(pairs, axis=1)


@pytest.mark.parametrize("surfaces", [False, True])
@pytest.mark.parametrize("internal_bounces", [0, 1, 4])
@pytest.mark.parametrize("name", ["convex", "concave", "facets", "two"])
def test_segments_against_oracle(rgb, tmp_path, name, internal_bounces, surfaces):
    """Every segment of 300 rays with its length and weight. A thousandth of the weight may go another way: a ray within
    float32 of an edge, or beyond total reflection by as little."""
    expected = bodies(name)
    o, d = build.rays_at(CAMERA, 1.2, 300, seed=1)
    theirs = oracle.camera_segments(expected, o, d, internal_bounces)
    ours = segments(trace(scene(expected, tmp_path), o, d, internal_bounces, surfaces))
    assert len(theirs.ray) > (internal_bounces + 1) * 200
    i, j = assign(ours, theirs)
    for mine, paired in ((ours, i), (theirs, j)):
        assert mine.weight.sum() - mine.weight[paired].sum() < 1e-3 * mine.weight.sum()
    weight, true_weight = ours.weight[i], theirs.weight[j]
    length, true_length = ours.t_max[i], theirs.t_max[j]
    print(
        f"{len(theirs.ray)} segments, unlike: {len(theirs.ray) - len(j)}, {len(ours.ray) - len(i)}; "
        f"largest errors: weight {np.abs(weight - true_weight).max():.1e}, length "
        f"{np.abs(length - true_length).max():.1e}"
    )
    # Errors of 2e-7 grow with every reflection in a curved boundary, most of all near total reflection.
    assert np.abs(weight - true_weight).sum() < 1e-4 * true_weight.sum()
    assert np.abs(weight - true_weight).max() < 1e-2
    assert (true_weight.max(1) * np.abs(length - true_length)).sum() < 1e-4 * (true_weight.max(1) * true_length).sum()


@pytest.mark.parametrize("name", ["convex", "concave", "two"])
def test_straight_through_without_refraction(rgb, tmp_path, name):
    """eta = 1: one ray stays one ray, each segment weighs what the way before it lets through, and what leaves is what
    all of it lets through."""
    expected = [body._replace(eta=1.0) for body in bodies(name)]
    meshes = [body.mesh for body in expected]
    o, d = build.rays_at(CAMERA, 1.2, 400, seed=2)
    paths = trace(
        scene(expected, tmp_path), o, d, 4, surfaces=True, min_weight=1e-9
    )  # nothing is reflected but for rounding
    ours = segments(paths)
    ray, _, tuv = BoxTree(meshes).hits(o, d, np.full(len(o), np.inf), np.full(len(o), -1))
    order = np.lexsort((tuv[:, 0], ray))
    enter, leave = tuv[order[::2], 0], tuv[order[1::2], 0]
    inside = np.bincount(ray[order[::2]], leave - enter, len(o))
    assert abs(ours.t_max.sum() - inside.sum()) < 1e-4 * inside.sum()
    gone = np.zeros((len(o), 3))
    for legs in paths.ends:
        np.add.at(gone, legs.sample.numpy().astype(int), np.broadcast_to(np.array(legs.weight).T, (len(legs), 3)))
    np.testing.assert_allclose(gone, np.exp(-np.outer(inside, build.SIGMA_T)), rtol=1e-3)
    middle = (np.arange(len(ours.ray)), ours.o + 0.5 * ours.t_max[:, None] * ours.d)
    way = np.linalg.norm(middle[1] - o[ours.ray], axis=1)
    k = ray[order[::2]]
    before = np.array([((leave - enter) * ((k == r) & (leave < s))).sum() for r, s in zip(ours.ray, way)])
    np.testing.assert_allclose(ours.weight, np.exp(-np.outer(before, build.SIGMA_T)), rtol=1e-3)


def clear(bodies, folder):
    """Bodies with a medium that neither scatters nor absorbs."""
    return scene(bodies, folder, sigma_t=(0.0, 0.0, 0.0), albedo=(0.5, 0.5, 0.5))


@pytest.mark.parametrize("name", ["convex", "facets", "two"])
def test_nothing_is_lost_at_clear_bodies(rgb, tmp_path, name):
    """Reflected plus refracted weight is the weight that arrived: after 30 reflections nearly all has left, and never
    more than arrived. A few rays are trapped by total reflection. (On coarse curved meshes interpolated normals and
    facets disagree on which side a ray is, and radiance is not kept: not tested there.)"""
    o, d = build.rays_at(CAMERA, 1.2, 300, seed=3)
    paths = trace(clear(bodies(name), tmp_path), o, d, 30, surfaces=True, min_weight=1e-5)
    gone = np.zeros(len(o))
    for legs in paths.ends:
        np.add.at(gone, legs.sample.numpy().astype(int), np.array(legs.weight)[0] * np.ones(len(legs)))
    print(f"{name}: left {gone.mean():.5f} of the weight, at least {gone.min():.4f}")
    assert gone.max() < 1 + 1e-5
    assert gone.mean() > (0.99 if name == "two" else 0.9999)


class Counting:
    """A Mitsuba scene that counts the rays it is asked for."""

    def __init__(self, mi_scene):
        self.mi_scene, self.rays = mi_scene, 0

    def __getattr__(self, name):
        return getattr(self.mi_scene, name)

    def ray_intersect_preliminary(self, ray, **arguments):
        self.rays += dr.width(ray)
        return self.mi_scene.ray_intersect_preliminary(ray, **arguments)


def traced(found, *arguments, **options):
    """Paths, and the number of rays traced for them."""
    counting = Counting(found.mi_scene)
    found.mi_scene = counting
    try:
        return trace(found, *arguments, **options), counting.rays
    finally:
        found.mi_scene = counting.mi_scene


@pytest.mark.parametrize("name", ["convex", "concave", "two"])
def test_only_what_can_come_back_is_followed(rgb, tmp_path, name):
    """Without surfaces a ray that leaves a lone convex body, or may not enter again, is not traced; segments are the
    same with and without."""
    found = scene(bodies(name), tmp_path)
    o, d = build.rays_at(CAMERA, 1.2, 300, seed=4)
    for internal_bounces in (0, 3):
        lean, few = traced(found, o, d, internal_bounces)
        full, many = traced(found, o, d, internal_bounces, surfaces=True)
        inside = len(segments(lean).ray)
        assert not lean.ends and full.ends
        if name == "convex" or internal_bounces == 0:
            assert few == len(o) + inside < many  # the camera rays, and each segment once
        else:
            assert len(o) + inside < few <= many
        sums = [segments(paths).weight.sum() for paths in (lean, full)]
        assert len(segments(full).ray) == inside and abs(sums[0] / sums[1] - 1) < 1e-6


def test_least_weight(rgb, tmp_path):
    """Legs with less weight, as seen from outside, are dropped, and no others."""
    found, (o, d) = scene(bodies("convex"), tmp_path), build.rays_at(CAMERA, 0.9, 300, seed=5)
    least, eta = 1e-3, 1.5
    every, kept = (segments(trace(found, o, d, 4, min_weight=w)) for w in (0.0, least))
    weight = eta**2 * every.weight.max(1)
    assert len(kept.ray) < len(every.ray) and kept.weight.max(1).min() * eta**2 > least
    heavy = weight > least
    assert abs(kept.weight.sum() / every.weight[heavy].sum() - 1) < 1e-5 and len(kept.ray) == heavy.sum()


def test_rays_that_are_not_active_are_left_out(rgb, tmp_path):
    found, (o, d) = scene(bodies("convex"), tmp_path), build.rays_at(CAMERA, 0.9, 40, seed=6)
    ray = mi.Ray3f(mi.Point3f(o.astype(np.float32).T), mi.Vector3f(d.astype(np.float32).T))
    odd = dr.arange(mi.UInt32, 40) % 2 == 1
    some = camera_paths.trace(found, ray, odd, NONE, camera_paths.ChainLimits(2, True, 0.0))
    assert set(segments(some).ray % 2) == {1} and not some.hit.numpy()[::2].any() and some.hit.numpy()[1::2].all()
    none = camera_paths.trace(found, ray, mi.Bool(False), NONE, camera_paths.ChainLimits(2, True, 0.0))
    assert not any(none.parts) and not none.ends


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (0.5, -0.7, 0.6)], ids=["moved", "mirrored", "squeezed"])
@pytest.mark.parametrize("normals", [True, False], ids=["smooth", "facets"])
def test_bodies_that_the_loader_merges(rgb, tmp_path, scale, normals):
    """By default Mitsuba makes one shape of meshes with one material; a mirrored one among them winds inwards."""
    body = bodies("concave")[0]
    mesh = body.mesh if normals else body.mesh.__class__(body.mesh.vertices, body.mesh.faces, None)
    shape, parts = build.mesh_shape(mesh, tmp_path / "mesh.ply"), {"light": build.point_light((0, 50, 0))}
    parts |= {"glass": shape.pop("bsdf"), "amber": shape.pop("interior")}
    for k, transform in enumerate(
        (mi.ScalarTransform4f(), mi.ScalarTransform4f().translate([2.4, 0.2, 0]).scale(scale))
    ):
        material = {"bsdf": {"type": "ref", "id": "glass"}, "interior": {"type": "ref", "id": "amber"}}
        parts[f"body{k}"] = {**shape, **material, "to_world": transform}
    apart, merged = (read(mi.load_dict({"type": "scene", **parts}, optimize=x), 0.01, Cache()) for x in (False, True))
    assert len(apart.bodies) == 2 and len(merged.bodies) == 1
    o, d = build.rays_at((0, 1.1, 7.2), 2.4, 300, seed=7)
    o = build.rounded(o + [1.2, 0, 0])
    found = [segments(trace(x, o, d, 1)) for x in (apart, merged)]
    assert len(found[0].ray) > 200 and len(found[0].ray) == len(found[1].ray)
    for x, y in zip(*[(np.bincount(s.ray, s.weight[:, 0], 300), np.bincount(s.ray, s.t_max, 300)) for s in found]):
        # Rays start off a surface by a share of the body's coordinates, and merged bodies reach further.
        np.testing.assert_allclose(x, y, rtol=1e-3, atol=1e-5)


def test_a_distant_object_does_not_matter(rgb, tmp_path):
    """How far rays start off a surface must follow from where the surface is, not from the size of the whole scene:
    a small cube far beside everything changes the single scattering by no more than rounding does."""
    body = build.mesh_shape(bodies("concave")[0].mesh, tmp_path / "mesh.ply")
    near = {"type": "scene", "light": build.point_light((-2.6, 2.4, -0.9)), "body": body}
    cube = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([4000, 0, 0]), "bsdf": {"type": "diffuse"}}
    o, d = build.rays_at(CAMERA, 0.95, 300, seed=8)
    alone, beside = (
        build.single_scattering(mi.load_dict(x), o, d, internal_bounces=1) for x in (near, {**near, "far": cube})
    )
    assert np.abs(alone - beside).sum() < 1e-3 * alone.sum()


@pytest.mark.parametrize("moved", [0.0, 300.0])
def test_mirror_through_the_origin(rgb, moved):
    """Reflected rays start off a mirror by a share of its own coordinates, not of the hit's, which may be zero: the
    body that they see is the one that rays see which start in the mirror's place."""
    turn = mi.ScalarTransform4f().rotate([1, 0.4, 0.2], 33)
    x, y, z = np.array(turn.matrix)[:3, :3].T
    cube = {
        "type": "cube",
        "bsdf": {"type": "dielectric", "int_ior": 1.3, "ext_ior": 1.0},
        "interior": {"type": "homogeneous"},
        "to_world": turn.translate([0, 0, 7]),
    }
    mirror = {"type": "rectangle", "bsdf": {"type": "conductor", "material": "none"},
              "to_world": turn.translate([moved, 0, 0]).scale([5 + moved, 5, 1])}  # fmt: skip
    parts = {"type": "scene", "light": build.point_light(2 * x + 2 * y + 9 * z), "body": cube}
    angle, size = np.arange(200), np.geomspace(1e-9, 0.3, 200)
    place = np.outer(size * np.cos(angle), x) + np.outer(size * np.sin(angle), y)
    d, mirrored = (np.tile((0.05 * y + sign * z) / np.hypot(0.05, 1), (200, 1)) for sign in (-1, 1))
    direct = build.single_scattering(mi.load_dict(parts), place, mirrored, internal_bounces=1)
    seen = build.single_scattering(mi.load_dict({**parts, "mirror": mirror}), place - 4 * d, d, internal_bounces=1)
    assert direct.min() > 0
    np.testing.assert_allclose(seen, direct, rtol=1e-3)
    # They start off the mirror by this much; the cube's edge is 2.
    assert abs(seen.sum() / direct.sum() - 1) < 1e-5 + tolerances.CAMERA_OFFSET * (5 + 2 * moved) / 2


@pytest.mark.parametrize("nested", [True, False])
def test_a_missed_crossing_between_nested_bodies_is_no_overlap(rgb, nested):
    """A leg in a body's region that meets the boundary of another from its inside: where one holds the other whole
    it slipped through an edge; where they cut each other it is refused."""
    bars = ([1, 1, 1], [0.3, 0.3, 0.3]) if nested else ([1, 0.3, 0.3], [0.3, 1, 0.3])  # no corner is in the other bar
    parts = {"type": "scene", "medium": {"type": "homogeneous", "id": "amber"}, "light": build.point_light((0, 50, 0))}
    for k, scale in enumerate(bars):
        bsdf = {"type": "dielectric", "int_ior": 1.5 + 0.1 * k, "ext_ior": 1.0}
        side = "exterior" if nested and k else "interior"
        parts[f"bar{k}"] = {"type": "cube", "bsdf": bsdf, side: {"type": "ref", "id": "amber"},
                            "to_world": mi.ScalarTransform4f().scale(scale)}  # fmt: skip
    found = read(mi.load_dict(parts, optimize=False), 0.01, Cache())
    outer, inner = sorted(found.bodies, key=lambda body: body.eta)
    leg = camera_paths.Legs(
        mi.Point3f(0, 0, 0.1),
        mi.Vector3f(1, 0, 0),
        mi.Spectrum(1),
        mi.UInt32(0),
        mi.UInt32(inner.inside),
        0,
        0,
        0,
        mi.Vector3f(0),
    )
    hit = SimpleNamespace(pi=SimpleNamespace(t=mi.Float(0.02)), target=mi.UInt32(outer.index))
    arguments = found, leg, hit, mi.Bool(True)
    if nested:
        refuse_overlaps(*arguments)
    else:
        with pytest.raises(SceneError, match="overlaps"):
            refuse_overlaps(*arguments)

"""The same scene, seed and variant give the same image: in any chunks, with any number of threads, after changes to
the scene."""

import build
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from meshes import icosphere

from mitsuba_refscatter import example_scenes, tolerances

SAME = 1e-5
"""Relative difference of images, in the mean and at a pixel of mean brightness: sums are in another order."""


def load(tmp_path, name="branches", triangles=5120, resolution=24):
    path, _ = example_scenes.write_scene(name, tmp_path / name, triangles)
    return example_scenes.load(path, res=str(resolution))


def refscatter(**properties):
    return mi.load_dict({"type": "refscatter", "surfaces": False, "internal_bounces": 1, **properties})


def image(integrator, scene):
    return np.array(integrator.render(scene, seed=1, spp=1), dtype=np.float64)


def assert_same(a, b):
    difference = np.abs(a - b)
    assert difference.sum() < SAME * b.sum() and (difference < SAME * (b + b.mean())).all()


EVERY = [
    pytest.param({}, id="curve"),
    pytest.param({"estimator": "interval", "culling": "spindle"}, id="interval", marks=pytest.mark.slow),
    pytest.param({"estimator": "point", "culling": "spindle", "samples": 4}, id="point", marks=pytest.mark.slow),
]


@pytest.mark.slow
@pytest.mark.parametrize("options", EVERY)
def test_with_any_number_of_threads(rgb, tmp_path, options):
    if not rgb.startswith("llvm"):
        pytest.skip("threads are of LLVM")
    scene, threads = load(tmp_path), dr.thread_count()
    try:
        found = []
        for count in (1, 2, 5):
            dr.set_thread_count(count)
            found.append(image(refscatter(**options), scene))
    finally:
        dr.set_thread_count(threads)
    for other in found[1:]:
        assert_same(other, found[0])


@pytest.mark.parametrize("options", EVERY)
@pytest.mark.parametrize(
    "body, pairs",
    [(("bumpy_sphere", 1280, 16), 1 << 11), pytest.param(("branches", 5120, 24), 1 << 14, marks=pytest.mark.slow)],
    ids=["bumpy_sphere", "branches"],
)
def test_in_any_chunks(rgb, tmp_path, monkeypatch, body, pairs, options):
    scene = load(tmp_path, *body)
    whole = image(refscatter(**options), scene)
    for changes in ({"CHUNK_PAIRS": pairs}, {"CHUNK_BUNDLES": 7, "FIRST_CHUNK": 2}, {"PIECES": 1 << 9}):
        with monkeypatch.context() as context:
            for name, value in changes.items():
                context.setattr(tolerances, name, value)
            assert_same(image(refscatter(**options), scene), whole)


def changed(scene, key, value):
    parameters = mi.traverse(scene)
    before = type(parameters[key])(parameters[key])
    parameters[key] = value(before)
    parameters.update()
    return before


def moved(vertices):
    x = np.array(vertices).reshape(-1, 3)
    return mi.Float((x * [0.9, 1.0, 1.1] + [0.02, 0, -0.03]).ravel())


CHANGES = {
    "light moved": ("light.position", lambda p: mi.Point3f(p) + 0.3),
    "light brighter": ("light.intensity.value", lambda x: 2 * x),
    "denser": ("body.interior_medium.sigma_t.value.value", lambda x: 1.5 * x),
    "paler": ("body.interior_medium.albedo.value.value", lambda x: 0.5 * x),
    "index": ("body.bsdf.eta", lambda x: 1.1 * x),
    "vertices moved": ("body.vertex_positions", moved),
    "camera moved": ("sensor.to_world", lambda t: t @ mi.ScalarTransform4f().translate([0.1, 0, 0])),
}


@pytest.mark.parametrize("name", CHANGES)
def test_an_integrator_sees_what_changed(rgb, tmp_path, name):
    """One integrator before and after a change of the scene, and back: as fresh ones. (Mitsuba itself makes other
    normals of vertices that moved, there and back.)"""
    scene, one = load(tmp_path, "bumpy_sphere", 5120, 16), refscatter()
    key, value = CHANGES[name]
    key = next(
        k
        for k, _ in mi.traverse(scene)
        if k == key or (k.endswith(key.split(".", 1)[1]) and key.split(".")[0] in ("sensor", "light"))
    )
    original = image(one, scene)
    before = changed(scene, key, value)
    after = image(one, scene)
    assert np.abs(after - original).sum() > 1e-3 * original.sum()
    assert_same(after, image(refscatter(), scene))
    changed(scene, key, lambda _: before)
    again = image(one, scene)
    assert_same(again, image(refscatter(), scene))
    if name != "vertices moved":
        assert_same(again, original)


@pytest.mark.parametrize("kind", ["sphere", "cube"])
def test_an_obstacle_moves(rgb, tmp_path, kind):
    """Into the light's way and out of it again."""
    parts = {
        "type": "scene",
        "light": build.point_light((-2.6, 2.4, -0.9)),
        "body": build.mesh_shape(icosphere(3), tmp_path / "m.ply"),
    }
    away, between = ([-1.5 + x, 1.4, -0.5] for x in (-20.0, 0.0))
    shape = mi.ScalarTransform4f().scale(0.4)
    parts["wall"] = {
        "type": kind,
        "bsdf": {"type": "diffuse"},
        "to_world": mi.ScalarTransform4f().translate(away) @ shape,
    }
    parts["sensor"] = {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at([0, 1.1, 5.2], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 16, "height": 16},
    }
    scene, one = mi.load_dict(parts, optimize=False), refscatter()
    lit, found = image(one, scene), []
    for there in (between, away):
        parameters = mi.traverse(scene)
        if kind == "sphere":
            parameters["wall.to_world"] = mi.Transform4f().translate(there) @ mi.Transform4f(shape)
        else:
            x = np.array(parameters["wall.vertex_positions"]).reshape(-1, 3)
            parameters["wall.vertex_positions"] = mi.Float((x - x.mean(0) + there).astype(np.float32).ravel())
        parameters.update()
        found.append(image(one, scene))
        assert_same(found[-1], image(refscatter(), scene))
    assert found[0].sum() < 0.9 * lit.sum()
    assert np.abs(found[1] - lit).sum() < 1e-3 * lit.sum()


@pytest.mark.slow
def test_two_scenes_with_one_integrator(rgb, tmp_path):
    first, second = load(tmp_path, "bumpy_sphere", 5120, 16), load(tmp_path, "branches", 5120, 16)
    one = refscatter()
    for scene in (first, second, first, second):
        assert_same(image(one, scene), image(refscatter(), scene))


def test_bodies_are_told_apart(rgb, tmp_path):
    """Two bodies of one mesh, different in place and index."""
    parts = {"type": "scene", "light": build.point_light((-2.6, 2.4, -0.9))}
    for k, (x, eta) in enumerate(((-1.2, 1.3), (1.2, 1.7))):
        shift = mi.ScalarTransform4f().translate([x, 0, 0])
        parts[f"body{k}"] = build.mesh_shape(icosphere(3), tmp_path / "m.ply", eta, to_world=shift)
    o, d = build.rays_at((0.0, 1.1, 5.2), 2.0, 300, seed=2)
    both = build.single_scattering(mi.load_dict(parts), o, d, internal_bounces=0, tolerance=0.0)
    alone = 0
    for k in (0, 1):
        other = {**parts, f"body{1 - k}": {**parts[f"body{1 - k}"], "bsdf": {"type": "null"}}}
        other[f"body{1 - k}"].pop("interior")
        alone = alone + build.single_scattering(mi.load_dict(other), o, d, internal_bounces=0, tolerance=0.0)
    meets = (alone.sum(axis=1) > 0) & (both.sum(axis=1) > 0)
    assert meets.sum() > 50
    assert np.median(np.abs(both - alone).sum(axis=1)[meets] / alone.sum(axis=1)[meets]) < 1e-3

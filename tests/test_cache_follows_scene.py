"""What an integrator keeps from render to render follows the scene: after each change its image, and the light beams
that it takes, are those of a fresh integrator."""

from dataclasses import replace

import build
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from meshes import Mesh, bumpy_sphere, triangle_grid
from test_reproducible import assert_same

from mitsuba_refscatter import options
from mitsuba_refscatter.core.cache import Cache
from mitsuba_refscatter.integrators.hooks import Hooks
from mitsuba_refscatter.integrators.prepared import Prepared, prepare
from mitsuba_refscatter.light import light_samples
from mitsuba_refscatter.light.beams import BEAM

LAMP = (-2.6, 2.4, -0.9)


def look(origin, target=(0.0, 0.0, 0.0)):
    return mi.ScalarTransform4f().look_at(list(origin), list(target), [0.1, 1, 0.2])


def camera(origin):
    film = {"type": "hdrfilm", "width": 12, "height": 12}
    return {"type": "perspective", "fov": 30, "to_world": look(origin), "film": film}


def refscatter():
    return mi.load_dict({"type": "refscatter", "surfaces": False, "internal_bounces": 0, "tolerance": 0.1})


@pytest.fixture
def ball(rgb, tmp_path):
    """``ball(...)``: a scene whose body has a coarse mesh."""
    mesh = bumpy_sphere(4, 0.1, 4.0)

    def scene(**parts):
        body = build.mesh_shape(mesh, tmp_path / "m.ply", g=0.0)
        cone = {"cutoff_angle": 25.0, "beam_width": 20.0, "intensity": {"type": "rgb", "value": 10.0}}
        parts = {"light": {"type": "spot", "to_world": look(LAMP), **cone}, **parts}
        return mi.load_dict({"type": "scene", "body": body, "sensor": camera((0, 1.1, 5.2)), **parts}, optimize=False)

    return scene


@pytest.fixture
def render(monkeypatch):
    """``render(integrator, scene, sensor)``: the image, and the numbers of light beams of each light in use."""
    find, taken = Prepared.culled, []

    def seen(prepared, *what):
        shadows, culling = find(prepared, *what)
        taken.append([dr.width(one.records) // BEAM for _, one in culling.by_share()])
        return shadows, culling

    def render(integrator, scene, sensor=0, hooks=None):
        taken.clear()
        image = np.array(integrator.render(scene, sensor, seed=1, spp=1, hooks=hooks), dtype=np.float64)
        return image, list(taken)

    monkeypatch.setattr(Prepared, "culled", seen)
    return render


def change(scene, key, value):
    """Sets a parameter; what it was."""
    parameters = mi.traverse(scene)
    before = parameters[key]
    before = before if isinstance(before, float) else type(before)(before)  # a copy
    parameters[key] = value(before)
    parameters.update()
    return before


CHANGES = {
    "light": ("light.to_world", lambda t: mi.Transform4f(look((3, 2, 3)))),
    "cone": ("light.beam_width", lambda angle: 5.0),
    "camera": ("sensor.to_world", lambda t: mi.Transform4f(look((3, -3, 1)))),
    "extinction": ("body.interior_medium.sigma_t.value.value", lambda x: mi.Color3f(30)),
    "phase function": ("body.interior_medium.phase_function.g", lambda g: mi.Float(0.9)),
    "index": ("body.bsdf.eta", lambda eta: 2.0),
}


def test_light_beams_follow_the_scene(ball, render):
    """Light, camera, medium and boundary are changed one at a time."""
    scene, one = ball(), refscatter()
    # First by a camera that is no part of the scene: when it is changed for another, nothing of that changes.
    render(one, scene, mi.load_dict(camera((3, -3, 1))))
    (original, found), (fresh, numbers) = render(one, scene), render(refscatter(), scene)
    assert len(numbers) == 1 and found == numbers
    assert_same(original, fresh)
    different = set()
    for name, (key, value) in CHANGES.items():
        before = change(scene, key, value)
        image, found = render(one, scene)
        fresh, wanted = render(refscatter(), scene)
        assert len(wanted) == 1 and found == wanted, name
        assert_same(image, fresh)
        assert np.abs(image - original).sum() > 1e-2 * original.sum()
        different |= {name} if wanted != numbers else set()
        change(scene, key, lambda _: before)
    assert {"light", "extinction"} <= different and "camera" not in different


def test_light_beams_of_a_point_are_kept(ball, render):
    """They are made once, and again where the light has moved."""
    scene, one = ball(light=build.point_light(LAMP)), refscatter()
    original, _ = render(one, scene)
    made = dict(one.cache._now)
    assert_same(render(one, scene)[0], original)
    assert all(made.get(key) is value for key, value in one.cache._now.items())
    change(scene, "light.position", lambda _: mi.Point3f(3, 2, 3))
    assert_same(render(one, scene)[0], render(refscatter(), scene)[0])
    assert any(made.get(key) is not value for key, value in one.cache._now.items())


def test_light_beams_and_triangles_are_kept_apart(ball, render):
    """Where the medium is dense triangles are taken for the same light, and light beams again afterwards."""
    scene, one = ball(light=build.point_light(LAMP)), refscatter()
    key, value = CHANGES["extinction"]
    before, thin = change(scene, key, lambda x: x), render(one, scene)[0]
    change(scene, key, value)
    assert_same(render(one, scene)[0], render(refscatter(), scene)[0])
    change(scene, key, lambda _: before)
    assert_same(render(one, scene)[0], thin)


@pytest.mark.slow
def test_light_beams_follow_the_accuracy(ball, render):
    scene, one, fresh = ball(light=build.point_light(LAMP)), refscatter(), refscatter()
    _, numbers = render(one, scene)
    fine = Hooks(accuracy={"cells": 0.005})
    (image, found), (expected, wanted) = render(one, scene, hooks=fine), render(fresh, scene, hooks=fine)
    assert found == wanted != numbers
    assert_same(image, expected)


def assert_follows(render, first, second):
    """One integrator renders the first and then the second scene, which may be the same object, as a fresh one does."""
    one = refscatter()
    before, _ = render(one, first())
    scene = second()
    (image, found), (fresh, wanted) = render(one, scene), render(refscatter(), scene)
    assert found == wanted
    assert_same(image, fresh)
    assert np.abs(fresh - before).sum() > 1e-3 * before.sum()


def at(scene, key, value):
    """The scene, which gets another value of a parameter when it is called."""
    return lambda: (change(scene, key, lambda _: value), scene)[1]


def scaled(place, size):
    return mi.ScalarTransform4f().translate(place) @ mi.ScalarTransform4f().scale(size)


def test_cells_follow_what_touches_the_body(ball, render):
    """Something on the boundary hides it from the rays that find it from the coarse mesh."""
    scene = ball(knob={"type": "sphere", "bsdf": {"type": "diffuse"}})
    places = [mi.Transform4f(scaled(x, 0.45)) for x in ([-0.6, 0.5, 0.6], [5.0, 5.0, 5.0])]
    assert_follows(render, *(at(scene, "knob.to_world", place) for place in places))


@pytest.mark.slow
def test_another_body_moves(ball, render):
    scene = ball(other={"type": "sphere", "bsdf": {"type": "dielectric"}})
    places = [mi.Transform4f(scaled(x, 0.4)) for x in ([5.0, 5.0, 5.0], [-1.5, 1.4, -0.5])]
    assert_follows(render, *(at(scene, "other.to_world", place) for place in places))


@pytest.mark.slow
def test_an_obstacle_of_another_kind(ball, render):
    """In the same place."""
    block = {"to_world": scaled([-1.5, 1.4, -0.5], 0.4), "bsdf": {"type": "diffuse"}}
    assert_follows(render, *(lambda kind=kind: ball(block={"type": kind, **block}) for kind in ("disk", "sphere")))


def test_light_beams_follow_how_deep_one_sees(rgb, tmp_path, render):
    """Water without end: the size of what its surface lights depends on the medium."""
    uv, faces = triangle_grid(40)
    x, y = 4 * uv.T - 2
    slope = 0.02 * np.cos(2 * x), 0.02 * np.cos(2 * y)
    normals = np.stack([-slope[0], -slope[1], np.ones_like(x)], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    mesh = Mesh(np.stack([x, y, 0.01 * (np.sin(2 * x) + np.sin(2 * y))], axis=1), faces, normals)
    water = build.mesh_shape(mesh, tmp_path / "water.ply", sigma_t=(0.5, 0.5, 0.5))
    parts = {"body": water, "light": build.point_light((1, 1, 3)), "sensor": camera((0, -3, 3))}
    scene = mi.load_dict({"type": "scene", **parts})
    key = next(key for key, _ in mi.traverse(scene) if key.endswith("sigma_t.value.value"))

    assert_follows(render, *(at(scene, key, mi.Color3f(x)) for x in (100.0, 0.5)))


def test_nothing_is_kept_of_points_that_are_drawn(rgb, tmp_path):
    """They are others in each pass: to keep their light beams would take memory without end."""
    lamp = {"type": "sphere", "center": [0, 0, 3], "emitter": {"type": "area"}}
    body = build.mesh_shape(bumpy_sphere(2, 0.2), tmp_path / "m.ply")
    scene = mi.load_dict({"type": "scene", "body": body, "lamp": lamp})
    prepared = prepare(scene, options.Options(), Cache(), lambda: 0)
    (region,), (emitter,) = prepared.scene.regions, prepared.scene.emitters
    counts = []
    for x in (0.3, 0.5, 0.7):
        point = light_samples.draw(emitter, mi.Point2f(x, 0.98), 1.0)
        assert prepared.illuminated(region.boundaries[0], region, point, emitter)[1] is not None
        counts.append(len(prepared.cache._now))
    assert counts[0] > 0 and len(set(counts)) == 1
    prepared.illuminated(
        region.boundaries[0],
        region,
        replace(point, shape=None, normal=None),
        replace(emitter, place=point.local(mi.Point3f(0))),
    )
    assert len(prepared.cache._now) == counts[0] + 1

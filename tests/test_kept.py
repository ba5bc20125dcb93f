"""What an integrator keeps from render to render follows the scene: after each change its image, and the coarse mesh that it takes, are
those of a fresh integrator."""

import build
import mitsuba as mi
import numpy as np
import pytest
from meshes import Mesh, bumpy_sphere, triangle_grid
from test_same_again import assert_same

from mitsuba_refscatter.integrators import lit

LAMP = (-2.6, 2.4, -0.9)


def look(origin, target=(0.0, 0.0, 0.0)):
    return mi.ScalarTransform4f().look_at(list(origin), list(target), [0.1, 1, 0.2])


def refscatter():
    return mi.load_dict({"type": "refscatter", "surfaces": False, "internal_bounces": 0, "tolerance": 0.1})


@pytest.fixture
def ball(rgb, tmp_path):
    """``ball(...)``: a scene whose body has coarser meshes."""
    mesh = bumpy_sphere(4, 0.1, 4.0)

    def scene(origin=(0, 1.1, 5.2), **parts):
        film = {"type": "hdrfilm", "width": 12, "height": 12}
        sensor = {"type": "perspective", "fov": 30, "to_world": look(origin), "film": film}
        body = build.mesh_shape(mesh, tmp_path / "m.ply", g=0.0)
        parts = {"light": build.point_light(LAMP), **parts}
        return mi.load_dict({"type": "scene", "body": body, "sensor": sensor, **parts}, optimize=False)

    return scene


@pytest.fixture
def render(monkeypatch):
    """``render(integrator, scene)``: the image, and of each coarse mesh in use the number of its triangles."""
    instead, taken = lit.Prepared.instead, []

    def seen(self, body, *rest):
        found = instead(self, body, *rest)
        assert found is body or (found.stands_for is body and found.triangle_count < 0.2 * body.triangle_count)
        if found.stands_for is not None:
            taken.append(found.triangle_count)
        return found

    def render(integrator, scene):
        taken.clear()
        image = np.array(integrator.render(scene, seed=1, spp=1), dtype=np.float64)
        return image, list(taken)

    monkeypatch.setattr(lit.Prepared, "instead", seen)
    return render


def change(scene, key, value):
    """Sets a parameter; what it was."""
    parameters = mi.traverse(scene)
    before = parameters[key]
    before = before if isinstance(before, float) else type(before)(before)
    parameters[key] = value(before)
    parameters.update()
    return before


def stretched(vertices):
    return mi.Float((np.array(vertices).reshape(-1, 3) * [0.8, 1.0, 1.2]).ravel())


CHANGES = {
    "light": ("light.position", lambda p: mi.Point3f(3, 2, 3)),
    "camera": ("sensor.to_world", lambda t: mi.Transform4f(look((3, -3, 1)))),
    "extinction": ("body.interior_medium.sigma_t.value.value", lambda x: mi.Color3f(30)),
    "albedo": ("body.interior_medium.albedo.value.value", lambda x: mi.Color3f(0.01, 0.9, 0.01)),
    "phase function": ("body.interior_medium.phase_function.g", lambda g: mi.Float(0.9)),
    "index": ("body.bsdf.eta", lambda eta: 2.0),
    "mesh": ("body.vertex_positions", stretched),
}


def test_the_coarse_mesh_follows_the_scene(ball, render):
    """Light, camera, medium and boundary are changed one at a time. A coarse mesh is in use all the time, often another one."""
    scene, one = ball(), refscatter()
    original, levels = render(one, scene)
    assert len(levels) == 1
    different = set()
    for name, (key, value) in CHANGES.items():
        before = change(scene, key, value)
        image, found = render(one, scene)
        fresh, wanted = render(refscatter(), scene)
        assert len(wanted) == 1 and found == wanted, name
        assert_same(image, fresh)
        assert np.abs(image - original).sum() > 1e-2 * original.sum()
        different |= {name} if wanted != levels else set()
        change(scene, key, lambda _: before)
    assert {"light", "camera", "extinction"} <= different


def assert_follows(render, scenes):
    """One integrator renders scenes as fresh ones do, and these are different."""
    one, images = refscatter(), []
    for scene in scenes:
        image, found = render(one, scene)
        fresh, wanted = render(refscatter(), scene)
        assert found == wanted
        assert_same(image, fresh)
        images.append(fresh)
    for a, b in zip(images, images[1:]):
        assert np.abs(a - b).sum() > 1e-3 * a.sum()


def moved(scene, key, places):
    """The scene with a shape in one place after the other."""
    for place in places:
        change(scene, key, lambda _, place=place: mi.Transform4f(place))
        yield scene


def test_patches_follow_what_touches_the_body(ball, render):
    """Something on the boundary hides it from the rays that find a patch's middle."""
    V = mi.ScalarTransform4f()
    places = [V.translate(x) @ V.scale(0.45) for x in ([-0.6, 0.5, 0.6], [5.0, 5.0, 5.0])]
    scene = ball(knob={"type": "sphere", "bsdf": {"type": "diffuse"}})
    assert_follows(render, moved(scene, "knob.to_world", places))


def test_another_body_moves(ball, render, tmp_path):
    V = mi.ScalarTransform4f()
    other = {"type": "sphere", "bsdf": {"type": "dielectric"}}
    places = [V.translate(x) @ V.scale(0.4) for x in ([5.0, 5.0, 5.0], [-1.5, 1.4, -0.5])]
    assert_follows(render, moved(ball(other=other), "other.to_world", places))


def test_a_spot_gets_narrower(ball, render):
    def spot(angle):
        cone = {"cutoff_angle": angle, "beam_width": angle - 1}
        return {
            "type": "spot",
            "to_world": look(LAMP, (0.2, 0.1, 0.2)),
            "intensity": {"type": "rgb", "value": 10.0},
            **cone,
        }

    assert_follows(render, (ball(light=spot(angle)) for angle in (25.0, 5.0)))


def test_an_obstacle_of_another_kind(ball, render):
    """In the same place."""
    place = mi.ScalarTransform4f().translate([-1.5, 1.4, -0.5]) @ mi.ScalarTransform4f().scale(0.4)
    kinds = ("sphere", "disk")
    assert_follows(
        render, (ball(block={"type": kind, "to_world": place, "bsdf": {"type": "diffuse"}}) for kind in kinds)
    )


def test_coarse_meshes_follow_how_deep_one_sees(rgb, tmp_path, render):
    """Water without end: the size of what its surface lights depends on the medium."""
    uv, faces = triangle_grid(40)
    x, y = 4 * uv.T - 2
    slope = 0.02 * np.cos(2 * x), 0.02 * np.cos(2 * y)
    normals = np.stack([-slope[0], -slope[1], np.ones_like(x)], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    mesh = Mesh(np.stack([x, y, 0.01 * (np.sin(2 * x) + np.sin(2 * y))], axis=1), faces, normals)
    film = {"type": "hdrfilm", "width": 12, "height": 12}
    sensor = {"type": "perspective", "fov": 30, "to_world": look((0, -3, 3)), "film": film}
    water = build.mesh_shape(mesh, tmp_path / "water.ply", sigma_t=(0.5, 0.5, 0.5))
    scene = mi.load_dict({"type": "scene", "body": water, "light": build.point_light((1, 1, 3)), "sensor": sensor})
    key = next(key for key, _ in mi.traverse(scene) if key.endswith("sigma_t.value.value"))

    def scenes():
        for sigma_t in (100.0, 0.5):
            change(scene, key, lambda _, x=sigma_t: mi.Color3f(x))
            yield scene

    assert_follows(render, scenes())

"""What is not supported is refused in one sentence: which object, why, what to do. Never a wrong image."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from faults import BALL, Maker, amber, at, glass, moved, rectangle, refused, render, sensor
from meshes import box


@pytest.fixture
def make(rgb, tmp_path):
    return Maker(tmp_path)


# ---- Nested integrators ---------------------------------------------------------------------

NESTED = [
    {"type": "volpath"},
    {"type": "path"},
    {"type": "moment", "of": {"type": "volpath"}},
    {"type": "refscatter"},
    {"type": "ptracer"},
]


@pytest.mark.parametrize("nested", NESTED, ids=lambda nested: nested["type"])
def test_nested_integrators_are_left_out(make, nested, capfd):
    """One warning names each; the image is that without it."""
    scene, alone = make.scene(), mi.load_dict({"type": "refscatter"})
    with_it = mi.load_dict({"type": "refscatter", "inside": nested})
    told = [line for line in capfd.readouterr().out.splitlines() if "left out" in line]
    assert len(told) == 1 and "remove it" in told[0]
    a, b = (np.array(x.render(scene, seed=1, spp=1)) for x in (alone, with_it))
    np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6 * a.max())


def test_other_nested_plugins_are_refused(make):
    refused(
        lambda: make.scene(integrator={"type": "refscatter", "inside": {"type": "diffuse"}}), "nested", "integrator"
    )


# ---- Boundaries and media -------------------------------------------------------------------


def checkerboard():
    return {"type": "checkerboard"}


def bitmap(channels):
    """A texture with derivatives: Dr.Jit calls BSDFs of all scenes in memory, and one without them ends the tests
    that come after."""
    return {"type": "bitmap", "raw": True, "data": mi.TensorXf(np.full((2, 2, channels), 0.5))}


def grid():
    return {
        "type": "gridvolume",
        "grid": mi.VolumeGrid(np.linspace(0.1, 0.9, 27, dtype=np.float32).reshape(3, 3, 3, 1)),
    }


def around(kind, **more):
    return {"type": kind, "inside": glass(), **more}


def blend(kind, a, b):
    return {"type": kind, "weight": 0.5, "a": {"type": a}, "b": {"type": b}}


# BSDFs of the ball, and words that the message must hold beside the ball's name.
BOUNDARIES = {
    "rough dielectric": (lambda: {"type": "roughdielectric"}, ["RoughDielectric", "smooth"]),
    "diffuse": (lambda: {"type": "diffuse"}, ["Diffuse", "dielectric"]),
    "conductor": (lambda: {"type": "conductor"}, ["Conductor", "dielectric"]),
    "mask": (lambda: around("mask", opacity=0.5), ["mask", "dielectric"]),
    "bumpmap": (lambda: around("bumpmap", bumps=bitmap(1)), ["bumpmap", "dielectric"]),
    "normalmap": (lambda: around("normalmap", normalmap=bitmap(3)), ["normalmap", "dielectric"]),
    "blend": (lambda: blend("blendbsdf", "dielectric", "diffuse"), ["blendbsdf", "dielectric"]),
    "texture": (lambda: glass(specular_transmittance=checkerboard()), ["specular_transmittance", "constant"]),
    "index 0": (lambda: glass(int_ior=0.0), ["index of refraction", "positive"]),
    "index NaN": (lambda: glass(int_ior=float("nan")), ["index of refraction", "nan", "positive"]),
}
MEDIA = {
    "heterogeneous": (lambda: {"type": "heterogeneous", "sigma_t": grid()}, ["Heterogeneous", "homogeneous"]),
    "albedo varies": (lambda: amber(albedo=grid()), ["albedo", "constant"]),
    "sigma_t varies": (lambda: amber(sigma_t=grid()), ["sigma_t", "constant"]),
    "sigma_t < 0": (lambda: amber(sigma_t=-1.0), ["sigma_t", "negative"]),
    "scale < 0": (lambda: amber(scale=-1.0), ["scale", "negative"]),
    "sigma_t NaN": (lambda: amber(sigma_t=float("nan")), ["sigma_t", "finite"]),
    "albedo > 1": (lambda: amber(albedo=2.0), ["albedo", "[0, 1]"]),
    "hg NaN": (lambda: amber(phase={"type": "hg", "g": float("nan")}), ["g", "(-1, 1)"]),
    "phase varies": (
        lambda: amber(phase={**blend("blendphase", "hg", "isotropic"), "weight": grid()}),
        ["phase_function", "constant"],
    ),
}


@pytest.mark.parametrize("name", BOUNDARIES)
def test_boundary(make, name):
    bsdf, words = BOUNDARIES[name]
    refused(lambda: make.scene(ball=make.ball(bsdf=bsdf())), '"ball"', *words)


@pytest.mark.parametrize("name", MEDIA)
def test_medium(make, name):
    medium, words = MEDIA[name]
    refused(lambda: make.scene(ball=make.ball(interior=medium())), '"ball"', *words)


def test_other_parts_of_a_body(make):
    masked = around("mask", opacity=0.5)
    for changes, words in (
        ({"interior": None, "bsdf": masked}, ["mask", "plain dielectric"]),
        ({"emitter": {"type": "area", "radiance": 1.0}}, ["emitter", "remove the emitter"]),
    ):
        refused(lambda: make.scene(ball=make.ball(**changes)), '"ball"', *words)


def test_no_scattering_body(make):
    for changes in ({"ball": None}, {"ball": make.ball(interior=None)}):
        refused(lambda: make.scene(**changes), "no body with a medium", "dielectric", "homogeneous")


@pytest.mark.parametrize("kind", ["diffuse", "roughconductor", "roughdielectric", "plastic", "principled"])
def test_plain_objects_are_welcome(make, kind):
    """They cast shadows; far from the light's way they change nothing but how far rays start off a surface."""
    beside = make.scene(other={"type": "cube", "to_world": at(4), "bsdf": {"type": kind}})
    np.testing.assert_allclose(render(beside), render(make.scene()), rtol=1e-2, atol=1e-5)


OVERLAPPING = moved(BALL, 1.2)


@pytest.mark.parametrize("merged", [False, True], ids=["two shapes", "merged"])
def test_bodies_that_overlap(make, merged):
    """Merged by the loader or not: meshes of one material become one shape unless told otherwise."""
    other = make.ball(OVERLAPPING, eta=1.5 if merged else 1.3)
    refused(lambda: make.scene(optimize=merged, other=other), "overlaps", "separate them")


def test_bars_that_cross(make):
    """No corner of one is inside of the other: found by the camera's rays."""
    size = {"ball": np.array([2.0, 0.3, 0.3]), "other": np.array([0.3, 2.0, 0.31])}
    bars = {name: make.ball(box(-half, half), eta=1.3 if name == "ball" else 1.5) for name, half in size.items()}
    refused(lambda: make.scene(**bars), "overlaps", "separate them")


def test_a_body_inside_another_without_exterior(make):
    inner = make.ball(moved(BALL, 0.1, scale=0.4), eta=1.3)
    refused(lambda: make.scene(inner=inner), '"inner"', 'inside shape "ball"', "exterior")
    same = make.ball(moved(BALL, 0.1, scale=0.4))
    refused(lambda: make.scene(optimize=True, other=same), "inside", "winds the same way")


def test_an_open_surface_inside_a_body(make):
    """It must say on both sides what is around it; then it is no more than a pane."""
    pane = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(0.2), "bsdf": glass(int_ior=1.2)}
    refused(lambda: make.scene(pane=pane), '"pane"', 'inside shape "ball"', "interior")
    around = {"type": "ref", "id": "around"}
    inside = {"a_medium": {**amber(), "id": "around"}, "ball": make.ball(interior=around)}
    refused(lambda: make.scene(**inside, pane={**pane, "interior": around}), '"pane"', "no exterior medium")
    image = render(make.scene(**inside, pane={**pane, "interior": around, "exterior": around}))
    alone = render(make.scene(**inside))
    assert 0.5 * alone.mean() < image.mean() < alone.mean()  # it throws a shadow


# ---- Lights, camera, gradients --------------------------------------------------------------


def test_light_that_is_not_supported(make):
    """It is named by its shape: the light itself has no name of its own."""
    panel = rectangle(emitter={"type": "directionalarea", "radiance": 1.0})
    refused(lambda: make.scene(panel=panel), '"panel"', "DirectionalArea", "use a point")


def test_any_light_where_nothing_scatters(make):
    """An absorbing body with an area light needs no point light, and its own image is black."""
    panel = rectangle(emitter={"type": "area", "radiance": 1.0})
    image = render(make.scene(lamp=None, panel=panel, ball=make.ball(interior=amber(albedo=0.0))))
    assert (image == 0).all()


def test_camera_in_another_medium(make):
    refused(lambda: make.scene(sensor=sensor(medium=amber())), '"ball"', "sensor", "exterior")
    inside = sensor((0.1, 0.1, 0.2), medium={**amber(), "id": "oil"})
    refused(lambda: make.scene(sensor=inside), "camera", '"ball"', 'names the medium "oil"', "move it out")


@pytest.mark.parametrize("key", ["ball.vertex_positions", "ball.interior_medium.albedo.value.value", "lamp.position"])
def test_gradients(make, key):
    scene = make.scene()
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters[key])
    parameters.update()
    refused(lambda: scene, "gradients", key, "disable_grad")

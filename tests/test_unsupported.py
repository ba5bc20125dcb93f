"""What is not supported is refused in one sentence: which object, why, what to do. Never a wrong image."""

import re

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from faults import BALL, Maker, amber, at, glass, moved, rectangle, refused, render, sensor


@pytest.fixture
def make(rgb, tmp_path):
    return Maker(tmp_path)


# ---- Nested integrators ---------------------------------------------------------------------

NESTED = [
    ({"type": "volpath"}, ["media", "twice", "use path"]),
    ({"type": "volpathmis"}, ["media", "twice", "use path"]),
    ({"type": "prbvolpath"}, ["media", "twice", "use path"]),
    ({"type": "moment", "of": {"type": "volpath"}}, ["media", "twice", "use path"]),
    ({"type": "aov", "aovs": "d:depth", "of": {"type": "volpath"}}, ["media", "twice", "use path"]),
    ({"type": "refscatter"}, ["twice", "use path"]),
    ({"type": "ptracer"}, ["along rays", "use path"]),
    ({"type": "diffuse"}, ["nested", "integrator"]),
]


@pytest.mark.parametrize(
    "nested, words", NESTED, ids=["-".join(re.findall(r"'type': '(\w+)'", str(n))) for n, _ in NESTED]
)
def test_nested_integrator(make, nested, words):
    refused(lambda: make.scene(integrator={"type": "refscatter", "surfaces": False, "inside": nested}), *words)


def test_two_nested_integrators(make):
    two = {"a": {"type": "path"}, "b": {"type": "direct"}}
    refused(lambda: make.scene(integrator={"type": "refscatter", **two}), "more than one", "give one")


# ---- Boundaries and media -------------------------------------------------------------------


def checkerboard():
    return {"type": "checkerboard"}


def tilted():
    return {"type": "bitmap", "raw": True, "data": mi.TensorXf(np.full((2, 2, 3), 0.5))}


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
    "null": (lambda: {"type": "null"}, ["Null", "use dielectric"]),
    "thin": (lambda: {"type": "thindielectric"}, ["ThinDielectric", "use dielectric"]),
    "conductor": (lambda: {"type": "conductor"}, ["Conductor", "use dielectric"]),
    "mask": (lambda: around("mask", opacity=0.5), ["MaskBSDF", "dielectric"]),
    "bumpmap": (lambda: around("bumpmap", bumps=checkerboard()), ["BumpMap", "dielectric"]),
    "normalmap": (lambda: around("normalmap", normalmap=tilted()), ["NormalMap", "dielectric"]),
    "blend": (lambda: blend("blendbsdf", "dielectric", "diffuse"), ["BlendBSDF", "dielectric"]),
    "transmittance": (lambda: glass(specular_transmittance=0.5), ["specular_transmittance", "remove it"]),
    "reflectance": (lambda: glass(specular_reflectance=0.5), ["specular_reflectance", "remove it"]),
    "texture": (lambda: glass(specular_transmittance=checkerboard()), ["specular_transmittance", "remove it"]),
    "index 0": (lambda: glass(int_ior=0.0), ["index of refraction", "positive"]),
    "index NaN": (lambda: glass(int_ior=float("nan")), ["index of refraction", "nan", "positive"]),
}
PHASES = "isotropic and hg"
MEDIA = {
    "heterogeneous": (lambda: {"type": "heterogeneous", "sigma_t": grid()}, ["Heterogeneous", "homogeneous"]),
    "albedo varies": (lambda: amber(albedo=grid()), ["albedo", "constant"]),
    "sigma_t varies": (lambda: amber(sigma_t=grid()), ["sigma_t", "constant"]),
    "sigma_t < 0": (lambda: amber(sigma_t=-1.0), ["sigma_t", "negative"]),
    "scale < 0": (lambda: amber(scale=-1.0), ["scale", "negative"]),
    "sigma_t NaN": (lambda: amber(sigma_t=float("nan")), ["sigma_t", "finite"]),
    "albedo > 1": (lambda: amber(albedo=2.0), ["albedo", "[0, 1]"]),
    "hg NaN": (lambda: amber(phase={"type": "hg", "g": float("nan")}), ["g", "(-1, 1)"]),
    "tabulated": (lambda: amber(phase={"type": "tabphase", "values": "1,2,3"}), ["Tabulated", PHASES]),
    "Rayleigh": (lambda: amber(phase={"type": "rayleigh"}), ["Rayleigh", PHASES]),
    "blend": (lambda: amber(phase=blend("blendphase", "hg", "isotropic")), ["Blend", PHASES]),
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
        ({"interior": None, "bsdf": masked}, ["MaskBSDF", "plain dielectric"]),
        ({"exterior": amber()}, ["exterior medium", "remove it"]),
        ({"emitter": {"type": "area", "radiance": 1.0}}, ["emitter", "remove"]),
    ):
        refused(lambda: make.scene(ball=make.ball(**changes)), '"ball"', *words)


def test_no_scattering_body(make):
    for changes in ({"ball": None}, {"ball": make.ball(interior=None)}):
        refused(lambda: make.scene(**changes), "no body with a medium", "dielectric", "homogeneous")


@pytest.mark.parametrize("medium", [None, amber()], ids=["clear", "medium"])
@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_analytic_shape(make, shape, medium):
    other = {"type": shape, "bsdf": glass(), "to_world": at(4), "interior": medium}
    other = {key: value for key, value in other.items() if value is not None}
    refused(lambda: make.scene(other=other), '"other"', shape, "triangle mesh", "ply or obj")


def test_instance(make):
    group = {"type": "shapegroup", "id": "group", "ball": make.ball()}
    copy = {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}}
    refused(lambda: make.scene(ball=None, group=group, copy=copy), '"copy"', "instance", "mesh of its own")


@pytest.mark.parametrize("kind", ["conductor", "thindielectric", "null"])
def test_mirrors_and_windows(make, kind):
    other = {"type": "cube", "to_world": at(4), "bsdf": {"type": kind}}
    refused(lambda: make.scene(other=other), '"other"', "use dielectric")


@pytest.mark.parametrize("kind", ["diffuse", "roughconductor", "roughdielectric", "plastic", "principled"])
def test_plain_objects_are_welcome(make, kind):
    """They cast shadows; far from the light's way they change nothing but how far rays start off a surface."""
    beside = make.scene(other={"type": "cube", "to_world": at(4), "bsdf": {"type": kind}})
    np.testing.assert_allclose(render(beside), render(make.scene()), rtol=1e-2, atol=1e-5)


BESIDE = {"inside": moved(BALL, 0.1, scale=0.4), "overlapping": moved(BALL, 1.2)}


@pytest.mark.parametrize("merged", [False, True], ids=["two shapes", "merged"])
@pytest.mark.parametrize("mesh", BESIDE)
def test_bodies_that_are_not_apart(make, mesh, merged):
    """Merged by the loader or not: meshes of one material become one shape unless told otherwise."""
    other = make.ball(BESIDE[mesh], eta=1.5 if merged else 1.3)
    refused(lambda: make.scene(optimize=merged, other=other), "overlaps", "separate them")


# ---- Lights, camera, gradients --------------------------------------------------------------

LIGHTS = {
    "constant": lambda: {"type": "constant"},
    "envmap": lambda: {"type": "envmap", "bitmap": mi.Bitmap(np.ones((2, 4, 3), np.float32))},
    "spot": lambda: {"type": "spot", "to_world": mi.ScalarTransform4f().look_at([0, 5, 0], [0, 0, 0], [1, 0, 0])},
    "directional": lambda: {"type": "directional", "direction": [0, -1, 0]},
}


@pytest.mark.parametrize("kind", LIGHTS)
def test_other_lights(make, kind):
    refused(lambda: make.scene(extra=LIGHTS[kind]()), '"extra"', "point light", "replace it")


def test_area_light(make):
    """It is named by its shape: the light itself has no name of its own."""
    panel = rectangle(emitter={"type": "area", "radiance": 1.0})
    refused(lambda: make.scene(panel=panel), '"panel"', "point light", "replace it")


def test_any_light_where_nothing_scatters(make):
    """An absorbing body with an area light needs no point light, and its own image is black."""
    panel = rectangle(emitter={"type": "area", "radiance": 1.0})
    image = render(make.scene(lamp=None, panel=panel, ball=make.ball(interior=amber(albedo=0.0))))
    assert (image == 0).all()


def test_camera_in_a_medium(make):
    refused(lambda: make.scene(sensor=sensor(medium=amber())), "sensor", "medium", "remove it")


@pytest.mark.parametrize("key", ["ball.vertex_positions", "ball.interior_medium.albedo.value.value", "lamp.position"])
def test_gradients(make, key):
    scene = make.scene()
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters[key])
    parameters.update()
    refused(lambda: scene, "gradients", key, "disable_grad")

"""What cannot be rendered is refused in one sentence: which object, why, what to do. Never a wrong image."""

import os
import re
import subprocess
import sys
from pathlib import Path

import build
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from meshes import Mesh, icosphere

from mitsuba_refscatter import platform

ROOT = Path(__file__).parent.parent
BALL = icosphere(1)


def grey(value):
    return {"type": "rgb", "value": [value] * 3}


def amber(**changes):
    return {"type": "homogeneous", "sigma_t": grey(0.5), "albedo": grey(0.5), **changes}


def at(x, y=0.0, z=0.0):
    return mi.ScalarTransform4f().translate([x, y, z])


def rectangle(**more):
    return {"type": "rectangle", "to_world": at(0, 4), **more}


def sensor(origin=(0, 0, 5), target=(0, 0, 0), **more):
    return {
        "type": "perspective", "to_world": mi.ScalarTransform4f().look_at(list(origin), list(target), [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 8, "height": 8}, "sampler": {"type": "independent", "sample_count": 1}, **more,
    }  # fmt: skip


class Maker:
    """Scenes of a glass ball "ball" and a point light "lamp", with one thing wrong."""

    def __init__(self, folder):
        self.folder, self.count = folder, 0

    def ball(self, mesh=BALL, eta=1.5, **changes):
        """Description of a body; changes set to None leave a part out."""
        self.count += 1
        shape = build.mesh_shape(mesh, self.folder / f"mesh{self.count}.ply", eta=eta)
        return {key: value for key, value in {**shape, **changes}.items() if value is not None}

    def scene(self, load=True, optimize=False, **changes):
        parts = {"integrator": {"type": "refscatter", "surfaces": False}, "sensor": sensor(),
                 "lamp": build.point_light((-3, 3, 0)), "ball": self.ball(), **changes}  # fmt: skip
        parts = {"type": "scene", **{key: value for key, value in parts.items() if value is not None}}
        return mi.load_dict(parts, optimize=optimize) if load else parts


@pytest.fixture
def make(rgb, tmp_path):
    return Maker(tmp_path)


def render(scene):
    return np.array(scene.integrator().render(scene))


def refused(build_scene, *words):
    """Loading or rendering fails, with one sentence that holds these words."""
    with pytest.raises((RuntimeError, ValueError)) as caught:
        render(build_scene())
    sentence = str(caught.value)
    if "Traceback" in sentence:  # Mitsuba puts the traceback of a Python plugin before what the plugin said
        sentence = sentence.strip().splitlines()[-1]
    assert len(sentence.splitlines()) == 1 and len(sentence) < 320, sentence
    for word in words:
        assert word in sentence, sentence


def test_the_scene_without_faults_renders(make):
    assert render(make.scene()).max() > 1e-3


# ---- Options of the integrator --------------------------------------------------------------

OPTIONS = [
    ("tolerance", "x", ["float"]),
    ("tolerance", True, ["float"]),
    ("tolerance", -0.1, ["[0, 1]"]),
    ("tolerance", 2, ["[0, 1]"]),
    ("tolerance", float("nan"), ["nan", "[0, 1]"]),
    ("tolerance", [1, 2, 3], ["float"]),
    ("internal_bounces", 2.5, ["integer"]),
    ("internal_bounces", "4", ["integer"]),
    ("internal_bounces", -1, ["[0, 64]"]),
    ("internal_bounces", 65, ["[0, 64]"]),
    ("surfaces", 1, ["boolean"]),
    ("surfaces", "yes", ["boolean"]),
    ("estimator", "points", ["curve"]),
    ("estimator", 1, ["string"]),
    ("culling", "spindle", ["beams"]),
    ("aovs", "single_scatter, depths", ["depths", "contributions"]),
    ("aovs", 3, ["string"]),
    ("hide_emitters", "x", ["boolean"]),
]


@pytest.mark.parametrize("name, value, words", OPTIONS, ids=[f"{name}={value}" for name, value, _ in OPTIONS])
def test_option(make, name, value, words):
    refused(lambda: make.scene(integrator={"type": "refscatter", name: value}), f'"{name}"', *words)


def test_unknown_option(make):
    with pytest.raises(RuntimeError, match='unreferenced property(.|\n)*"tolerence"'):
        make.scene(integrator={"type": "refscatter", "tolerence": 0.1})


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


# ---- Meshes ---------------------------------------------------------------------------------


def with_value(mesh, name, value):
    """The mesh with one entry of ``name`` replaced."""
    changed = {**vars(mesh), name: getattr(mesh, name).copy()}
    changed[name][3] = value
    return Mesh(**changed)


def with_faces(faces):
    return Mesh(BALL.vertices, faces, BALL.normals)


def moved(mesh, x, y=0.0, z=0.0, scale=1.0):
    return Mesh(scale * mesh.vertices + [x, y, z], mesh.faces, mesh.normals)


FLAT = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 1]]), None)
FLIPPED = np.concatenate([BALL.faces[1:], BALL.faces[:1, ::-1]])
MESHES = {
    "NaN in a normal": (with_value(BALL, "normals", np.nan), ["normals", "not finite", "face_normals"]),
    "a normal is zero": (with_value(BALL, "normals", 0), ["normals", "zero", "face_normals"]),
    "no triangles": (with_faces(BALL.faces[:0]), ["no triangles"]),
    "a hole": (with_faces(BALL.faces[1:]), ["hole", "close it"]),
    "one triangle": (with_faces(BALL.faces[:1]), ["hole", "close it"]),
    "a triangle is turned": (with_faces(FLIPPED), ["inconsistent", "orientation"]),
    "a triangle comes twice": (with_faces(np.concatenate([BALL.faces, BALL.faces[:1]])), ["more than one"]),
    "no volume": (FLAT, ["volume"]),
}


@pytest.mark.parametrize("name", MESHES)
def test_mesh(make, name):
    mesh, words = MESHES[name]
    refused(lambda: make.scene(ball=make.ball(mesh)), '"ball"', *words)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_vertices_that_are_not_finite(make, value):
    """In a file Mitsuba's loader finds them, later we do."""
    broken = with_value(BALL, "vertices", value)
    refused(lambda: make.scene(ball=make.ball(broken)), "mesh1.ply", "invalid vertex position")
    scene = make.scene()
    parameters = mi.traverse(scene)
    parameters["ball.vertex_positions"] = broken.vertices.astype(np.float32).ravel()
    parameters.update()
    refused(lambda: scene, '"ball"', "vertices", "not finite")


def test_missing_mesh_file(make):
    refused(lambda: make.scene(ball=make.ball(filename="nowhere.ply")), "nowhere.ply", "not found")


def test_no_normals(make):
    """Mitsuba's loaders give a mesh without normals interpolated ones, unless asked for facet normals."""
    without = Mesh(BALL.vertices, BALL.faces, None)
    made, facets = (render(make.scene(ball=make.ball(without, face_normals=x))) for x in (False, True))
    smooth, flat = (render(make.scene(ball=make.ball(BALL, face_normals=x))) for x in (False, True))
    np.testing.assert_allclose(made, smooth, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(facets, flat, rtol=1e-5, atol=1e-7)
    assert np.abs(smooth - flat).max() > 0.01 * flat.max()


def test_merged_shapes_are_named_by_place(make):
    """The loader merges meshes of one material and forgets their names."""
    glass = {"bsdf": {"type": "ref", "id": "glass"}, "interior": {"type": "ref", "id": "amber"}}
    hole = make.ball(moved(with_faces(BALL.faces[1:]), 4), **glass)
    parts = {"glass": {"type": "dielectric"}, "amber": amber(), "ball": make.ball(**glass), "other": hole}
    refused(lambda: make.scene(optimize=True, **parts), "(2, 0, 0)", "159 triangles", "Dielectric", "hole")


BESIDE = {"inside": moved(BALL, 0.1, scale=0.4), "overlapping": moved(BALL, 1.2)}


@pytest.mark.parametrize("merged", [False, True], ids=["two shapes", "merged"])
@pytest.mark.parametrize("mesh", BESIDE)
def test_bodies_that_are_not_apart(make, mesh, merged):
    """Merged by the loader or not: meshes of one material become one shape unless told otherwise."""
    other = make.ball(BESIDE[mesh], eta=1.5 if merged else 1.3)
    refused(lambda: make.scene(optimize=merged, other=other), "overlaps", "separate them")


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


def glass(**properties):
    return {"type": "dielectric", **properties}


def around(kind, **more):
    return lambda: {"bsdf": {"type": kind, "inside": glass(), **more}}


def blend(kind, a, b):
    return {"type": kind, "weight": 0.5, "a": {"type": a}, "b": {"type": b}}


# What is changed on the ball, and words that the message must hold beside the ball's name.
BALLS = {
    "no medium": (lambda: {"interior": None}, ["no body with a medium", "dielectric", "homogeneous"]),
    "rough dielectric": (lambda: {"bsdf": {"type": "roughdielectric"}}, ["RoughDielectric", "smooth"]),
    "diffuse": (lambda: {"bsdf": {"type": "diffuse"}}, ["Diffuse", "dielectric"]),
    "null": (lambda: {"bsdf": {"type": "null"}}, ["Null", "use dielectric"]),
    "thin": (lambda: {"bsdf": {"type": "thindielectric"}}, ["ThinDielectric", "use dielectric"]),
    "conductor": (lambda: {"bsdf": {"type": "conductor"}}, ["Conductor", "use dielectric"]),
    "mask": (around("mask", opacity=0.5), ["MaskBSDF", "dielectric"]),
    "bumpmap": (lambda: around("bumpmap", bumps=checkerboard())(), ["BumpMap", "dielectric"]),
    "normalmap": (lambda: around("normalmap", normalmap=tilted())(), ["NormalMap", "dielectric"]),
    "blend": (lambda: {"bsdf": blend("blendbsdf", "dielectric", "diffuse")}, ["BlendBSDF", "dielectric"]),
    "clear mask": (lambda: {**around("mask", opacity=0.5)(), "interior": None}, ["MaskBSDF", "plain dielectric"]),
    "transmittance": (lambda: {"bsdf": glass(specular_transmittance=0.5)}, ["specular_transmittance", "remove it"]),
    "reflectance": (lambda: {"bsdf": glass(specular_reflectance=0.5)}, ["specular_reflectance", "remove it"]),
    "texture": (
        lambda: {"bsdf": glass(specular_transmittance=checkerboard())},
        ["specular_transmittance", "remove it"],
    ),
    "index 0": (lambda: {"bsdf": glass(int_ior=0.0)}, ["index of refraction", "positive"]),
    "index NaN": (lambda: {"bsdf": glass(int_ior=float("nan"))}, ["index of refraction", "nan", "positive"]),
    "exterior medium": (lambda: {"exterior": amber()}, ["exterior medium", "remove it"]),
    "emitter": (lambda: {"emitter": {"type": "area", "radiance": 1.0}}, ["emitter", "remove"]),
    "heterogeneous": (
        lambda: {"interior": {"type": "heterogeneous", "sigma_t": grid()}},
        ["Heterogeneous", "homogeneous"],
    ),
    "albedo varies": (lambda: {"interior": amber(albedo=grid())}, ["albedo", "constant"]),
    "sigma_t varies": (lambda: {"interior": amber(sigma_t=grid())}, ["sigma_t", "constant"]),
    "sigma_t < 0": (lambda: {"interior": amber(sigma_t=-1.0)}, ["sigma_t", "negative"]),
    "scale < 0": (lambda: {"interior": amber(scale=-1.0)}, ["scale", "negative"]),
    "sigma_t NaN": (lambda: {"interior": amber(sigma_t=float("nan"))}, ["sigma_t", "finite"]),
    "albedo > 1": (lambda: {"interior": amber(albedo=2.0)}, ["albedo", "[0, 1]"]),
    "hg NaN": (lambda: {"interior": amber(phase={"type": "hg", "g": float("nan")})}, ["g", "(-1, 1)"]),
    "tabulated": (
        lambda: {"interior": amber(phase={"type": "tabphase", "values": "1,2,3"})},
        ["Tabulated", "isotropic and hg"],
    ),
    "Rayleigh": (lambda: {"interior": amber(phase={"type": "rayleigh"})}, ["Rayleigh", "isotropic and hg"]),
    "blend of phases": (
        lambda: {"interior": amber(phase=blend("blendphase", "hg", "isotropic"))},
        ["Blend", "isotropic and hg"],
    ),
}


@pytest.mark.parametrize("name", BALLS)
def test_body(make, name):
    changes, words = BALLS[name]
    named = [] if name == "no medium" else ['"ball"']
    refused(lambda: make.scene(ball=make.ball(**changes())), *named, *words)


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


def test_no_body(make):
    refused(lambda: make.scene(ball=None), "no body with a medium", "dielectric", "homogeneous")


@pytest.mark.parametrize("kind", ["conductor", "thindielectric", "null"])
def test_mirrors_and_windows(make, kind):
    other = {"type": "cube", "to_world": at(4), "bsdf": {"type": kind}}
    refused(lambda: make.scene(other=other), '"other"', "use dielectric")


@pytest.mark.parametrize("kind", ["diffuse", "roughconductor", "roughdielectric", "plastic", "principled"])
def test_plain_objects_are_welcome(make, kind):
    """They cast shadows; far from the light's way they change nothing but how far rays start off a surface."""
    beside = make.scene(other={"type": "cube", "to_world": at(4), "bsdf": {"type": kind}})
    np.testing.assert_allclose(render(beside), render(make.scene()), rtol=1e-2, atol=1e-5)


# ---- Lights and camera ----------------------------------------------------------------------

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


def test_no_light(make):
    refused(lambda: make.scene(lamp=None), "no light", "point", "outside")


def test_light_inside(make):
    refused(lambda: make.scene(lamp=build.point_light((0, 0.1, 0))), '"lamp"', "inside", '"ball"', "move it out")


@pytest.mark.parametrize("place", ["corner", "edge", "facet"])
def test_light_on_the_boundary(make, place):
    corners = BALL.corners[0]
    position = {"corner": corners[0], "edge": (corners[0] + corners[1]) / 2, "facet": corners.mean(0)}[place]
    refused(lambda: make.scene(lamp=build.point_light(position)), '"lamp"', '"ball"', "move it")


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_light_that_is_not_finite(make, value):
    refused(lambda: make.scene(lamp=build.point_light((0, value, 0))), '"lamp"', "position", "not finite")
    dazzling = build.point_light((-3, 3, 0), (value, 1.0, 1.0))
    refused(lambda: make.scene(lamp=dazzling), '"lamp"', "intensity", "not finite")


@pytest.mark.parametrize("target", [(0, 0, -1), (0, 3, 0.4)])
def test_camera_inside(make, target):
    refused(lambda: make.scene(sensor=sensor((0.1, 0.1, 0.2), target)), "camera", "inside", '"ball"', "move it out")


def test_camera_in_a_medium(make):
    refused(lambda: make.scene(sensor=sensor(medium=amber())), "sensor", "medium", "remove it")


@pytest.mark.parametrize("key", ["ball.vertex_positions", "ball.interior_medium.albedo.value.value", "lamp.position"])
def test_gradients(make, key):
    scene = make.scene()
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters[key])
    parameters.update()
    refused(lambda: scene, "gradients", key, "disable_grad")


# ---- Through the command --------------------------------------------------------------------

XML = """<scene version="3.0.0">
    <integrator type="refscatter"> {option} </integrator>
    <sensor type="perspective">
        <transform name="to_world"> <lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/> </transform>
        <film type="hdrfilm"> <integer name="width" value="8"/> <integer name="height" value="8"/> </film>
        <sampler type="independent"> <integer name="sample_count" value="1"/> </sampler>
    </sensor>
    <emitter type="point" id="lamp"> <point name="position" value="{position}"/> </emitter>
    <shape type="ply" id="ball">
        <string name="filename" value="{mesh}"/>
        <bsdf type="dielectric"/>
        <medium type="homogeneous" name="interior"> <rgb name="sigma_t" value="0.5"/> </medium>
    </shape>
</scene>"""
GOOD = {"option": "", "position": "-3, 3, 0", "mesh": "ball.ply"}

COMMANDS = {
    "no scene file": (None, ["scene.xml"]),
    "malformed XML": (XML.format(**GOOD)[:-20], ["XML"]),
    "unknown property": (XML.format(**{**GOOD, "option": '<float name="tolerence" value="0.1"/>'}), ["tolerence"]),
    "wrong type": (XML.format(**{**GOOD, "option": '<string name="tolerance" value="x"/>'}), ['"tolerance"', "float"]),
    "no mesh file": (XML.format(**{**GOOD, "mesh": "nowhere.ply"}), ["nowhere.ply", "not found"]),
    "hole": (XML.format(**{**GOOD, "mesh": "hole.ply"}), ['"ball"', "hole", "close it"]),
    "light inside": (XML.format(**{**GOOD, "position": "0, 0.1, 0"}), ['"lamp"', "inside", '"ball"', "move it out"]),
}


@pytest.mark.skipif(
    all(platform.problem_of(v) for v in platform.PREFERRED), reason="no variant can render on this machine"
)
@pytest.mark.parametrize("name", COMMANDS)
def test_command_keeps_the_earlier_picture(rgb, tmp_path, name):
    """One sentence, exit code 1, and the pictures of an earlier render stay as they were."""
    xml, words = COMMANDS[name]
    for file, mesh in (("ball.ply", BALL), ("hole.ply", with_faces(BALL.faces[1:]))):
        build.mesh_shape(mesh, tmp_path / file)
    if xml is not None:
        (tmp_path / "scene.xml").write_text(xml)
    earlier = {"out.exr": b"earlier picture", "out.png": b"earlier preview"}
    for file, data in earlier.items():
        (tmp_path / file).write_bytes(data)
    before = sorted(p.name for p in tmp_path.iterdir())
    command = [sys.executable, "-m", "mitsuba_refscatter", "render", "scene.xml", "-o", "out.exr"]
    environment = {**os.environ, "COLUMNS": "300", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=tmp_path, env=environment)
    told = [line for line in done.stderr.splitlines() if line.startswith("refscatter: ")]
    assert done.returncode == 1 and len(told) == 1 and "Traceback" not in done.stderr, done.stderr
    for word in words:
        assert word in told[0], done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == before
    assert all((tmp_path / file).read_bytes() == data for file, data in earlier.items())

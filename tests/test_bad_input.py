"""Bad input is refused in one sentence that says which object, why and what to do, or does what is documented."""

import os
import subprocess
import sys
from pathlib import Path

import build
import mitsuba as mi
import numpy as np
import pytest
from faults import BALL, Maker, amber, moved, refused, render, sensor, with_faces
from meshes import Mesh
from test_commands import HANGS

from mitsuba_refscatter import platform

ROOT = Path(__file__).parent.parent


@pytest.fixture
def make(rgb, tmp_path):
    return Maker(tmp_path)


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
    ("estimator", "points", ["curve", "interval", "point"]),
    ("estimator", 1, ["string"]),
    ("culling", "spindles", ["beams", "spindle"]),
    ("samples", -1, ["[0, "]),
    ("samples", 1.5, ["integer"]),
    ("samples", 4, ["curve", "remove it"]),
    ("aovs", "single_scatter, depths", ["depths", "contributions"]),
    ("aovs", 3, ["string"]),
    ("hide_emitters", "x", ["boolean"]),
]


@pytest.mark.parametrize("name, value, words", OPTIONS, ids=[f"{name}={value}" for name, value, _ in OPTIONS])
def test_option(make, name, value, words):
    refused(lambda: make.scene(integrator={"type": "refscatter", name: value}), f'"{name}"', *words)


def test_unknown_option(make):
    refused(
        lambda: make.scene(integrator={"type": "refscatter", "tolerence": 0.1}),
        '"tolerence"',
        "did you mean tolerance?",
    )


# ---- Meshes ---------------------------------------------------------------------------------


def with_value(mesh, name, value):
    """The mesh with one entry of ``name`` replaced."""
    changed = {**vars(mesh), name: getattr(mesh, name).copy()}
    changed[name][3] = value
    return Mesh(**changed)


FLAT = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 1]]), None)
FLIPPED = np.concatenate([BALL.faces[1:], BALL.faces[:1, ::-1]])
MESHES = {
    "NaN in a normal": (with_value(BALL, "normals", np.nan), ["normals", "not finite", "face_normals"]),
    "a normal is zero": (with_value(BALL, "normals", 0), ["normals", "zero", "face_normals"]),
    "no triangles": (with_faces(BALL.faces[:0]), ["no triangles"]),
    "a triangle is turned": (with_faces(FLIPPED), ["inconsistent", "orientation"]),
    "a triangle comes twice": (with_faces(np.concatenate([BALL.faces, BALL.faces[:1]])), ["twice", "merge"]),
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
    turned = make.ball(moved(with_faces(FLIPPED), 4), **glass)
    parts = {"glass": {"type": "dielectric"}, "amber": amber(), "ball": make.ball(**glass), "other": turned}
    refused(lambda: make.scene(optimize=True, **parts), "(2, 0, 0)", "160 triangles", "Dielectric", "orientation")


# ---- Lights and camera ----------------------------------------------------------------------


def test_no_light(make):
    refused(lambda: make.scene(lamp=None), "no light", "point", "emitter")


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


@pytest.mark.parametrize("kind", ["area", "constant"])
def test_radiance_that_is_not_finite(make, kind):
    dazzling = {"type": kind, "radiance": {"type": "rgb", "value": [1.0, float("nan"), 1.0]}}
    lamp = {"type": "sphere", "center": [-3, 3, 0], "emitter": dazzling} if kind == "area" else dazzling
    refused(lambda: make.scene(lamp=lamp), '"lamp"', "radiance", "not finite")


def test_a_point_light_very_far_away(make):
    """As far as float32 tells one unit no more, it is a sun."""
    far = 1e8
    away, toward = (
        build.point_light((-far, 1.1 * far, 0.05 * far), [2.2125 * far**2] * 3),
        {"type": "directional", "direction": [1, -1.1, -0.05]},  # in the plane of no facet
    )
    sun = {**toward, "irradiance": {"type": "rgb", "value": [1.0] * 3}}
    np.testing.assert_allclose(*(render(make.scene(lamp=lamp)) for lamp in (away, sun)), rtol=1e-2, atol=1e-6)


@pytest.mark.parametrize("target", [(0, 0, -1), (0, 3, 0.4)])
def test_camera_inside(make, target):
    """Without the medium that it is in."""
    refused(lambda: make.scene(sensor=sensor((0.1, 0.1, 0.2), target)), "camera", '"ball"', "no medium", "move it")


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
    "turned": (XML.format(**{**GOOD, "mesh": "turned.ply"}), ['"ball"', "wind inconsistently", "orientation"]),
    "light on it": (XML.format(**{**GOOD, "position": "0, 0, 1"}), ['"lamp"', "boundary", '"ball"', "move it off"]),
}


@pytest.mark.skipif(
    all(platform.problem_of(v) for v in platform.PREFERRED), reason="no variant can render on this machine"
)
@pytest.mark.parametrize("name", COMMANDS)
def test_command_keeps_the_earlier_picture(rgb, tmp_path, name):
    """One sentence, exit code 1, and the pictures of an earlier render stay as they were."""
    xml, words = COMMANDS[name]
    for file, mesh in (("ball.ply", BALL), ("turned.ply", with_faces(FLIPPED))):
        build.mesh_shape(mesh, tmp_path / file)
    if xml is not None:
        (tmp_path / "scene.xml").write_text(xml)
    earlier = {"out.exr": b"earlier picture", "out.png": b"earlier preview"}
    for file, data in earlier.items():
        (tmp_path / file).write_bytes(data)
    before = sorted(p.name for p in tmp_path.iterdir())
    command = [sys.executable, "-m", "mitsuba_refscatter", "render", "scene.xml", "-o", "out.exr"]
    environment = {**os.environ, "COLUMNS": "300", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANGS, cwd=tmp_path, env=environment)
    told = [line for line in done.stderr.splitlines() if line.startswith("refscatter: ")]
    assert done.returncode == 1 and len(told) == 1 and "Traceback" not in done.stderr, done.stderr
    for word in words:
        assert word in told[0], done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == before
    assert all((tmp_path / file).read_bytes() == data for file, data in earlier.items())

"""The bodies and scenes that the package makes."""

from pathlib import Path

import numpy as np
import pytest

from mitsuba_refscatter import example_scenes
from mitsuba_refscatter.example_scenes.surface_nets import is_closed
from mitsuba_refscatter.geometry.geodesic import geodesic_sphere, nearest_frequency

COMMITTED = Path(__file__).parent.parent / "scenes"
COUNTS = [("sphere", 1280), ("sphere", 20), ("bumpy_sphere", 20480), ("rounded_cube", 5120), ("branches", 12000)]


@pytest.fixture(scope="module", params=COUNTS, ids=lambda p: f"{p[0]}-{p[1]}")
def body(request):
    return request.param, example_scenes.make_body(*request.param)


def face_vectors(vertices, faces):
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a) / 2


def test_bodies_are_closed_surfaces_of_one_piece(body):
    _, (vertices, faces, _) = body
    assert is_closed(faces)
    assert np.array_equal(np.unique(faces), np.arange(len(vertices)))
    # Closed, one piece, no handle: Euler's formula gives 2.
    assert len(vertices) - len(faces) * 3 // 2 + len(faces) == 2
    area = face_vectors(vertices, faces)
    assert np.abs(area.sum(axis=0)).max() < 1e-9
    assert (area * vertices[faces[:, 0]]).sum() / 3 > 0.3


def test_triangles_are_not_degenerate(body):
    _, (vertices, faces, _) = body
    area = np.linalg.norm(face_vectors(vertices, faces), axis=1)
    corners = vertices[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    # An equilateral triangle has 0.87; surface nets leave a few flat ones.
    assert (2 * area / longest**2).min() > 0.08


def test_normals_are_unit_and_agree_with_the_faces(body):
    _, (vertices, faces, normals) = body
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)
    area = face_vectors(vertices, faces)
    flat = area / np.linalg.norm(area, axis=1, keepdims=True)
    # 0.79 on the icosahedron; a flipped triangle or normal is far below.
    assert (flat[:, None] * normals[faces]).sum(axis=2).min() > 0.75


def test_number_of_triangles(body):
    (name, count), (_, faces, _) = body
    assert abs(len(faces) - count) <= (0.01 * count if name == "branches" else 0)


@pytest.mark.parametrize("wanted, f", [(1, 1), (20, 1), (49, 1), (51, 2), (1280, 8), (20480, 32), (327680, 128)])
def test_the_nearest_frequency_is_taken(wanted, f):
    assert nearest_frequency(wanted) == f
    assert len(geodesic_sphere(f)[1]) == 20 * f * f


@pytest.mark.parametrize("name", ["bumpy_sphere", "rounded_cube"])
def test_normals_are_those_of_the_smooth_surface(name):
    """The mean of the face vectors around a vertex tends to the normal as the mesh is refined."""
    errors = []
    for count in (5120, 20480):
        vertices, faces, normals = example_scenes.make_body(name, count)
        mean = np.zeros_like(normals)
        for i in range(3):
            np.add.at(mean, faces[:, i], face_vectors(vertices, faces))
        mean /= np.linalg.norm(mean, axis=1, keepdims=True)
        errors.append(np.sqrt(((mean - normals) ** 2).sum(axis=1).mean()))
    assert errors[1] < 0.6 * errors[0] and errors[1] < 0.02


@pytest.mark.parametrize("name", ["bumpy_sphere", "rounded_cube", "branches"])
def test_bodies_are_not_convex(name):
    """Most faces of a convex body have nothing in front of them."""
    vertices, faces, _ = example_scenes.make_body(name, 12000)
    area = face_vectors(vertices, faces)[::20]
    flat = area / np.linalg.norm(area, axis=1, keepdims=True)
    height = (vertices @ flat.T - (vertices[faces[::20, 0]] * flat).sum(axis=1)).max(axis=0)
    assert np.median(height) > 0.02


@pytest.mark.parametrize("name, count", [("nonsense", 100), ("sphere", 0), ("sphere", 10**9), ("branches", 100)])
def test_impossible_bodies_are_refused(name, count):
    with pytest.raises(example_scenes.BodyError):
        example_scenes.make_body(name, count)


@pytest.mark.parametrize("name", example_scenes.SCENES)
def test_committed_files_are_what_the_command_writes(name, tmp_path):
    path, _ = example_scenes.write_scene(name, tmp_path)
    assert path.read_text() == (COMMITTED / name / "scene.xml").read_text()
    mesh = Path("meshes") / f"{name}.ply"
    new, old = (Path(folder / mesh).read_bytes() for folder in (tmp_path, COMMITTED / name))
    assert len(old) < 2**20
    end = new.index(b"end_header\n") + 11
    assert len(new) == len(old) and new[:end] == old[:end]
    if name != "branches":  # its relaxation may differ in the last bits between machines
        count = 6 * example_scenes.make_body(name)[0].shape[0]
        a, b = (np.frombuffer(data, "<f4", count, end) for data in (new, old))
        assert np.abs(a - b).max() < 1e-6


@pytest.mark.parametrize("name", example_scenes.SCENES)
def test_scenes_load_and_are_lit(name, variant):
    text = (COMMITTED / name / "scene.xml").read_text()
    scene = example_scenes.load(COMMITTED / name / "scene.xml", res=16)
    body = next(shape for shape in scene.shapes() if shape.id() == "body")
    assert body.is_mesh() and body.has_vertex_normals() and body.interior_medium() is not None
    assert body.face_count() == example_scenes.SCENES[name].triangles
    assert 'value="256"' in text and 'component_format" value="float32"' in text
    places = [emitter.bbox().center() for emitter in scene.emitters() if emitter.bbox().valid()]
    assert places or name == "underwater"  # whose lights are distant
    assert not any(body.bbox().contains(place) for place in places), "a light is inside"

"""Refusals of meshes and their parts name one cause, with how many and where, as it was put into them."""

from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest
from faults import BALL, Maker, amber, glass, moved, points_of, refused, sensor, with_faces
from meshes import Mesh, box

from mitsuba_refscatter.benchmarks import duel
from mitsuba_refscatter.scene import SceneError
from mitsuba_refscatter.scene.boundaries import _read_mesh

CUBE = box([-1, -1, -1], [1, 1, 1])


@pytest.fixture
def make(rgb, tmp_path):
    return Maker(tmp_path)


def together(*meshes):
    """Several meshes as one; their vertices are not shared."""
    first = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    faces = np.concatenate([mesh.faces + i for mesh, i in zip(meshes, first)])
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), faces, None)


def apart(mesh):
    """The same triangles with vertices of their own."""
    return Mesh(mesh.corners.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3), None)


def first_of(mesh, edges):
    """Ends of the first of ``edges`` (pairs of vertices) that a triangle has, in the order of the triangles."""
    wanted = {frozenset(edge) for edge in edges}
    return next(
        mesh.vertices[[a, b]]
        for face in mesh.faces.tolist()
        for a, b in zip(face, face[1:] + face[:1])
        if {a, b} in wanted
    )


# ---- Edges ----------------------------------------------------------------------------------


FINS = [(2, 3), (4, 5)]
"""Edges of the cube."""


def with_fins(count):
    """The cube with triangles that stick out of its edges."""
    tips = [[0, 1.8, 0.2], [1.7, -1.6, 0]][:count]
    faces = [[b, a, 8 + k] for k, (a, b) in enumerate(FINS[:count])]
    return Mesh(np.concatenate([CUBE.vertices, tips]), np.concatenate([CUBE.faces, faces]), None)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("count", [1, 2])
def test_edges_of_three_triangles(make, count, shared, turned):
    """Whichever way the fins wind they are not a matter of winding; with ``to_world`` the edge is that in the world."""
    mesh = with_fins(count)
    ends = 2 * first_of(mesh, FINS[:count]) + [10, 20, 30]
    if turned:
        mesh = Mesh(mesh.vertices, np.concatenate([mesh.faces[:12], mesh.faces[12:, ::-1]]), None)
    world = mi.ScalarTransform4f().translate([10, 20, 30]).scale(2)
    body = make.ball(mesh if shared else apart(mesh), to_world=world)
    sentence = refused(
        lambda: make.scene(ball=body), '"ball"', f"three or more triangles ({count}, ", "of 3)", "split", "remove"
    )
    assert "wind" not in sentence
    np.testing.assert_allclose(points_of(sentence), ends, atol=1e-4)


@pytest.mark.parametrize("where", [[5], [61, 38]])
def test_triangles_that_are_turned(make, where):
    """Each of them, with three neighbours that are not, has three edges."""
    faces = BALL.faces.copy()
    faces[where] = faces[where][:, ::-1]
    assert len(set(BALL.faces[where].ravel())) == 3 * len(where)  # they are no neighbours
    sentence = refused(
        lambda: make.scene(ball=make.ball(with_faces(faces))),
        '"ball"',
        f"wind inconsistently (at {3 * len(where)} edges",
        "reverse",
    )
    assert "three" not in sentence and "twice" not in sentence
    edges = np.stack([faces[where], np.roll(faces[where], -1, axis=1)], axis=-1).reshape(-1, 2).tolist()
    np.testing.assert_allclose(points_of(sentence), first_of(with_faces(faces), edges), atol=1e-5)


def test_triangles_that_are_there_twice(make):
    """As they are, and turned over."""
    again = np.concatenate([BALL.faces, BALL.faces[[7]], BALL.faces[[33]][:, ::-1]])
    sentence = refused(lambda: make.scene(ball=make.ball(with_faces(again))), '"ball"', "twice (2, ", "merge")
    assert "wind" not in sentence and "three" not in sentence
    np.testing.assert_allclose(points_of(sentence), BALL.corners[[7]].mean(axis=1), atol=1e-5)


# ---- Parts ----------------------------------------------------------------------------------

FLAT = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 1]]), None)


def test_parts_without_volume(make):
    mesh = together(BALL, moved(FLAT, 5), moved(FLAT, 7))
    sentence = refused(
        lambda: make.scene(ball=make.ball(mesh)), '"ball"', "no volume (2, the first of 2 triangles", "thickness"
    )
    np.testing.assert_allclose(points_of(sentence), [[5.5, 0.5, 0]], atol=1e-5)


def test_a_part_inside_that_winds_the_same_way(make):
    mesh = together(BALL, moved(CUBE, 0.1, 0.2, scale=0.3))
    sentence = refused(
        lambda: make.scene(ball=make.ball(mesh)),
        '"ball"',
        "of 12 triangles",
        "winds the same way",
        "reverse",
        "exterior",
    )
    np.testing.assert_allclose(points_of(sentence), [[0.1, 0.2, 0]], atol=1e-5)


@pytest.mark.parametrize("turned", [False, True])
def test_a_part_in_the_place_of_another(make, turned):
    """All of it is inside the other, and the other way round."""
    again = Mesh(CUBE.vertices, CUBE.faces[:, ::-1], None) if turned else CUBE
    mesh = together(BALL, *(moved(x, 4) for x in (CUBE, again)))
    sentence = refused(
        lambda: make.scene(ball=make.ball(mesh)), '"ball"', "of 12 triangles", "same place", "remove one"
    )
    np.testing.assert_allclose(points_of(sentence), [[4, 0, 0]], atol=1e-5)


def test_parts_that_overlap(make):
    mesh = together(BALL, moved(CUBE, 0, 4), moved(CUBE, 0.5, 4.5))
    sentence = refused(lambda: make.scene(ball=make.ball(mesh)), '"ball"', "overlaps another", "separate them")
    np.testing.assert_allclose(points_of(sentence), [[0, 4, 0], [0.5, 4.5, 0]], atol=1e-5)


def test_a_body_in_the_place_of_another(make):
    """Clear glass, so that no medium is in question."""
    pair = {name: make.ball(moved(CUBE, 4), interior=None, eta=eta) for name, eta in (("one", 1.2), ("two", 1.4))}
    refused(lambda: make.scene(**pair), '"one"', '"two"', "overlaps", "separate them")


# ---- Vertices -------------------------------------------------------------------------------


def changed(scene, name, values):
    parameters = mi.traverse(scene)
    parameters[name] = values.astype(np.float32).ravel()
    parameters.update()
    return scene


def test_vertices_and_normals_that_are_not_finite(make):
    vertices = BALL.vertices.copy()
    vertices[[9, 4, 30], 1] = np.nan, np.inf, np.nan
    words = "vertices that are not finite (3, the first is number 4,"
    sentence = refused(lambda: changed(make.scene(), "ball.vertex_positions", vertices), '"ball"', words, "mend")
    np.testing.assert_allclose(points_of(sentence), vertices[[4]], atol=1e-5)
    for value in (0, np.nan, np.inf):
        normals = BALL.normals.copy()
        normals[[11, 6]] = value
        scene = make.scene()
        sentence = refused(
            lambda: changed(scene, "ball.vertex_normals", normals), '"ball"', "normals", "(2, the first", "recompute"
        )
        np.testing.assert_allclose(points_of(sentence), BALL.vertices[[6]], atol=1e-5)


def test_a_vertex_that_is_not_there(rgb):
    """Mitsuba's loader would end the process with such a file."""
    faces = mi.Vector3u([0, 0, 3], [1, 2, 1], [2, 3, 9])
    shape = SimpleNamespace(face_count=lambda: 3, vertex_count=lambda: 4, face_indices=lambda index: faces)
    with pytest.raises(
        SceneError, match=r'"odd" .*not there \(1, the first with the vertices 3, 1, 9 of 4, counted from 0\)'
    ):
        _read_mesh(shape, 'shape "odd"')


# ---- Other parts of a scene -----------------------------------------------------------------


@pytest.mark.parametrize("name, value", [("sigma_t", -1.5), ("scale", -2.5), ("albedo", 3.5)])
def test_values_of_media(make, name, value):
    medium = amber(**{name: value})
    refused(lambda: make.scene(ball=make.ball(interior=medium)), '"ball"', f"has {value:g} as its medium's {name}")


@pytest.mark.parametrize(
    "scale, word, other", [([1, 1, 0], "flattens", "finite"), ([1, 1, np.nan], "not finite", "flattens")]
)
def test_transforms(make, scale, word, other):
    at = mi.ScalarTransform4f(np.diag([*scale, 1.0]))
    group = {"type": "shapegroup", "id": "group", "part": make.ball()}
    copy = {"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": at}
    sentence = refused(lambda: make.scene(a_group=group, copy=copy), '"copy"', word)
    assert other not in sentence


@pytest.mark.parametrize("kind", ["emitter", "sensor"])
@pytest.mark.parametrize("shape", ["mesh", "sphere"])
def test_a_boundary_that_shines_or_measures(make, shape, kind):
    what = {"emitter": {"type": "area"}, "sensor": {"type": "irradiancemeter", "film": sensor()["film"]}}[kind]
    body = make.ball() if shape == "mesh" else {"type": "sphere", "bsdf": glass(), "interior": amber()}
    scene = make.scene(ball={**body, "extra": what})
    refused(lambda: scene, '"ball"', f"and its {kind} at once", f"remove the {kind}")


def test_what_names_the_medium_around(make):
    """With a medium around, and without one."""
    inner = moved(BALL, 0.1, scale=0.4)
    first = {"a_medium": {**amber(), "id": "honey"}, "ball": make.ball(interior={"type": "ref", "id": "honey"})}
    other = {**amber(), "id": "oil"}
    refused(
        lambda: make.scene(**first, inner=make.ball(inner, eta=1.3, exterior=other)),
        '"inner"', '"ball", where the medium "honey" is', 'the medium "oil"', 'name the medium "honey" as its exterior',
    )  # fmt: skip
    refused(
        lambda: make.scene(ball=make.ball(interior=None), inner=make.ball(inner, eta=1.3, exterior=other)),
        '"inner"', '"ball", where no medium is', 'the medium "oil"', "name no medium as its exterior",
    )  # fmt: skip


def test_references_to_compare_with(make):
    """Black, or with numbers that are not finite: each is told."""
    subject = duel.Subject("ball", make.scene, 80)
    for values, words in (([0, 0], "is black"), ([1, np.nan], "holds 96 numbers that are not finite")):
        reference = np.tile(np.array(values, dtype=float)[:, None], (8, 4, 3))
        with pytest.raises(ValueError, match=words):
            duel.compare(subject, [], None, reference)

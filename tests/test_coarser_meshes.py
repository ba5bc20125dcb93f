"""Coarse meshes that stand for fine ones: what they are, which is picked, and how good an image by them is."""

import build
import mitsuba as mi
import numpy as np
import pytest
from comparison import l1
from meshes import Mesh, icosphere, triangle_grid

from mitsuba_refscatter import example_scenes
from mitsuba_refscatter.core.cache import ChoiceKey, LevelsKey
from mitsuba_refscatter.culling import beams
from mitsuba_refscatter.example_scenes import bodies
from mitsuba_refscatter.geometry import decimation
from mitsuba_refscatter.geometry import mesh as mesh_facts
from mitsuba_refscatter.integrators import mesh_choice
from mitsuba_refscatter.light import simplification
from mitsuba_refscatter.options import Options
from mitsuba_refscatter.transport import visibility


def euler(faces):
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    return len(np.unique(faces)) - len(edges) + len(faces)


def across(normals, faces):
    """Largest difference between the normals at the ends of an edge."""
    return max(np.linalg.norm(normals[faces[:, i]] - normals[faces[:, i - 1]], axis=1).max() for i in range(3))


@pytest.mark.parametrize("body", [bodies.bumpy_sphere, bodies.rounded_cube])
def test_coarse_meshes_are_closed_and_smaller(body):
    vertices, faces, normals = body(20480)
    turns = [0.2, 0.4]
    sizes = [len(faces)]
    for turn, coarse in zip(
        turns, decimation.coarser(vertices, normals, faces, mesh_facts.twins(faces), turns, 0.5), strict=True
    ):
        twin = mesh_facts.twins(coarse)
        assert twin is not None and (twin >= 0).all() and euler(coarse) == 2
        corners = vertices[coarse]
        facet = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert all((np.einsum("fi,fi->f", facet, normals[coarse[:, k]]) > 0).all() for k in range(3))
        assert mesh_facts.volume(corners) == pytest.approx(mesh_facts.volume(vertices[faces]), rel=0.03)
        assert across(normals, coarse) <= max(1.01 * turn, across(normals, faces))
        sizes.append(len(coarse))
    assert sizes[1] < 0.6 * sizes[0] and sizes[2] < 0.4 * sizes[1]


def test_edges_of_holes_stay():
    uv, faces = triangle_grid(20)
    vertices = np.column_stack([uv, np.zeros(len(uv))])
    normals = np.tile([0.0, 0.0, 1.0], (len(vertices), 1))
    twin = mesh_facts.twins(faces)
    rim = {tuple(sorted(e)) for e in np.stack([faces.ravel(), np.roll(faces, -1, axis=1).ravel()], 1)[twin < 0]}
    (coarse,) = decimation.coarser(vertices, normals, faces, twin, [0.5], 10.0)
    left = mesh_facts.twins(coarse)
    assert len(coarse) < 0.7 * len(faces)
    assert {
        tuple(sorted(e)) for e in np.stack([coarse.ravel(), np.roll(coarse, -1, axis=1).ravel()], 1)[left < 0]
    } == rim


@pytest.mark.parametrize("factor", [0.02, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("error", [0.005, 0.07])
def test_the_coarsest_mesh_that_is_good_enough(factor, error):
    """Errors of a known size: the mesh that is picked has at most the error, and the one before it more, or nearly."""
    turns = [*np.geomspace(0.6, 0.05, 12), 0.02]
    at = mesh_choice.suitable(turns, error, lambda i, j: factor * (turns[i] ** 2 - turns[j] ** 2))
    errors = factor * (np.array(turns) ** 2 - turns[-1] ** 2)
    assert errors[at] <= error * 1.05
    assert at == 0 or errors[at - 1] > 0.95 * error


def image(scene, tolerance):
    integrator = mi.load_dict({"type": "refscatter", "surfaces": False, "internal_bounces": 1, "tolerance": tolerance})
    return np.array(integrator.render(scene, seed=0, spp=1), dtype=np.float64), integrator


@pytest.mark.parametrize("tolerance", build.slow_ones([0.3, 0.1], [0.3]))
@pytest.mark.parametrize("name", build.slow_ones(["bumpy_sphere", "branches"], ["branches"]))
def test_coarse_meshes_keep_to_the_tolerance(rgb, tmp_path, name, tolerance):
    path, _ = example_scenes.write_scene(name, tmp_path, 20480)
    scene = example_scenes.load(path, res=64)
    exact, _ = image(scene, 1e-3)
    found, integrator = image(scene, tolerance)
    assert l1(found, exact) < tolerance
    (chosen,), (levels,) = (
        [value for key, value in integrator.cache._now.items() if isinstance(key, kind)]
        for kind in (ChoiceKey, LevelsKey)
    )
    assert levels[chosen].triangles < 0.6 * levels[-1].triangles


def test_facets_and_small_meshes_stay(rgb, tmp_path):
    """A mesh whose normals are those of its facets refracts light by each of them: it is taken as it is."""
    vertices, faces, _ = bodies.bumpy_sphere(5120)
    shape = build.mesh_shape(Mesh(vertices, faces, None), tmp_path / "facets.ply")
    scene = mi.load_dict({"type": "scene", "body": shape, "light": build.point_light((-2.6, 2.4, -0.9))})
    o, d = build.rays_at((0.0, 1.1, 5.2), 0.6, 200, seed=7)
    loose, exact = (build.single_scattering(scene, o, d, tolerance=t, internal_bounces=0) for t in (0.3, 0.001))
    assert l1(loose, exact) < 0.02


def test_nothing_is_estimated_where_exact(rgb, tmp_path, monkeypatch):
    """At tolerance 0 no coarser mesh is made, and neither what is lit nor how far light gets is judged by samples;
    at the default all are."""
    done = set()

    def noting(owner, name):
        original = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *arguments: done.add(name) or original(*arguments))

    for owner, name in ((simplification, "levels"), (beams, "estimate"), (visibility.Shadows, "_seen_at_samples")):
        noting(owner, name)
    shape = build.mesh_shape(Mesh(*bodies.bumpy_sphere(1280)), tmp_path / "m.ply")
    scene = mi.load_dict({"type": "scene", "body": shape, "light": build.point_light((-2.6, 2.4, -0.9))})
    o, d = build.rays_at((0.0, 1.1, 5.2), 0.6, 40, seed=7)
    for tolerance, expected in ((0.0, set()), (Options().tolerance, {"levels", "estimate", "_seen_at_samples"})):
        assert build.single_scattering(scene, o, d, tolerance=tolerance, internal_bounces=0).min() > 0
        assert done == expected


def test_triangles_that_share_no_vertex(rgb, tmp_path):
    """As programs for printing write them: the same body, and nothing to decimate it by."""
    ball = build.rounded_mesh(icosphere(4))
    corners = np.arange(3 * len(ball.faces)).reshape(-1, 3)
    alone = Mesh(ball.vertices[ball.faces].reshape(-1, 3), corners, ball.normals[ball.faces].reshape(-1, 3))
    o, d = build.rays_at((0.0, 1.1, 5.2), 0.9, 500, seed=3)
    found = []
    for tolerance in (0.1, 0.001):
        for mesh in (ball, alone):
            shape = build.mesh_shape(mesh, tmp_path / "m.ply")
            scene = mi.load_dict({"type": "scene", "body": shape, "light": build.point_light((-2.6, 2.4, -0.9))})
            found.append(build.single_scattering(scene, o, d, tolerance=tolerance, internal_bounces=0))
    assert l1(found[1], found[0]) < 0.1
    assert l1(found[3], found[2]) < 1e-5

"""Patches, the curved triangles of coarse meshes: against polynomials, finite differences and a sphere."""

import build
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from meshes import Mesh, icosphere

from mitsuba_refscatter.core.cache import Cache
from mitsuba_refscatter.geometry import triangle
from mitsuba_refscatter.light import simplification
from mitsuba_refscatter.scene import read

N = 64


@pytest.fixture
def patches(rgb):
    """Random patches and the NumPy polynomials ``c . (1, u, v, u^2, uv, v^2)`` that they are: P and n, (N, 3, 6)
    each."""
    rng = np.random.default_rng(4)
    c = rng.normal(size=(2, N, 3, 6)) * [1, 1, 1, 0.2, 0.2, 0.2]
    c[1, :, 2, 0] += 4  # normals that do not vanish
    corners, middles = (_values(c, uv) for uv in ([(0, 0), (1, 0), (0, 1)], [(0.5, 0), (0.5, 0.5), (0, 0.5)]))
    bulge = middles - 0.5 * (corners + np.roll(corners, -1, axis=2))
    ng = triangle.geometric_normal(corners[0])
    records = triangle.Patches(mi.Float(triangle.pack_patches(corners[0], corners[1], ng, bulge[0], bulge[1])))
    return triangle.gather(records, dr.arange(mi.UInt32, N)), c


def _values(c, uv):
    """Values (2, N, points, 3) of the polynomials at some (u, v)."""
    basis = np.array([(1, u, v, u * u, u * v, v * v) for u, v in uv])
    return np.einsum("knxb,pb->knpx", c, basis)


PLACES = [(0.0, 0.0), (1.0, 0.0), (0.2, 0.3), (1 / 3, 1 / 3), (0.1, 0.8), (0.5, 0.5)]


def test_quadratic_through_six_points(patches):
    tri, c = patches
    for u, v in PLACES:
        (P, n), h = _values(c, [(u, v)])[:, :, 0], 1e-5
        np.testing.assert_allclose(tri.position(mi.Float(u), mi.Float(v)).numpy().T, P, atol=3e-6)
        unit = n / np.linalg.norm(n, axis=1, keepdims=True)
        np.testing.assert_allclose(tri.normal(mi.Float(u), mi.Float(v)).numpy().T, unit, atol=3e-6)
        for slope, (a, b) in zip(tri.tangents(mi.Float(u), mi.Float(v)), ((h, 0), (0, h))):
            ahead, behind = (_values(c, [(u + s * a, v + s * b)])[0, :, 0] for s in (1, -1))
            np.testing.assert_allclose(slope.numpy().T, (ahead - behind) / (2 * h), atol=2e-5)
        a, b = 0.6, -0.8
        ahead, behind = (_values(c, [(u + s * h * a, v + s * h * b)])[1, :, 0] for s in (1, -1))
        ahead, behind = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (ahead, behind))
        n, d_n = tri.normal_derivative(mi.Float(u), mi.Float(v), mi.Float(a), mi.Float(b))
        np.testing.assert_allclose(n.numpy().T, unit, atol=3e-6)
        np.testing.assert_allclose(d_n.numpy().T, (ahead - behind) / (2 * h), atol=1e-4)


def test_inside_the_hull_of_its_control_points(patches):
    tri, c = patches
    rng = np.random.default_rng(5)
    uv = rng.dirichlet([1, 1, 1], size=200)[:, :2]
    for values, controls in zip(_values(c, uv), tri.controls()):
        controls = np.stack([x.numpy().T for x in controls], axis=1)
        assert controls.shape == (N, 6, 3)
        for direction in rng.normal(size=(20, 3)):
            along, most = values @ direction, (controls @ direction).max(axis=1)
            assert (along.max(axis=1) <= most + 1e-4).all()


def test_a_plane_triangle_is_a_patch_without_bulge(rgb):
    rng = np.random.default_rng(6)
    corners, normals = rng.normal(size=(2, N, 3, 3))
    ng, none = triangle.geometric_normal(corners), np.zeros((N, 3, 3))
    i = dr.arange(mi.UInt32, N)
    plane = triangle.gather(mi.Float(triangle.pack(corners, normals, ng)), i)
    patch = triangle.gather(triangle.Patches(mi.Float(triangle.pack_patches(corners, normals, ng, none, none))), i)
    u, v = mi.Float(0.3), mi.Float(0.45)
    assert patch.curved and not plane.curved
    for a, b in ((plane.position(u, v), patch.position(u, v)), (plane.normal(u, v), patch.normal(u, v)),
                 *zip(plane.tangents(u, v), patch.tangents(u, v))):  # fmt: skip
        np.testing.assert_array_equal(a.numpy(), b.numpy())


def test_patches_of_a_ball(rgb, tmp_path):
    """Coarse meshes of a ball: their patches are on it, edges' middles are common, and normals are those of the
    ball."""
    ball = icosphere(5)
    fine = 3e-4  # how far its facets, of edge 0.04, are from the ball
    mesh = Mesh(ball.vertices, ball.faces, ball.vertices)
    shape = build.mesh_shape(mesh, tmp_path / "ball.ply")
    scene = read(
        mi.load_dict({"type": "scene", "body": shape, "light": build.point_light((-2.6, 2.4, -0.9))}), 0.01, Cache()
    )
    body = scene.bodies[0]
    levels = simplification.levels(body, 0.05, 0.6)
    assert len(levels) > 4 and levels[-1].of(body, scene, Cache().once) is body
    for level in levels[:-1]:
        found = level.of(body, scene, Cache().once)
        assert found.stands_for is body and found.triangle_count == level.triangles
        tri = triangle.gather(triangle.Patches(mi.Float(found.packed())), dr.arange(mi.UInt32, level.triangles))
        edges = np.linalg.norm(found.corners - np.roll(found.corners, 1, axis=1), axis=2)
        sag = edges.max() ** 2 / 8
        bulge = np.linalg.norm(found.bulge[:, 0], axis=2).max()
        assert (
            4 / 3 * bulge == pytest.approx(4 / 3 * sag, abs=0.05 * sag + 4 / 3 * fine)
            and found.apart < 0.1 * sag + fine
        )
        for u, v in ((1 / 3, 1 / 3), (0.5, 0), (0.25, 0.7), (0.1, 0.2)):
            P = tri.position(mi.Float(u), mi.Float(v)).numpy().T + np.array(body.centre)
            n = tri.normal(mi.Float(u), mi.Float(v)).numpy().T
            assert np.abs(np.linalg.norm(P, axis=1) - 1).max() < 0.05 * sag + fine
            assert np.linalg.norm(n - P, axis=1).max() < 0.05 * sag + 2e-3
        ends = np.sort(np.round(found.corners[:, [[0, 1], [1, 2], [2, 0]]] * 1e6), axis=2).reshape(-1, 6)
        _, edge = np.unique(ends, axis=0, return_inverse=True)
        middle = (found.bulge[:, 0] + 0.5 * (found.corners + np.roll(found.corners, -1, axis=1))).reshape(-1, 3)
        order = np.argsort(edge.ravel(), kind="stable")
        pairs = middle[order].reshape(-1, 2, 3)
        np.testing.assert_allclose(pairs[:, 0], pairs[:, 1], atol=1e-12)

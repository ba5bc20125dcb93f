"""Media so dense that light is scattered where it comes in: there, the boundary is a plane.

With light refracted into omega and the camera ray into d, cosines c to the facet, irradiance E across omega:
L = weight E p albedo / (1 + c_d / c_omega), up to the curvature of what is within a mean free path.
"""

import build
import mitsuba as mi
import numpy as np
import oracle
import pytest
from meshes import BoxTree, dot, icosphere, make_patches, take

LIGHT, ETA = np.array([-1.5, 2.4, 3.5]), 1.5
BALL = build.rounded_mesh(icosphere(2))


def plane(o, d):
    """Radiance (N, 3) where rays first come into the ball."""
    legs = oracle.camera_segments([oracle.Body(BALL, ETA, build.ALBEDO, np.ones(3), 0.0)], o, d, 0)
    ray, tri, _, u, v = BoxTree([BALL]).closest(o, d, np.full(len(o), -1))
    _, first = np.unique(legs.ray, return_index=True)
    assert (legs.ray[first] == ray).all()
    patch, inwards = take(make_patches(BALL, ETA), tri), legs.d[first]
    x = oracle.light_ray(patch, np.hstack([u, v]), LIGHT, ETA)
    lit = (x.c_l > 0) & (dot(x.w_l, patch.ng) > 0)
    c_L, c_V = np.maximum(x.c_l, 0), x.c_v
    transmitted = 2 * ETA * c_L**2 * (1 / (c_L + ETA * c_V) ** 2 + 1 / (ETA * c_L + c_V) ** 2)
    E = 10 * transmitted / x.d_l**2
    cosines = np.abs(dot(inwards, patch.ng)) / np.abs(dot(x.omega, patch.ng))
    L = legs.weight[first] * lit * E * build.ALBEDO / (4 * np.pi) / (1 + cosines)
    away = np.hstack([u, v, 1 - u - v]).min(axis=1) > 0.02  # from edges, where two planes meet
    return ray[away], L[away]


@pytest.mark.parametrize("density", [500.0, 5000.0])
def test_dense_media_against_the_plane(rgb, tmp_path, density):
    o, d = build.rays_at((0.0, 1.1, 5.2), 0.8, 200, seed=5)
    shape = build.mesh_shape(BALL, tmp_path / "m.ply", ETA, np.array([1, 0.7, 0.4]), build.ALBEDO)
    shape["interior"]["scale"] = density
    scene = mi.load_dict({"type": "scene", "body": shape, "light": build.point_light(LIGHT, np.full(3, 10.0))})
    found = build.single_scattering(scene, o, d, internal_bounces=0, tolerance=1e-3)
    ray, expected = plane(o, d)
    bright = expected.sum(axis=1) > 0.2 * expected.sum(axis=1).mean()
    error = np.abs(found[ray] - expected).sum(axis=1)[bright] / expected.sum(axis=1)[bright]
    curvature = 2 / (0.4 * density)  # the mean free path of the third colour, in radii, both ways
    assert bright.sum() > 100
    assert np.median(error) < 5e-4 + 0.5 * curvature and error.max() < 3e-3 + 3 * curvature

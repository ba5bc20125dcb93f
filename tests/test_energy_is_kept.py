"""Power that enters a body through its lit triangles = absorbed and scattered + leaving + reflected inside.

The first of these is what the estimator finds, summed over a grid of parallel segments through the body; the others are
of light rays on a grid over the triangles, with the oracle's optics.
"""

import build
import mitsuba as mi
import numpy as np
import oracle
import pytest
from extremes import bumps
from meshes import BoxTree, dot, fresnel_reflectance, icosphere, make_patches, take, unit
from pairs import one_body

LINES = 56
PIECE = 0.1
"""Length of segments along which what the camera's way absorbs is told apart to second order."""


def light_rays(mesh, eta, light, cells):
    """Power that enters along each of many rays, for an intensity of 1; where, whither, and at which triangle."""
    patches = make_patches(mesh, eta)
    area, lit = patches.area2[:, 0] / 2, np.flatnonzero(dot(light - mesh.corners[:, 0], mesh.facet_normals)[:, 0] > 0)
    i, j = np.divmod(np.arange(cells * cells), cells)
    u, v = (i + 0.5) / cells, (j + 0.5) / cells
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    triangle, uv = np.repeat(lit, len(u)), np.tile(np.stack([u, v], axis=1), (len(lit), 1))
    x = oracle.light_ray(take(patches, triangle), uv, light, eta)
    inwards = -dot(x.omega, mesh.facet_normals[triangle])
    power = (1 - fresnel_reflectance(x.c_l, x.c_v, eta)) * x.c_l * inwards / np.maximum(x.c_v, 1e-9) / x.d_l**2
    power = (power * ((x.c_l > 0) & (x.radicand > 0) & (inwards > 0)))[:, 0] * area[triangle] / len(u)
    tree = BoxTree([mesh])
    seen = (power > 0) & tree.clear(x.point, np.broadcast_to(light, x.point.shape), triangle)
    return power[seen], x.point[seen], x.omega[seen], triangle[seen]


def segments_through(mesh, direction):
    """Pieces of all chords of a grid of parallel lines: o, d, length, and the area that each line stands for."""
    side = unit(np.cross(direction, [0.31, 0.52, -0.79]))
    up, size = np.cross(direction, side), 1.2
    x, y = (a.ravel() for a in np.meshgrid(*[(np.arange(LINES) + 0.5) / LINES * 2 * size - size] * 2))
    start = x[:, None] * side + y[:, None] * up - 3 * direction
    along = np.tile(direction, (len(start), 1))
    ray, _, tuv = BoxTree([mesh]).hits(start, along, np.full(len(start), np.inf), np.full(len(start), -1))
    order = np.lexsort((tuv[:, 0], ray))
    ray, t = ray[order], tuv[order, 0]
    even = np.bincount(ray, minlength=len(start)) % 2 == 0
    ray, t = ray[even[ray]], t[even[ray]]
    ray, first, last = ray[::2], t[::2], t[1::2]
    count = np.ceil((last - first) / PIECE).astype(int)
    which = np.repeat(np.arange(len(ray)), count)
    part = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    length = ((last - first) / count)[which]
    o = start[ray[which]] + (first[which] + part * length)[:, None] * direction
    return o, along[ray[which]], length, (2 * size / LINES) ** 2


@pytest.mark.parametrize("mesh, eta, sigma_t", [
    pytest.param(icosphere(3), 1.5, 0.5, marks=pytest.mark.slow), (bumps(3), 1.5, 0.5),
    pytest.param(bumps(3), 1.3, 2.0, marks=pytest.mark.slow), pytest.param(bumps(3), 0.8, 0.5, marks=pytest.mark.slow),
], ids=["ball", "bumps", "dense bumps", "bubble"])  # fmt: skip
def test_power(rgb, tmp_path, mesh, eta, sigma_t):
    mesh, light = build.rounded_mesh(mesh), np.array([-2.6, 2.4, -0.9])
    power, point, omega, triangle = light_rays(mesh, eta, light, 24)
    ray, _, s, _, _ = BoxTree([mesh]).closest(point, omega, triangle)
    length = np.zeros(len(power))
    length[ray] = s[:, 0]
    after = (power * np.exp(-sigma_t * length)).sum()  # leaving or reflected inside
    made = one_body(mesh, eta, light, tmp_path, tolerance=1e-3)
    stayed, rng = [], np.random.default_rng(6)
    for direction in unit(rng.normal(size=(3, 3))):
        o, d, length, area = segments_through(mesh, direction)
        segments = made.segments(o, d, length)
        segments.sigma_t = mi.Spectrum(sigma_t)
        sums, _ = made.scatter(segments)
        fluence = 4 * np.pi * np.array(sums.value)[0]  # isotropic scattering
        x = sigma_t * length
        stayed.append(sigma_t * area * (fluence * x / -np.expm1(-x)).sum())
    assert np.ptp(stayed) < 4e-3 * np.mean(stayed)
    assert abs(np.mean(stayed) + after - power.sum()) < 1e-3 * power.sum(), (stayed, after, power.sum())

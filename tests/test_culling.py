"""Culling loses nothing that contributes, looks at little in vain, and its proofs of visibility hold.

Brute force over all triangles in float64 finds which (camera segment, triangle) pairs contribute: every
triangle is cut into many small ones, on which g = (P - o) . (d x omega) is taken as linear.
"""

import dataclasses

import build
import drjit as dr
import mitsuba as mi
import numpy as np
import oracle
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from meshes import BoxTree, Mesh, dot, icosphere, make_patches, norm, take, triangle_grid

from mitsuba_refscatter import tolerances, wavefront
from mitsuba_refscatter.culling import beams as light_beams
from mitsuba_refscatter.geometry import bvh, silhouette
from mitsuba_refscatter.options import Options

LOST = 1e-5
"""Largest share of a body's radiance that may come from pairs that the culling drops: the rounding of float32."""
SIGMA = 0.5
"""Extinction in 1/length, of bodies of about unit radius."""
CHORD_POINTS = np.array([0.125, 0.375, 0.625, 0.875])
"""Where the curve in a small triangle is looked at."""


# ---- Bodies, segments -----------------------------------------------------------------------


def vertex_normals(vertices, faces):
    """Area-weighted."""
    p = vertices[faces]
    facet, normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], facet)
    return normals / norm(normals)


def random_body(rng, level, amplitude, stretch, smooth):
    """A sphere with random waves on it, stretched by up to ``stretch`` along random axes and moved a little."""
    sphere = icosphere(level)
    x, waves = sphere.vertices, rng.normal(size=(4, 3)) * 2.5
    r = 1 + amplitude * np.sin(x @ waves.T + rng.uniform(0, 6, 4)).sum(1, keepdims=True) / 2
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    vertices = build.rounded(r * x @ turn.T * rng.uniform(1 / stretch, 1, 3) @ turn + rng.uniform(-3, 3, 3))
    return Mesh(vertices, sphere.faces, build.rounded(vertex_normals(vertices, sphere.faces)) if smooth else None)


def chords(mesh, rng, n):
    """Camera segments inside a body: the parts inside it of random lines, some of them short. o, d, t_max."""
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    d = rng.normal(size=(n, 3))
    d = build.rounded(d / norm(d))
    o = build.rounded(rng.uniform(low, high, (n, 3)) - 2 * norm(high - low) * d)
    ray, _, tuv = BoxTree([mesh]).hits(o, d, np.full(n, np.inf), np.full(n, -1))
    order = np.lexsort((tuv[:, 0], ray))
    ray, t = ray[order], tuv[order, 0]
    first = np.searchsorted(ray, ray)  # hits of a ray come in pairs: in, out
    enters = np.flatnonzero(((np.arange(len(ray)) - first) % 2 == 0) & (np.bincount(ray, minlength=n)[ray] % 2 == 0))
    part = np.sort(rng.uniform(0, 1, (len(enters), 2)), axis=1) * (rng.random((len(enters), 1)) < 0.3)
    part[part[:, 1] == 0] = 0, 1
    length = t[enters + 1] - t[enters]
    start = t[enters] + part[:, 0] * length
    k = ray[enters]
    return build.rounded(o[k] + start[:, None] * d[k]), d[k], build.rounded((part[:, 1] - part[:, 0]) * length)


# ---- Brute force ----------------------------------------------------------------------------


def contributing(mesh, eta, light, o, d, t_max):
    """All (segment, triangle) pairs with a contribution, in or out of shadow: segment, triangle, what it brings, and
    a point (u, v) of the triangle that it comes from."""
    centre = mesh.vertices.mean(0)
    patches = make_patches(Mesh(mesh.vertices - centre, mesh.faces, mesh.normals), eta)
    light, o = light - centre, o - centre
    lit = np.flatnonzero(dot(light - patches.p, patches.ng) > 0)
    cells = int(np.clip(np.sqrt(1.5e5 / len(lit)), 4, 40))
    grid, micro = triangle_grid(cells)
    x = oracle.light_ray(take(patches, lit[:, None]), grid, light, eta)
    lines = np.concatenate([np.cross(x.omega, x.point), -x.omega], -1)  # g is their product with the camera's line
    found = []
    batch = max(1, int(2e6 / lines[..., 0].size))
    for first in range(0, len(o), batch):
        part = slice(first, first + batch)
        g = np.moveaxis(lines @ np.hstack([d[part], np.cross(o[part], d[part])]).T, 2, 0)
        positive = (g > 0)[..., micro]
        ray, tri, cell = np.nonzero(positive.any(-1) & ~positive.all(-1))
        corners = g[ray[:, None], tri[:, None], micro[cell]]
        value, uv = _brings(take(patches, lit[tri]), grid[micro[cell]], corners, light, eta, o[ray + first],
                            d[ray + first], t_max[ray + first])  # fmt: skip
        some = value > 0
        found.append([x[some] for x in (ray + first, lit[tri], value, uv)])
    return [np.concatenate(x) for x in zip(*found)]


def _brings(patch, uv, g, light, eta, o, d, t_max):
    """What small triangles uv (n,3,2) with g (n,3) at their corners bring, and a point that it comes from."""
    i, odd = np.arange(len(g)), np.argmax((g > 0) == ((g > 0).sum(1) == 1)[:, None], axis=1)
    A, g_A, ends, share = uv[i, odd], g[i, odd], [], 1
    for k in ((odd + 1) % 3, (odd + 2) % 3):
        r = (g_A / (g_A - g[i, k]))[:, None]
        ends.append(A + r * (uv[i, k] - A))
        share = share * r[:, 0]
    side = np.abs(uv[:, 1] - uv[:, 0]).max(1)
    total, place = np.zeros(len(g)), A
    for tau in CHORD_POINTS:
        point = ends[0] + tau * (ends[1] - ends[0])
        x = oracle.light_ray(patch, point, light, eta)
        t, s, scale = oracle.meeting(x, o, d)
        inside = -dot(x.omega, patch.ng)
        with np.errstate(divide="ignore", invalid="ignore"):
            t, s = t / scale, s / scale
            transmitted = 2 * eta * x.c_l**2 * (1 / (x.c_l + eta * x.c_v) ** 2 + 1 / (eta * x.c_l + x.c_v) ** 2)
            value = transmitted * patch.area2 * inside / x.d_l**2 * np.exp(-SIGMA * (t + s))
        good = (x.c_l > 0) & (x.radicand > 0) & (inside > 0) & (s > 0) & (t > 0) & (t < t_max[:, None])
        value = np.where(good & np.isfinite(value), value, 0)[:, 0] * share * side**2 / np.abs(g_A) / len(CHORD_POINTS)
        total, place = total + value, np.where(value[:, None] > 0, point, place)
    return total, place


# ---- The package ----------------------------------------------------------------------------


class Culling:
    """What the package makes of a scene with one body and one light."""

    def __init__(self, scene, tolerance=0.01):
        from mitsuba_refscatter.integrators.refscatter import Prepared  # made anew for each variant

        prepared = Prepared(scene, Options(tolerance=tolerance))
        self.body, light = prepared.scene.bodies[0], prepared.scene.lights[0]
        self.lighting, self.beams = prepared.beams(self.body, light)

    def candidates(self, o, d, t_max):
        """(segment, triangle) of every beam that is looked at."""
        o, d = (np.asarray(x, np.float32).T for x in (o - self.body.centre, d))
        segments = wavefront.Segments(mi.Point3f(o), mi.Vector3f(d), mi.Float(t_max.astype(np.float32)), mi.Spectrum(1))
        lane, leaf, found = wavefront._traverse(segments, self.beams, 0, len(t_max))
        assert found <= tolerances.CHUNK_PAIRS
        if found == 0:
            return np.zeros(0, int), np.zeros(0, int)
        zeros = light_beams.candidates(self.beams, segments, lane, leaf, found)
        pairs = light_beams.pairs_at(lane, leaf, dr.compress(zeros.possible))
        triangle = dr.gather(mi.UInt32, self.beams.triangles, pairs.beam) - self.body.first_record
        return pairs.segment.numpy().astype(int), triangle.numpy().astype(int)

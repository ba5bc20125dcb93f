"""Brute force over all triangles, to hold the culling against; random bodies and camera segments.

Every triangle is cut into many small ones, on which g = (P - o) . (d x omega) is taken as linear. NumPy in float64; the
package is used in ``Culling`` alone.
"""

import build
import drjit as dr
import mitsuba as mi
import numpy as np
import oracle
from hypothesis import assume, note
from meshes import BoxTree, Mesh, dot, icosphere, make_patches, norm, take, triangle_grid
from scipy.spatial import ConvexHull, HalfspaceIntersection

from mitsuba_refscatter import tolerances
from mitsuba_refscatter.core.cache import Cache
from mitsuba_refscatter.culling.bundles import bundles_of
from mitsuba_refscatter.estimators import wavefront
from mitsuba_refscatter.estimators.accumulator import Sums
from mitsuba_refscatter.geometry import bvh
from mitsuba_refscatter.integrators.prepared import prepare
from mitsuba_refscatter.light import light_samples
from mitsuba_refscatter.options import Options
from mitsuba_refscatter.transport.segments import LocalSegments

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


def wavy(rng, level, amplitude, stretch, smooth):
    """A sphere with random waves on it, stretched by up to ``stretch`` along random axes and moved a little."""
    sphere = icosphere(level)
    x, waves = sphere.vertices, rng.normal(size=(4, 3)) * 2.5
    r = 1 + amplitude * np.sin(x @ waves.T + rng.uniform(0, 6, 4)).sum(1, keepdims=True) / 2
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    vertices = build.rounded(r * x @ turn.T * rng.uniform(1 / stretch, 1, 3) @ turn + rng.uniform(-3, 3, 3))
    return Mesh(vertices, sphere.faces, build.rounded(vertex_normals(vertices, sphere.faces)) if smooth else None)


def cut_box(rng, level):
    """A box with corners and edges cut off, its facets quartered ``level`` times."""
    sides = np.concatenate([np.eye(3), -np.eye(3), rng.normal(size=(rng.integers(1, 8), 3))])
    planes = np.hstack([sides / norm(sides), -rng.uniform(0.6, 1, (len(sides), 1))])
    points = HalfspaceIntersection(planes, np.zeros(3)).intersections
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    turned = (
        dot(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), hull.equations[:, :3])[:, 0] < 0
    )
    corners[turned] = corners[turned, ::-1]
    for _ in range(level):
        a, b, c = corners.transpose(1, 0, 2)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        corners = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    vertices, faces = np.unique(build.rounded(corners).reshape(-1, 3).round(6), axis=0, return_inverse=True)
    return Mesh(build.rounded(vertices), faces.reshape(-1, 3), None)


def torus(around, across, radius):
    """A ring of radius 1 and thickness ``radius`` with 2 * around * across triangles and facet normals."""
    a, b = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    phi, psi = 2 * np.pi * a / around, 2 * np.pi * b / across
    ring = 1 + radius * np.cos(psi)
    points = np.stack([ring * np.cos(phi), ring * np.sin(phi), radius * np.sin(psi)], axis=-1).reshape(-1, 3)

    def at(i, j):
        return (((a + i) % around) * across + (b + j) % across).ravel()

    faces = [np.stack([at(0, 0), at(1, 0), at(1, 1)], 1), np.stack([at(0, 0), at(1, 1), at(0, 1)], 1)]
    return Mesh(build.rounded(points), np.concatenate(faces), None)


def bevelled_box(rows=40):
    """A box of edge 2 of which the edge at (-1, -1) is cut off; its sides are cut in ``rows`` along z."""
    ring = [(-1, 0), (0, -1), (1, -1), (1, 1), (-1, 1)]
    points = [(x, y, z) for z in np.linspace(-1, 1, rows + 1) for x, y in ring] + [(0, 0, -1), (0, 0, 1)]
    faces, end = [], len(points) - 2
    for i in range(5):
        j = (i + 1) % 5
        faces += [(5 * r + i, 5 * r + j, 5 * r + 5 + k) for r in range(rows) for k in (j,)]
        faces += [(5 * r + i, 5 * r + 5 + j, 5 * r + 5 + i) for r in range(rows)]
        faces += [(end, j, i), (end + 1, 5 * rows + i, 5 * rows + j)]
    return Mesh(np.array(points, float), np.array(faces), None)


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


def random_case(seed):
    """A body, its index of refraction, a light outside and a tolerance; the numbers to report."""
    rng = np.random.default_rng(seed)
    level, eta = int(rng.integers(1, 4)), rng.uniform(1.05, 2.4) if rng.random() < 0.75 else rng.uniform(0.5, 0.97)
    boxy, smooth, tolerance = rng.random() < 0.4, rng.random() < 0.6, rng.choice([0.0, 0.01, 0.5])
    amplitude, stretch, distance = rng.uniform(0, 0.4), rng.uniform(1, 3), 1 + 10 ** rng.uniform(-1.5, 1.2)
    mesh = cut_box(rng, level) if boxy else wavy(rng, level, amplitude, stretch, smooth)
    middle, side = mesh.vertices.mean(0), rng.normal(size=3)
    light = build.rounded(middle + distance * norm(mesh.vertices - middle).max() * side / norm(side))
    note(f"{boxy=} {level=} {amplitude=} {stretch=} {smooth=} {eta=} {distance=} {tolerance=}")
    return mesh, eta, light, float(tolerance), chords(mesh, rng, 80)


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
        rays = o[ray + first], d[ray + first], t_max[ray + first]
        value, uv = _brings(take(patches, lit[tri]), grid[micro[cell]], corners, light, eta, rays)
        some = value > 0
        found.append([x[some] for x in (ray + first, lit[tri], value, uv)])
    return [np.concatenate(x) for x in zip(*found)]


def _brings(patch, uv, g, light, eta, rays):
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
        value = _value(patch, point, light, eta, rays) * share * side**2 / np.abs(g_A) / len(CHORD_POINTS)
        total, place = total + value, np.where(value[:, None] > 0, point, place)
    return total, place


def _value(patch, point, light, eta, rays):
    """The integrand at points (u, v), attenuation included; 0 where no light comes from there to the segment."""
    x, (o, d, t_max) = oracle.light_ray(patch, point, light, eta), rays
    t, s, scale = oracle.meeting(x, o, d)
    inside = -dot(x.omega, patch.ng)
    with np.errstate(all="ignore"):  # where a value is not finite there is no light, see below
        t, s = t / scale, s / scale
        transmitted = 2 * eta * x.c_l**2 * (1 / (x.c_l + eta * x.c_v) ** 2 + 1 / (eta * x.c_l + x.c_v) ** 2)
        value = transmitted * patch.area2 * inside / x.d_l**2 * np.exp(-SIGMA * (t + s))
    good = (x.c_l > 0) & (x.radicand > 0) & (inside > 0) & (s > 0) & (t > 0) & (t < t_max[:, None])
    return np.where(good & np.isfinite(value), value, 0)[:, 0]


def real(patch, uv, light, eta, rays):
    """Whether there is light at the roots of g nearest to points that the grid found; near the critical angle g is far
    from linear even on it."""
    o, d, _ = rays
    for _ in range(30):
        g, gradient = oracle.beam_gap(patch, uv, light, eta, o, d)
        step = g[:, None] * gradient / np.maximum(dot(gradient, gradient), 1e-300)
        uv = uv - step * np.minimum(1, 0.02 / np.maximum(norm(step), 1e-300))
    return _value(patch, uv, light, eta, rays) > 0


# ---- The package ----------------------------------------------------------------------------


class Culling:
    """What the package makes of a scene with one body and one light; where things are estimated, they are found exactly
    instead."""

    def __init__(self, scene, accuracy=None, **options):
        exact = {"samples_visibility": False, "cells": 0.0, **(accuracy or {})}
        self.prepared = prepare(scene, Options(**options), Cache(), lambda: 0, changes=exact)
        self.body, (emitter,) = self.prepared.scene.bodies[0], self.prepared.scene.emitters
        region, sample = self.prepared.scene.regions[0], light_samples.exact(emitter)
        self.illumination, self.culling = self.prepared.illuminated(self.body, region, sample, emitter)

    def segments(self, o, d, t_max):
        o, d = (np.asarray(x, np.float32).T for x in (o - self.body.centre, d))
        return LocalSegments(mi.Point3f(o), mi.Vector3f(d), mi.Float(t_max.astype(np.float32)), mi.Spectrum(SIGMA))

    def scatter(self, segments, illumination=None, estimator=None, **run):
        """``wavefront.scatter`` along segments: its sums and counts."""
        return wavefront.scatter(
            segments, self.culling, illumination or self.illumination, estimator or self.prepared.estimator,
            wavefront.Run(self.prepared.accuracy, **run),
        )  # fmt: skip

    def work(self, segments, **changes):
        """The stages of the wavefront, with nothing summed yet."""
        parts = {"sums": Sums.nothing(len(segments)), "segments": segments, "culling": self.culling,
                 "bundles": bundles_of(segments, self.culling.bundle, self.culling.width),
                 "illumination": self.illumination, "accuracy": self.prepared.accuracy,
                 "estimator": self.prepared.estimator}  # fmt: skip
        return wavefront.Work(**{**parts, **changes})

    def leaves(self, segments):
        """The (bundle, leaf) pairs of the tree: two index arrays, of which the first ``found`` places count."""
        work = self.work(segments)
        lane, leaf, found = work.traverse(0, len(work.bundles))
        assert found <= tolerances.CHUNK_PAIRS
        return lane, leaf, found

    def candidates(self, o, d, t_max):
        """(segment, triangle) of every pair that is looked at, and how many are candidates by the culling itself."""
        segments = self.segments(o, d, t_max)
        work = self.work(segments)
        lane, leaf, found = self.leaves(segments)
        if found == 0:
            return np.zeros(0, int), np.zeros(0, int), 0
        index, per_pair = dr.arange(mi.UInt32, found * bvh.LEAF * work.bundles.most), bvh.LEAF * work.bundles.most
        pairs, bundle = work.bundles.pairs(lane, leaf, index), dr.gather(mi.UInt32, lane, index // per_pair)
        first, count = (dr.gather(mi.UInt32, x, bundle) for x in (work.bundles.first, work.bundles.count))
        pairs = pairs.gather(dr.compress(pairs.segment < first + count))
        exists, zeros, _, _ = work.classify(pairs)
        looked_at = int(dr.count(zeros.possible if self.culling.for_one_light else exists)[0])
        pairs = pairs.gather(dr.compress(zeros.possible))
        triangle = self.culling.triangle_of(pairs) - self.body.first_record
        return pairs.segment.numpy().astype(int), triangle.numpy().astype(int), looked_at


def one_body(mesh, eta, light, folder, **options):
    shape = build.mesh_shape(mesh, folder / "mesh.ply", eta=eta)
    return Culling(mi.load_dict({"type": "scene", "body": shape, "light": build.point_light(light)}), **options)


def lost_and_looked_at(mesh, eta, light, culling, rays):
    """Share of the light from pairs that the culling drops, and candidates per contributing pair.

    Dropped on purpose is only what the light does not reach: a triangle in the shadow of others."""
    o, d, t_max = rays
    segment, triangle, looked_at = culling.candidates(o, d, t_max)
    ray, tri, value, uv = contributing(mesh, eta, light, o, d, t_max)
    pairs = len(mesh.faces) * ray + tri
    lost = ~np.isin(pairs, len(mesh.faces) * segment + triangle)
    patch, ray, uv = take(make_patches(mesh, eta), tri[lost]), ray[lost], uv[lost]
    point = oracle.light_ray(patch, uv, light, eta).point
    seen = BoxTree([mesh]).clear(point, np.broadcast_to(light, point.shape), tri[lost])
    seen &= real(patch, uv, light, eta, (o[ray], d[ray], t_max[ray]))
    assume(len(pairs) > 0)
    return value[lost][seen].sum() / value.sum(), looked_at / len(np.unique(pairs))

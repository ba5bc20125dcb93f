"""A million triangles with nothing in common, each with a light, a point V and a root that Snell's law makes."""

from collections import namedtuple

import build
import drjit as dr
import mitsuba as mi
import numpy as np
import oracle
from meshes import Patch, dot, norm, triangle_grid, unit

from mitsuba_refscatter import tolerances
from mitsuba_refscatter.culling import beam
from mitsuba_refscatter.culling.pairs import Pairs, Taken
from mitsuba_refscatter.estimators import point, wavefront
from mitsuba_refscatter.estimators.accumulator import Sums
from mitsuba_refscatter.estimators.pair_data import PairData
from mitsuba_refscatter.geometry import triangle
from mitsuba_refscatter.light.illumination import Illumination
from mitsuba_refscatter.optics import LocalLight
from mitsuba_refscatter.solve import newton
from mitsuba_refscatter.transport.segments import LocalSegments

# patch; light, V (n,3); uv (n,2): a root that is known.
Case = namedtuple("Case", "patch light V uv")


def random_cases(rng, n, eta):
    """Cases of all sizes: edges of 0.01 to 1 at distances of about 1; flat, curved outwards and curved inwards."""
    direction = unit(rng.normal(size=(n, 3)))
    e1 = unit(np.cross(direction, rng.normal(size=(n, 3))))
    size = 10 ** rng.uniform(-2, 0, (n, 1))
    e2 = size * (np.cross(direction, e1) + rng.uniform(-0.5, 0.5, (n, 1)) * e1)
    e1 = size * e1
    # Normals of a sphere with this curvature, and a little noise on them; where nothing is refracted those of the
    # facet.
    bend = rng.uniform(-0.8, 1.5, (n, 1)) * (rng.random((n, 1)) < 0.9) * (eta != 1)
    noise = bend * size * 0.2
    corners = [unit(direction + bend * e + noise * rng.normal(size=(n, 3))) for e in (0 * e1, e1, e2)]
    p = 0.3 * rng.normal(size=(n, 3))
    corners, p, e1, e2 = (build.rounded(x) for x in (corners, p, e1, e2))
    cross = np.cross(e1, e2)
    patch = Patch(p, e1, e2, corners[0], corners[1] - corners[0], corners[2] - corners[0], unit(cross), norm(cross))
    light = build.rounded(p + 10 ** rng.uniform(-0.5, 1, (n, 1)) * unit(direction + 0.7 * rng.normal(size=(n, 3))))
    uv = rng.random((n, 2))
    uv = np.where(uv.sum(1, keepdims=True) > 1, 1 - uv, uv)
    x = oracle.light_ray(patch, uv, light, eta)
    V = build.rounded(x.point + 10 ** rng.uniform(-1, 0.3, (n, 1)) * x.omega)
    lit = (dot(light - p, patch.ng) > 0) & (x.c_l > 0) & (x.radicand > 0) & (dot(x.omega, patch.ng) < 0)
    keep = np.flatnonzero(lit)
    return Case(Patch(*(y[keep] for y in patch)), light[keep], V[keep], uv[keep])


def isotropic(omega, d):
    return 1 / (4 * np.pi)


class Soup:
    """Culling that gives each segment the triangle of its number."""

    for_one_light, most_levels = False, tolerances.MAX_SUBDIVISION

    def __init__(self, patch):
        corners = np.stack([patch.p, patch.p + patch.e1, patch.p + patch.e2], 1)
        normals = np.stack([patch.n, patch.n + patch.m1, patch.n + patch.m2], 1)
        self.records = mi.Float(triangle.pack(corners, normals, patch.ng))

    def plausible(self, pairs, segment, incidence):
        return dr.full(mi.Bool, True, len(pairs))

    def take(self, pairs, incidence, active=True):
        tri = triangle.gather(self.records, pairs.beam, active)
        place = pairs.place(mi.Float(0), mi.Float(0), mi.Float(1))
        piece = beam.piece_at(tri, incidence, *place)
        return Taken(tri, piece, pairs.code is not None, None, mi.Bool(False), mi.Bool(False))

    def triangle_of(self, pairs):
        return pairs.beam


class Roots(point.Point):
    """In place of an estimator: keeps the roots instead of summing what they bring."""

    def queries(self, *_):
        return None

    def __init__(self):
        self.found, self.statuses, self.evaluations = [], np.zeros(len(newton.Status), int), np.zeros(64, int)

    def accumulate(self, sums, pairs, segments, culling, illumination, accuracy):
        pair = PairData.of(pairs, segments, culling, illumination)
        solution, _, valid = point.roots(pair)
        u, v = (pair.piece.h * x + x0 for x, x0 in zip(solution.x, (pair.piece.u0, pair.piece.v0)))
        dr.eval(u, v, valid, solution.status, solution.iterations)
        kept = np.array(valid)
        columns = (pairs.segment, culling.triangle_of(pairs), u, v)
        self.found.append([np.array(x)[kept].astype(float) for x in columns])
        self.statuses += np.bincount(np.array(solution.status), minlength=len(newton.Status))
        self.evaluations += np.bincount(np.array(solution.iterations), minlength=64)

    def all(self):
        """Segment, triangle (n,) and (u, v) (n,2) of all roots."""
        segment, tri, u, v = (np.concatenate(x) for x in zip(*self.found))
        return segment.astype(int), tri.astype(int), np.stack([u, v], 1)


def points_as_segments(V):
    """Camera segments of no length."""
    V = mi.Point3f(np.asarray(V, np.float32).T)
    width = dr.width(V)
    return LocalSegments(
        V, mi.Vector3f(0, 0, 1) + dr.zeros(mi.Vector3f, width), dr.zeros(mi.Float, width), mi.Spectrum(0)
    )


def solve(case, eta, tolerance=0.01):
    """All roots that the package finds for cases: ``Roots``."""
    n, roots = len(case.V), Roots()
    light = mi.Point3f(np.asarray(case.light, np.float32).T)
    illumination = Illumination(
        LocalLight(light), dr.opaque(mi.Float, eta), int(np.sign(eta - 1)), isotropic, None, None
    )
    segments = points_as_segments(case.V)
    work = wavefront.Work(Sums.nothing(n), segments, None, Soup(case.patch), illumination,
                          tolerances.accuracy(tolerance), roots)  # fmt: skip
    index = dr.arange(mi.UInt32, n)
    pairs = Pairs(index, index)
    _, zeros, bent, _ = work.classify(pairs)
    work.solve(pairs.gather(dr.compress(zeros.bracketed & ~bent)))
    work.refine(pairs.gather(dr.compress(zeros.possible & bent)))
    return roots


# ---- What a root is, in float64 ------------------------------------------------------------------


def polished(case, index, uv, eta, steps=6):
    """Roots (u, v) near to those of the cases ``index``, by Newton's method on (V - P) x omega = 0 in float64."""
    patch, light, V = Patch(*(x[index] for x in case.patch)), case.light[index], case.V[index]
    for _ in range(steps):
        x = oracle.light_ray(patch, uv, light, eta)
        to_V = V - x.point
        m = np.cross(to_V, x.omega)
        a, b = (np.cross(to_V, w) - np.cross(e, x.omega)
                for e, w in zip((patch.e1, patch.e2), oracle.light_slopes(patch, x, eta)))  # fmt: skip
        aa, ab, bb, am, bm = dot(a, a), dot(a, b), dot(b, b), dot(a, m), dot(b, m)
        step = np.hstack([bb * am - ab * bm, aa * bm - ab * am]) / np.maximum(aa * bb - ab**2, 1e-300)
        uv = uv - step * np.minimum(1, LONGEST / np.maximum(norm(step), 1e-300))
    return uv


LONGEST = 0.1
"""Longest step in (u, v)."""


def every_root(case, eta, starts):
    """Case (m,) and (u, v) (m,2) of all roots inside the triangles that Newton's method finds from starts^2 points
    each."""
    grid = triangle_grid(starts)[0]
    middles = grid[triangle_grid(starts)[1]].mean(1)
    index = np.repeat(np.arange(len(case.V)), len(middles))
    with np.errstate(all="ignore"):
        uv = polished(case, index, np.tile(middles, (len(case.V), 1)), eta, steps=25)
        good = (uv.min(1) > 0) & (uv.sum(1) < 1) & (miss(case, index, uv, eta) < 1e-9)
    index, uv = index[good], uv[good]
    _, first = np.unique(np.column_stack([index, np.round(uv, 5)]), axis=0, return_index=True)
    return index[first], uv[first]


def miss(case, index, uv, eta):
    """How light refracted at (u, v) passes V: angle between its direction and that to V, seen from P; > 1 where the
    point is not lit, reflects totally, or light leaves instead of entering."""
    patch = Patch(*(x[index] for x in case.patch))
    x = oracle.light_ray(patch, uv, case.light[index], eta)
    to_V = unit(case.V[index] - x.point)
    sides = (x.c_l > 0) & (x.radicand > 0) & (dot(x.omega, patch.ng) < 0) & (dot(to_V, patch.ng) < 0)
    sides &= dot(case.light[index] - x.point, patch.ng) > 0
    return np.where(sides, norm(np.cross(to_V, x.omega)) + 2 * (dot(to_V, x.omega) < 0), 9)[:, 0]

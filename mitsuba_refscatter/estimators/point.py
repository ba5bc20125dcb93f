"""The point estimator: in-scattered light at sample points of the camera segments (Walter et al. 2009).

For each sample point V all light paths L -> P -> V over all candidate triangles are found and summed by the point form
(``point_form``). Departures from the publication:

- A triangle is cut where refraction is far from linear on it, until one root per part is all there is. That is a bound
  from six points, no proof. Near a caustic one triangle has several roots.
- The samples are stratified in the angle under which the light, unrefracted, would see the segment (equiangular; Kulla
  and Fajardo 2012).
- The residual of Newton's method is q x n instead of the half vector's (``solve.constraint``), so that eta may be near
  or equal to 1.
- Triangles are found by the same test in a tree whose nodes are spheres and cones of normals. All triangles of a sample
  point are found first, and then solved together.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..culling import beam as light_beam
from ..solve import newton
from ..solve.constraint import connect
from . import point_form
from .pair_data import PairData
from .protocol import Estimator, Query
from .spacing import ByAngle, ByDepth


def sample_points(segments, illumination, first, several, n, seed):
    """Some of ``n`` sample points of each segment.

    segments      ``LocalSegments``
    illumination  ``light.illumination.Illumination``
    first         int, number of the first point of each segment that is asked for
    several       int, how many are asked for
    n             int, how many each segment has in all
    seed          int, of random numbers

    Returns the indices (UInt32) of their segments, segments of no length at these points, and their weights (Spectrum):
    1 / density times the attenuation along the camera ray.
    """
    lane, count = dr.arange(mi.UInt32, several * len(segments)), dr.opaque(mi.UInt32, len(segments))
    index, k = lane % count, dr.opaque(mi.UInt32, first) + lane // count
    segment = segments.gather(index)
    x = (mi.Float(k) + mi.sample_tea_float32(k * count + index, dr.opaque(mi.UInt32, seed))) / dr.opaque(mi.Float, n)
    sigma_t = segments.sigma_t_of(index)
    if illumination.light.distant:
        spacing = ByDepth(dr.mean(sigma_t), segment.t_max)
    else:
        spacing = ByAngle(illumination.at(index).light.L - segment.o, segment)
    t = spacing.t(x)
    weight = dr.rcp(spacing.density(t) * dr.opaque(mi.Float, n))
    points = replace(segment, o=segment.o + t * segment.d, t_max=dr.zeros(mi.Float, dr.width(t)), sigma_t=sigma_t)
    return index, points, weight * dr.exp(-sigma_t * t)


class Point(Estimator):
    """Roots of the constraint at sample points of the segments (Walter et al. 2009)."""

    needs_fine = False  # each root is exact
    samples_field = "point_samples"
    draws = finds_sent_back = True

    def queries(self, segments, illumination, accuracy, seed):
        """As ``Estimator.queries``: ``accuracy.point_samples`` points of each segment."""
        n = accuracy.point_samples
        at_once = max(1, min(n, tolerances.PASS_SAMPLES // len(segments)))
        for first in range(0, n, at_once):
            several = min(at_once, n - first)
            index, points, weight = sample_points(segments, illumination, first, several, n, seed)
            dr.eval(index, points.o, weight)
            yield Query(index, points, weight, (first / n, (first + several) / n))

    def classify(self, piece, segment):
        """The zeros of the moment (``zeros_of_moment``)."""
        return zeros_of_moment(piece, segment)

    def accumulate(self, sums, pairs, segments, culling, illumination, _accuracy):
        """As ``Estimator.accumulate``, for sample points; nothing is left over."""
        pair = PairData.of(pairs, segments, culling, illumination)
        piece = pair.piece
        solution, path, active = roots(pair)
        u, v = (x0 + piece.h * x for x0, x in zip((piece.u0, piece.v0), solution.x))
        active = pair.visible(path.P, (u, v), path.omega_V, path.s, active)
        value = point_form.in_scattered(pair, path)
        finite = dr.all(dr.isfinite(value))
        failed = (solution.status == int(newton.Status.OUT_OF_ITERATIONS)) | (active & ~finite)
        sums.add(pairs, dr.select(active & finite, value, 0), active, ~failed)
        sums.eval()


def zeros_of_moment(piece, segment):
    """``beam.Zeros`` of the moment m = (V - P) x omega on beams, which is zero at the roots for V.

    m is taken as its two components across the mean direction of the light. ``g`` are the barycentric coordinates of
    the linear m's root (times an area), with that area last. Each part may hold a root: ``bracketed`` = ``possible``.
    """
    omega = piece.omega
    axis = mi.Frame3f(dr.normalize(omega[0] + omega[1] + omega[2]))
    m, farthest = [], mi.Float(0)
    for p, w in zip(piece.P, omega):
        to_V = segment.o - p
        moment = dr.cross(to_V, w)
        m.append(mi.Vector2f(dr.dot(moment, axis.s), dr.dot(moment, axis.t)))
        farthest = dr.maximum(farthest, dr.norm(to_V))
    bound = piece.bend * farthest + piece.twist + tolerances.MOMENT * farthest
    areas = [_cross(m[1], m[2]), _cross(m[2], m[0]), _cross(m[0], m[1])]
    area = areas[0] + areas[1] + areas[2]
    edges = [dr.norm(m[2] - m[1]), dr.norm(m[0] - m[2]), dr.norm(m[1] - m[0])]
    longest = light_beam.fold(dr.maximum, edges)
    # The triangle of linear values, wider by the bound on all sides, holds 0; its box does, where it is too thin.
    possible = mi.Bool(True)
    for a, edge in zip(areas, edges):
        possible &= a * dr.sign(area) >= -bound * edge
    thin = dr.abs(area) <= bound * longest
    possible |= thin
    for k in range(2):
        low, high = (light_beam.fold(f, [x[k] for x in m]) for f in (dr.minimum, dr.maximum))
        possible &= (low <= bound) & (high >= -bound)
    nonlinearity = bound * longest / dr.maximum(dr.abs(area), 1e-30)
    return light_beam.Zeros(possible, possible, [*areas, area], nonlinearity)


def roots(pair):
    """The root of each light beam for V = the segment's origin: ``(solution, path, valid)``, at most one.

    pair  ``PairData``

    ``solution``: ``newton.Solution``, place in the piece; ``path``: the ``constraint.Connection`` at the root;
    ``valid``: Bool, whether there is one, inside the beam's own triangle.
    """
    piece, tri, segment = pair.piece, pair.tri, pair.segment
    zeros = zeros_of_moment(piece, segment)
    area = dr.select(zeros.g[3] == 0, 1, zeros.g[3])
    start = mi.Vector2f(dr.clip(zeros.g[1] / area, 0, 1), dr.clip(zeros.g[2] / area, 0, 1))
    start /= dr.maximum(1, start.x + start.y)
    solution = point_form.root(pair, segment.o, start)
    a, b = point_form.in_double(pair, segment.o, solution.x) if pair.taken.parts else solution.x
    # A root on the edge between two parts of a triangle belongs to one of them: the middle ones (h < 0) are open
    # where the others are closed.
    inside = dr.select(piece.h > 0, (a >= 0) & (b >= 0) & (a + b < 1), (a > 0) & (b > 0) & (a + b <= 1))
    solution.x = mi.Float(a), mi.Float(b)
    u, v = piece.u0 + piece.h * solution.x[0], piece.v0 + piece.h * solution.x[1]
    path = connect(tri, pair.illumination, segment.o, segment.d, u, v)
    return solution, path, solution.converged & inside & point_form.refracts(path, tri)


def _cross(a, b):
    return a.x * b.y - a.y * b.x

"""The radiance per unit length along camera segments: what the curve estimator integrates, point by point.

A ``Profile`` takes an estimator's place in ``wavefront.sweep``, so that it gets the same pairs, whole or cut. It follows the curve g = 0
in each light beam and keeps cells of it: the radiance per unit length in the point form (``point_form``) at three points, and what the
cell brings in the curve form (``curve``). The second is the integral over t of the first, also across a fold, where the first grows
like |t - t_fold|^(-1/2).
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..core import arrays
from ..culling import beam as light_beam
from ..solve.constraint import connect
from . import curve, point_form
from .chord import chord_of, limits_at, meeting
from .protocol import Estimator


@dataclass
class Cells:
    """Parts of the curves in light beams that light reaches, each with three points: its ends and, between them, its middle.

    ``triangle``: index among the scene's records; ``t``: distances along the segment; ``P``: points of the boundary, body
    coordinates; ``slope``: the sign of dt along the curve; ``density``: radiance per unit length, and ``total`` its integral over the
    cell, both with all attenuation, without the segment's weight, sigma_s and the light's intensity; ``solved``: whether the
    point in the middle was found. ``t``, ``P``, ``slope`` and ``density`` are lists of three. One camera segment.
    """

    triangle: object
    t: list
    P: list
    slope: list
    density: list
    total: object
    solved: object

    def gather(self, index):
        return Cells(*([arrays.gather(y, index) for y in x] if isinstance(x, list) else arrays.gather(x, index)
                       for x in vars(self).values()))  # fmt: skip


class Profile(Estimator):
    """Collects the ``Cells`` of the one camera segment that is swept, ``parts`` of the curve in each light beam; in ``found``, a list."""

    def __init__(self, parts):
        self.parts, self.found = parts, []

    def classify(self, piece, segment):
        """The zeros of g."""
        return light_beam.classify(piece, segment)

    def accumulate(self, _sums, pairs, segments, culling, illumination, accuracy):
        """Keeps the cells of pairs; nothing is added to the sums, nothing is left over."""
        cells, exists = _cells(pairs.cut(self.parts), segments, culling, illumination, accuracy)
        dr.eval(cells, exists)
        kept = dr.compress(exists)
        if dr.width(kept) > 0:
            cells = cells.gather(kept)
            dr.eval(cells)
            self.found.append(cells)


def _cells(pairs, segments, culling, illumination, accuracy):
    """``Cells`` of pairs that are parts of curves, and which of them light reaches."""
    segment, illumination = segments.gather(pairs.segment), illumination.at(pairs.segment)
    taken, sigma_t = culling.take(pairs, illumination), segments.sigma_t_of(pairs.segment)
    tri = taken.tri
    chord, ends = chord_of(taken.piece, tri, illumination, segment)
    part = curve.lit_part(pairs, chord, ends, tri, illumination, segment, accuracy.newton)
    width = part.end - part.start
    cells = Cells(culling.triangle_of(pairs), [], [], [], [], mi.Spectrum(0), mi.Bool(True))
    exists = chord.active & (width > 0)
    for share in (0, 0.5, 1):
        found = curve.solve(
            chord, chord.direction(part.start + share * width), tri, illumination, segment, accuracy.newton
        )
        point, inverse_slope, solved = found
        t, s = meeting(point.P, point.omega, segment)
        density, slope = _density(point, t, s, chord, tri, illumination, segment, sigma_t)
        for values, value in zip((cells.t, cells.P, cells.density, cells.slope), (t, point.P, density, slope)):
            values.append(value)
        if share == 0.5:
            for limit in limits_at(point, t, s, tri, segment, illumination):
                exists &= limit > 0
            exists = illumination.visible(point.P, tri.Ng, point.omega, point.u, point.v, s, taken, exists)
            total = chord.scale * width * inverse_slope * curve.integrand(point, illumination, segment)
            total *= dr.exp(-sigma_t * t - illumination.extinction(sigma_t, point.omega, segment.d) * s)
            cells.total, cells.solved = total, solved
            exists &= dr.all(dr.isfinite(total))
    return cells, exists


def _density(point, t, s, chord, tri, illumination, segment, sigma_t):
    """The point form at a point of the curve, and the sign of dt along it in the direction of the chord.

    Where the segment meets the boundary, next to P, V is moved on along the light, as its direction from P would be rounding.
    """
    nearest = tolerances.APART * dr.maximum(dr.norm(point.P), segment.t_max)
    V = dr.select(s > nearest, segment.o + t * segment.d, point.P + nearest * point.omega)
    path = connect(tri, illumination, V, segment.d, point.u, point.v)
    value = point_form.in_scattered(path, tri, segment.d, illumination, sigma_t) * dr.exp(-sigma_t * t)
    tangent, along = path.residual(illumination.straight).tangent(), chord.to_E2 - chord.to_E1
    return value, dr.sign(tangent.x * (tangent.y * along.x + tangent.z * along.y))


def means(cells, length, n):
    """The mean radiance per unit length (Spectrum) in each of ``n`` equal parts of a segment of that ``length``.

    Half of a cell's total is spread evenly between its middle and either end, so that the sum times length / n is the sum of
    the totals.
    """
    out, step = dr.zeros(mi.Spectrum, n), dr.opaque(mi.Float, length / n)
    last = dr.opaque(mi.UInt32, n - 1)
    for a, b in zip(cells.t[:2], cells.t[1:]):
        low, high = (dr.clip(f(a, b) / step, 0, n) for f in (dr.minimum, dr.maximum))
        k, end = (dr.minimum(mi.UInt32(x), last) for x in (low, high))

        def add(k):
            overlap = dr.minimum(high, mi.Float(k) + 1) - dr.maximum(low, mi.Float(k))
            share = dr.select(high > low, overlap / (high - low), 1)
            dr.scatter_add(out, 0.5 * cells.total * share / step, k)
            return (k + 1,)

        dr.while_loop((k,), lambda k: k <= end, add, label="parts", mode="symbolic")
        dr.eval(out)
    return out

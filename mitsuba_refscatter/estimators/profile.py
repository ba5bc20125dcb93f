"""The radiance per unit length along camera segments: what the curve estimator integrates, point by point.

A ``Profile`` takes an estimator's place in ``wavefront.sweep``, so that it gets the same pairs, whole or cut. It
follows the curve g = 0 in each light beam and keeps cells of it. Each has the radiance per unit length in the point
form (``point_form``) at three points, and what the cell brings in the curve form (``curve``). The second is the
integral over t of the first, also across a fold, where the first grows like |t - t_fold|^(-1/2).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..core import arrays
from ..culling import beam as light_beam
from ..solve.constraint import connect
from . import curve, point_form
from .chord import chord_of, limits_at, meeting
from .pair_data import PairData
from .protocol import Estimator


@dataclass
class Cells:
    """Parts of the curves in light beams that light gets to, of one camera segment.

    Lists have an entry for each of three points of a part: its ends and, between them, its middle. Radiances are with
    all attenuation, without the segment's weight, sigma_s and the light's intensity.

    triangle  UInt32, index among the scene's records
    t         list of Float, distances along the segment
    P         list of Point3f, points of the boundary, body coordinates
    slope     list of Float, the sign of dt along the curve
    density   list of Spectrum, radiance per unit length
    total     Spectrum, integral of the density over the cell
    solved    Bool, whether the point in the middle was found
    """

    triangle: mi.UInt32
    t: list[mi.Float]
    P: list[mi.Point3f]
    slope: list[mi.Float]
    density: list[mi.Spectrum]
    total: mi.Spectrum
    solved: mi.Bool

    def gather(self, index):
        """Those at ``index`` (UInt32)."""
        return Cells(*([arrays.gather(y, index) for y in x] if isinstance(x, list) else arrays.gather(x, index)
                       for x in vars(self).values()))  # fmt: skip


class Profile(Estimator):
    """Collects the ``Cells`` of the one camera segment that is swept, in ``found``, a list.

    ``parts``: int, of the curve in each light beam.
    """

    def __init__(self, parts):
        self.parts, self.found = parts, []

    def classify(self, piece, segment):
        """The zeros of g."""
        return light_beam.classify(piece, segment)

    def accumulate(self, _sums, pairs, segments, culling, illumination, accuracy):
        """Keeps the cells of pairs; nothing is added to the sums, nothing is left over."""
        pair = PairData.of(pairs.cut(self.parts), segments, culling, illumination)
        cells, exists = _cells(pair, culling.triangle_of(pair.pairs), accuracy.newton)
        dr.eval(cells, exists)
        lit = dr.compress(exists)
        if dr.width(lit) > 0:
            cells = cells.gather(lit)
            dr.eval(cells)
            self.found.append(cells)


def _cells(pair, triangle, newton):
    """``Cells`` of pairs that are parts of curves, and which of them light gets to (Bool).

    pair      ``PairData``
    triangle  UInt32, index of each pair's triangle
    newton    int, Newton steps
    """
    segment, sigma_t, illumination = pair.segment, pair.sigma_t, pair.illumination
    chord, ends = chord_of(pair)
    part = curve.part_of(pair, chord, ends, newton)
    width = part.end - part.start
    cells = Cells(triangle, [], [], [], [], mi.Spectrum(0), mi.Bool(True))
    exists = chord.active & (width > 0)
    for share in (0, 0.5, 1):
        point, inverse_slope, solved = curve.solve(pair, chord, chord.direction(part.start + share * width), newton)
        t, s = meeting(point.P, point.omega, segment)
        density, slope = _density(pair, chord, point, t, s)
        for values, value in zip((cells.t, cells.P, cells.density, cells.slope), (t, point.P, density, slope)):
            values.append(value)
        if share == 0.5:
            for limit in limits_at(pair, point, t, s):
                exists &= limit > 0
            exists = pair.visible(point.P, (point.uv.x, point.uv.y), point.omega, s, exists)
            total = chord.scale * width * inverse_slope * curve.integrand(pair, point)
            total *= dr.exp(-sigma_t * t - illumination.extinction(sigma_t, point.omega, segment.d) * s)
            cells.total, cells.solved = total, solved
            exists &= dr.all(dr.isfinite(total))
    return cells, exists


def _density(pair, chord, point, t, s):
    """The point form at a ``curve.CurvePoint``, and the sign of dt along the curve in the direction of the chord.

    Where the segment meets the boundary, next to P, V is moved on along the light, as its direction from P would be
    rounding.
    """
    segment, uv = pair.segment, point.uv
    nearest = tolerances.APART * dr.maximum(dr.norm(point.P), segment.t_max)
    V = dr.select(s > nearest, segment.o + t * segment.d, point.P + nearest * point.omega)
    path = connect(pair.tri, pair.illumination, V, segment.d, uv.x, uv.y)
    value = point_form.in_scattered(pair, path) * dr.exp(-pair.sigma_t * t)
    tangent, along = path.residual(pair.illumination.straight).tangent(), chord.to_E2 - chord.to_E1
    return value, dr.sign(tangent.x * (tangent.y * along.x + tangent.z * along.y))


def means(cells, length, n):
    """The mean radiance per unit length (Spectrum) in each of ``n`` equal parts of a segment of that ``length``.

    Half of a cell's total is spread evenly between its middle and either end. The sum times length / n is then the sum
    of the totals.
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

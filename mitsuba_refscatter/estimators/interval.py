"""The interval estimator: the parts of a camera segment that each triangle lights, sampled regularly (Holzschuch 2015).

For each candidate triangle the curve of points that refract light onto the camera segment runs from one edge to
another. Newton's method with one coordinate fixed finds its ends. In between it finds the points of the curve at fixed
distances t along the segment. The point form (``point_form``) is summed there. Departures from the publication:

- The search for the ends starts where the linear g (``beam.classify``) is zero on the edges. The publication starts
  where the camera ray meets the triangle's plane, from where a walk along the curve's gradient may lose it. Where g is
  far from linear the triangle is cut first, so that closed curves, and several in one triangle, are found, too.
- The gradient (the cross product of two rows of the Jacobian) tells at both ends whether t grows inwards. If it does,
  or falls, at both, t has an extremum in between (a fold): the interval is split there. The publication assumes one
  monotone interval.
- Samples are regular not in t but in x, with t a quadratic of x that has the gradient's slopes at both ends. The
  integrand, which grows like |t - t_c|^(-1/2) at a fold, is then bounded. With equal slopes both are the same.
- The residual of Newton's method is q x n instead of the half vector's (``solve.constraint``), so that eta may be near
  or equal to 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..core import arrays
from ..culling import beam as light_beam
from ..geometry.interval import positive_part
from ..solve import newton
from ..solve.constraint import connect
from . import point_form
from .chord import chord_of, meeting
from .pair_data import PairData
from .protocol import Estimator


@dataclass
class _End:
    """A point of the curve, lane by lane.

    uv     Vector2f, place in the triangle
    t      Float, distance along the segment
    slope  Float, dt by the position along the chord
    path   Float, t + s
    """

    uv: mi.Vector2f
    t: mi.Float
    slope: mi.Float
    path: mi.Float

    def gather(self, index):
        return arrays.gather_record(self, index)


class Interval(Estimator):
    """Regular samples of the parts of segments that triangles light (Holzschuch 2015)."""

    samples_field = "interval_samples"

    def classify(self, piece, segment):
        """The zeros of g."""
        return light_beam.classify(piece, segment)

    def accumulate(self, sums, pairs, segments, culling, illumination, accuracy):
        """As ``Estimator.accumulate``; nothing is left over."""
        pair = PairData.of(pairs, segments, culling, illumination)
        curve = _Curves(pair)
        start, end = curve.end(curve.start), curve.end(curve.stop)
        folds = curve.exists & (start.slope * end.slope < 0)
        dr.eval(start, end, folds, curve.exists)
        folded = dr.compress(folds)
        _sample(sums, pair, (start, end), curve.exists & ~folds, accuracy)
        if dr.width(folded) > 0:
            pair = PairData.of(pairs.gather(folded), segments, culling, illumination)
            start, end = start.gather(folded), end.gather(folded)
            fold = _Curves(pair).fold(start, end)
            dr.eval(fold)
            for ends in ((start, fold), (fold, end)):
                _sample(sums, pair, ends, mi.Bool(True), accuracy)


class _Curves:
    """The curves in the light beams of pairs, each parametrised by tau along the chord.

    tau chooses a ray from a corner M through the chord (``chord.Chord``); those for tau = 0 and 1 run along edges. The
    part from ``start`` to ``stop`` faces the light, which is not reflected totally there.
    """

    def __init__(self, pair):
        self.pair = pair
        self.chord, limits = chord_of(pair)
        # Of the limits those of the segment's own ends are taken later, exactly.
        self.start, self.stop = positive_part(limits[3:])
        self.exists = self.chord.active & (self.start < self.stop)
        self.along = self.chord.to_E2 - self.chord.to_E1

    def end(self, tau):
        """The curve's point at tau: Newton's method for t and the position on the ray from M."""
        D, segment, tri, illumination = (
            self.chord.direction(tau),
            self.pair.segment,
            self.pair.tri,
            self.pair.illumination,
        )
        uv = self.chord.M + D
        P, omega, _ = light_beam.refracted(tri, uv.x, uv.y, illumination)
        t, _ = meeting(P, omega, segment)
        # t in units of what it changes by per unit of the ray, roughly: as much as P moves.
        unit = dr.norm(tri.P_u * D.x + tri.P_v * D.y)

        def system(x, lam):
            uv = self.chord.M + lam * D
            V = segment.o + (t + x * unit) * segment.d
            c = self._connect(V, uv).residual(illumination.straight)
            return c.value, c.by_t * unit, c.by_u * D.x + c.by_v * D.y

        solution = newton.solve(
            system,
            (dr.zeros(mi.Float, dr.width(t)), dr.full(mi.Float, 1, dr.width(t))),
            lambda x, lam: (lam >= 0) & (lam <= tolerances.OVERSHOOT),
            point_form.NEWTON,
        )
        x, lam = (dr.select(solution.converged, a, b) for a, b in zip(solution.x, (0, 1)))
        uv, t = self.chord.M + lam * D, t + x * unit
        path = self._connect(segment.o + t * segment.d, uv)
        tangent = path.residual(illumination.straight).tangent()
        forward = tangent.y * self.along.x + tangent.z * self.along.y
        slope = tangent.x * dr.squared_norm(self.along) / dr.select(forward == 0, 1, forward)
        return _End(uv, t, slope, t + path.s)

    def _connect(self, V, uv):
        return connect(self.pair.tri, self.pair.illumination, V, self.pair.segment.d, uv.x, uv.y)

    def fold(self, start, end):
        """The extremum of t between two ``_End`` at which its slopes differ in sign: regula falsi for the slope."""
        lo, hi, at_lo, at_hi = self.start, self.stop, start.slope, end.slope
        for _ in range(tolerances.FOLD_STEPS):
            tau = lo - at_lo * (hi - lo) / (at_hi - at_lo)
            middle = self.end(tau)
            before = (middle.slope > 0) == (at_lo > 0)
            lo, at_lo = dr.select(before, tau, lo), dr.select(before, middle.slope, at_lo)
            hi, at_hi = dr.select(before, hi, tau), dr.select(before, at_hi, middle.slope)
        return _End(middle.uv, middle.t, dr.zeros(mi.Float, dr.width(middle.t)), middle.path)


@dataclass
class _Range:
    """t as a quadratic of x, 0 to 1, with t(0), t(1) and the ratio of the slopes there given; lane by lane.

    t0      Float, t(0)
    change  Float, t(1) - t(0)
    r       Float, slope at 0 over the sum of both slopes, 0 to 1
    first   Float, x where the part that lies on the segment begins
    last    Float, x where it ends
    """

    t0: mi.Float
    change: mi.Float
    r: mi.Float
    first: mi.Float
    last: mi.Float

    def t(self, x):
        """t at x."""
        return self.t0 + self.change * (2 * self.r * x + (1 - 2 * self.r) * dr.square(x))

    def dt(self, x):
        """|dt/dx| at x."""
        return 2 * dr.abs(self.change) * (self.r + (1 - 2 * self.r) * x)


def _range(a, b, t_max):
    """``_Range`` between two points of a curve; with equal slopes where those known are of no use."""
    change = b.t - a.t
    slopes = dr.abs(a.slope) + dr.abs(b.slope)
    monotone = (a.slope * change >= 0) & (b.slope * change >= 0) & (slopes > 0) & dr.isfinite(slopes)
    r = dr.select(monotone, dr.abs(a.slope) / slopes, 0.5)

    def x(t):
        y = dr.clip((t - a.t) / dr.select(change == 0, 1, change), 0, 1)
        return y / dr.maximum(r + dr.safe_sqrt(dr.square(r) + (1 - 2 * r) * y), 1e-30)

    x0, x1 = x(mi.Float(0)), x(t_max)
    return _Range(a.t, change, r, dr.minimum(x0, x1), dr.maximum(x0, x1))


def _sample(sums, pair, ends, exists, accuracy):
    """Adds the intervals between two points of the curves of pairs to sums, by regular samples.

    sums      ``accumulator.Sums``
    pair      ``PairData``
    ends      two ``_End`` of the curves
    exists    Bool, which of them are to be added
    accuracy  ``tolerances.Accuracy``
    """
    (a, b), segment, sigma_t = ends, pair.segment, pair.sigma_t
    piece, n = pair.piece, dr.opaque(mi.UInt32, accuracy.interval_samples)
    span = _range(a, b, segment.t_max)
    if accuracy.adapts:
        depth = dr.max(sigma_t) * dr.abs(b.path - a.path) * (span.last - span.first)
        n += mi.UInt32(mi.Float(n) * dr.clip(depth * tolerances.DEPTH_SAMPLES, 0, tolerances.MOST_SAMPLES))
    step = (span.last - span.first) / mi.Float(n)
    exists = exists & (step > 0)
    along, forward = b.uv - a.uv, dr.sign(span.change)

    def sample(i, total, contributes, found):
        x = span.first + (mi.Float(i) + 0.5) * step
        t = span.t(x)
        start = (a.uv + x * along - mi.Point2f(piece.u0, piece.v0)) / piece.h
        V = segment.o + t * segment.d
        solution = point_form.root(pair, V, start, exists)
        u, v = piece.u0 + piece.h * solution.x[0], piece.v0 + piece.h * solution.x[1]
        path = connect(pair.tri, pair.illumination, V, segment.d, u, v)
        # The other side of a fold has a root at the same t.
        tangent = path.residual(pair.illumination.straight).tangent()
        same_side = tangent.x * (tangent.y * along.x + tangent.z * along.y) * forward > 0
        active = exists & solution.converged & same_side
        found += dr.select(active, 1, 0)
        active &= point_form.refracts(path, pair.tri)
        active = pair.visible(path.P, (u, v), path.omega_V, path.s, active)
        value = point_form.in_scattered(pair, path)
        value *= dr.exp(-sigma_t * t) * span.dt(x) * step
        active &= dr.all(dr.isfinite(value))
        return i + 1, total + dr.select(active, value, 0), contributes | active, found

    width = len(pair.pairs)
    nothing = dr.zeros(mi.UInt32, width)
    state = (nothing, dr.zeros(mi.Spectrum, width), dr.zeros(mi.Bool, width), dr.zeros(mi.UInt32, width))
    end = dr.while_loop(state, lambda i, *_: i < n, sample, label="samples", mode="symbolic")
    total, contributes, found = end[1], end[2], end[3]
    # Next to a fold, or where a whole curve has nearly the same t, samples fail: t is not known to enough digits.
    resolved = mi.Float(found) >= tolerances.FOUND * mi.Float(n)
    sums.add(pair.pairs, total, contributes, resolved, pair.pairs.share())
    sums.eval()

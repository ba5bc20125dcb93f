"""The curve estimator on light beams that are quadratic between their nodes (``light.beams``).

    L = sum over beams of  integral over {g = 0} of  phi |omega| p exp(-sigma_t (t + s |omega|)) / |grad g| dl

g is a quadratic of (u, v), so that g = 0 is a conic. Where it cuts a beam once, it runs between its zeros E1 and E2 on
the two edges at a corner A. On the ray from A through X = (1 - tau) E1 + tau E2 it is known in closed form. With
g(A + lambda (X - A)) = 0 at lambda:

    integral over {g = 0} of F / |grad g| dl = |A E1 x A E2| * integral over tau of F lambda / |dg/dlambda|.

Other beams are cut into quarters, on which g is a quadratic, too. A closed curve inside of a beam, an ellipse, counts
for 2 pi / sqrt(det H) times F in its middle, with H the second derivatives of g.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..culling.beam import Zeros
from ..geometry.interval import positive_part
from ..light import beams
from ..light.illumination import Illumination
from ..transport.segments import LocalSegments
from .protocol import Estimator


@dataclass
class _Pair:
    """Camera segments and light beams, lane by lane.

    segment       in body coordinates, without its ``sigma_t``
    sigma_t       Spectrum, extinction along it
    illumination  of the boundary
    beam          ``beams.LightBeams``
    q             Vector3f, (o - centre) x d
    u0, v0, h     Float, what part of the beam is meant: corner and signed size
    """

    segment: LocalSegments
    sigma_t: mi.Spectrum
    illumination: Illumination
    beam: beams.LightBeams
    q: mi.Vector3f
    u0: mi.Float
    v0: mi.Float
    h: mi.Float

    @classmethod
    def of(cls, pairs, segments, culling, illumination):
        segment = segments.gather(pairs.segment)
        beam = beams.LightBeams.gather(culling.records, pairs.beam, more=culling.more)
        q = dr.cross(segment.o - beam.centre, segment.d)
        part = pairs.place(mi.Float(0), mi.Float(0), mi.Float(1))
        return cls(segment, segments.sigma_t_of(pairs.segment), illumination.at(pairs.segment), beam, q, *part)

    def g(self):
        """g at the ``NODES`` of the part."""
        d = self.segment.d
        return [-(dr.dot(m, d) + dr.dot(w, self.q)) for w, m in zip(self.beam.omega, self.beam.m)]

    def weights(self, u, v):
        """``beams.weights`` at (u, v) of the part."""
        return beams.weights(dr.fma(self.h, u, self.u0), dr.fma(self.h, v, self.v0))

    def line(self, w):
        """``_Line`` at ``weights`` w."""
        beam, segment = self.beam, self.segment
        omega, m = beams.mix(w, beam.omega), beams.mix(w, beam.m)
        normal = dr.cross(segment.d, omega)
        sine2 = dr.maximum(dr.squared_norm(normal), tolerances.PARALLEL)
        o = segment.o - beam.centre
        t = dr.dot(m - dr.cross(o, omega), normal) / sine2
        V = o + t * segment.d
        size = dr.norm(omega)
        s = (dr.dot(V, omega) - beams.mix(w, beam.e)) / size
        return _Line(omega, m, size, t, s, beams.mix(w, beam.length))


@dataclass
class _Line:
    """A light line where it meets a camera line.

    omega   Vector3f, nearly unit
    m       Vector3f
    size    Float, norm of omega
    t, s    Float, lengths along both
    length  Float, how far light goes
    """

    omega: mi.Vector3f
    m: mi.Vector3f
    size: mi.Float
    t: mi.Float
    s: mi.Float
    length: mi.Float

    def limits(self, t_max):
        """What must be positive for light to get to the segment."""
        return [self.t, t_max - self.t, self.s, self.length - self.s]

    def reaches(self, t_max):
        """Whether light gets to the segment (Bool)."""
        out = mi.Bool(True)
        for limit in self.limits(t_max):
            out &= limit > 0
        return out


class BeamCurve(Estimator):
    """Integration over light beams whose errors follow ``tolerance``."""

    def classify(self, piece, segment):
        """``Zeros`` of g on beams, of which ``piece`` are the lines."""
        possible = piece.may_meet(segment.o, segment.d)
        return Zeros(possible, possible, [], mi.Float(0))

    def accumulate(self, sums, pairs, segments, culling, illumination, accuracy):
        """As ``Estimator.accumulate``. Returns the quarters of pairs that must be cut."""
        pair = _Pair.of(pairs, segments, culling, illumination)
        level = mi.UInt32(0) if pairs.level is None else pairs.level
        may_cut = level < dr.opaque(mi.UInt32, culling.most_levels)
        total, contributes, cut, resolved = _sum(pair, may_cut, culling.parts(accuracy), accuracy)
        sums.add(pairs, total, contributes & ~cut, resolved, pairs.share())
        sums.eval(cut)
        return pairs.gather(dr.compress(cut)).quarters()


@dataclass
class _Arc:
    """Where a conic cuts a triangle once; (x, y) are its coordinates from the corner A along the edges to B and C.

    c        six Float, coefficients of g: 1, x, y, x^2, xy, y^2
    turn     UInt32, which corner is A
    E1, E2   Float, place on AB and on AC
    once     Bool, whether it is so
    several  Bool, whether the conic cuts the triangle's edges more than twice, or one of them twice
    """

    c: tuple
    turn: mi.UInt32
    E1: mi.Float
    E2: mi.Float
    once: mi.Bool
    several: mi.Bool

    @classmethod
    def of(cls, g):
        up = [x >= 0 for x in g[:3]]
        several = mi.Bool(False)
        for k in range(3):
            a, b = g[k], g[(k + 1) % 3]
            middle = 2 * g[3 + k] - 0.5 * (a + b)
            several |= (up[k] == up[(k + 1) % 3]) & (a * middle < 0) & (dr.square(middle) > a * b)
        first, second = (up[0] == up[2]) & (up[1] != up[0]), (up[0] == up[1]) & (up[2] != up[0])
        once = first | second | ((up[1] == up[2]) & (up[0] != up[1]))
        turn = dr.select(first, mi.UInt32(1), dr.select(second, mi.UInt32(2), mi.UInt32(0)))

        def turned(values):
            return [
                dr.select(first, values[(k + 1) % 3], dr.select(second, values[(k + 2) % 3], values[k]))
                for k in range(3)
            ]

        c = beams.monomials(turned(g[:3]) + turned(g[3:]))
        E1, E2 = _on_edge(c[0], c[1], c[3]), _on_edge(c[0], c[2], c[5])
        return cls(c, turn, E1, E2, once, several)

    def uv(self, x, y):
        """(u, v) of the part at (x, y)."""
        z = 1 - x - y
        u = dr.select(self.turn == 1, z, dr.select(self.turn == 2, y, x))
        v = dr.select(self.turn == 1, x, dr.select(self.turn == 2, z, y))
        return u, v

    def meet(self, tau):
        """On the ray from A to ``tau`` of the chord: the curve's x and y, lambda / |dg/dlambda|, whether it is met."""
        x, y = (1 - tau) * self.E1, tau * self.E2
        a, b, c, d, e, f = self.c
        beta, gamma = b * x + c * y, d * dr.square(x) + e * x * y + f * dr.square(y)
        root2 = dr.square(beta) - 4 * a * gamma
        slope = dr.copysign(dr.safe_sqrt(root2), -a)
        steep = beta * slope > 0
        lam = dr.select(steep, -2 * a, slope - beta) / dr.select(steep, beta + slope, 2 * gamma)
        found = (root2 > 0) & dr.isfinite(lam) & (lam > 0) & (lam * (x + y) <= 1 + tolerances.OUTSIDE)
        linear = dr.maximum(dr.abs(a), 1e-30)
        lam = dr.select(found, lam, 1)
        return lam * x, lam * y, dr.select(found, lam / dr.maximum(dr.abs(slope), 1e-30), dr.rcp(linear)), found


def _on_edge(a, b, d):
    """The zero in [0, 1] of a + b x + d x^2, which has different signs at the ends (Float)."""
    slope = dr.copysign(dr.safe_sqrt(dr.square(b) - 4 * d * a), -a)
    steep = b * slope > 0
    x = dr.select(steep, -2 * a, slope - b) / dr.select(steep, b + slope, 2 * d)
    return dr.clip(dr.select(dr.isfinite(x), x, 0.5), 0, 1)


@dataclass
class _Way:
    """The part of a curve, start < tau < end, from which light gets to the segment as far as its ends tell.

    limits      pairs of Float, ``_Line.limits`` at both ends of the whole curve
    start, end  Float, tau; of all of it where there is no such part
    width       Float, their difference, or 0 where there is no such part
    unsure      Bool, whether light begins or ends inside the beam, or nearly so
    path        Float at either end of the whole curve: t + s
    """

    limits: list
    start: mi.Float
    end: mi.Float
    width: mi.Float
    unsure: mi.Bool
    path: list[mi.Float]

    @classmethod
    def of(cls, pair, arc):
        ends = [pair.line(pair.weights(*arc.uv(x, y))) for x, y in ((arc.E1, mi.Float(0)), (mi.Float(0), arc.E2))]
        limits = list(zip(*(x.limits(pair.segment.t_max) for x in ends)))
        start, end = positive_part(limits)
        unsure = mi.Bool(False)
        for a, b in limits:
            nearest = dr.minimum(dr.maximum(a, b), -dr.minimum(a, b))
            unsure |= nearest > -tolerances.MARGIN * dr.abs(a - b)
        part = end > start
        start, end = dr.select(part, start, 0), dr.select(part, end, 1)
        return cls(limits, start, end, dr.select(part, end - start, 0), unsure, [x.t + x.s for x in ends])

    @property
    def slope(self):
        """Change of t + s along the whole curve."""
        return self.path[1] - self.path[0]

    def at(self, share):
        """tau at a share of the part, 0 to 1."""
        return dr.fma(share, self.end - self.start, self.start)

    def part(self, begin, share):
        """A ``share`` of the part, from ``begin`` (0 to 1) on."""
        return replace(self, start=self.at(begin), end=self.at(begin + share), width=self.width * share)

    def misjudged(self, tau, line, clip, t_max):
        """Whether the line at ``tau`` (Float) shows that the ends do not tell enough: t + s is far from linear where
        light begins or ends inside, or a limit may have another sign in between."""
        off = dr.abs(line.t + line.s - dr.fma(tau, self.slope, self.path[0]))
        out = self.unsure & (off > dr.opaque(mi.Float, clip) * dr.abs(self.slope))
        for (a, b), there in zip(self.limits, line.limits(t_max)):
            out |= (a * b > 0) & (dr.abs(there - dr.fma(tau, b - a, a)) > dr.minimum(dr.abs(a), dr.abs(b)))
        return out

    def in_sight(self, sigma_t):
        """Whether anything of it may be seen through the medium."""
        nearest = dr.minimum(dr.fma(self.start, self.slope, self.path[0]), dr.fma(self.end, self.slope, self.path[0]))
        nearest -= tolerances.MARGIN * dr.abs(self.slope)
        return dr.min(sigma_t) * nearest < tolerances.OPAQUE


def _sum(pair, may_cut, parts, accuracy):
    """What pairs bring (Spectrum), by so many ``parts`` of curves, which of them anything (Bool), which must be cut
    first (Bool), and which are resolved (Bool)."""
    g = pair.g()
    if dr.width(pair.h) > 1:  # of the part
        g = [beams.mix(pair.weights(u, v), g) for u, v in beams.NODES]
    arc = _Arc.of(g)
    way = _Way.of(pair, arc)
    deep = dr.max(dr.abs(way.slope * way.width * pair.sigma_t)) > tolerances.DEPTH
    cut = deep & (way.width > 0)
    loop, centre, ring = _loop(arc)
    share = dr.rcp(dr.opaque(mi.Float, parts))

    def step(i, total, contributes, cut, resolved):
        part = way.part(i * share, share)
        density, rise, uneven = _mean_density(arc, part)
        cut = cut | ((uneven > dr.opaque(mi.Float, accuracy.uneven)) & (part.width > 0))
        tau = part.at(0.5)
        x, y, _, found = arc.meet(tau)
        ringed = loop & (i == 0)  # a closed curve has one point, its middle
        x, y = dr.select(ringed, centre[0], x), dr.select(ringed, centre[1], y)
        w = pair.weights(*arc.uv(x, y))
        line = pair.line(w)
        cut = cut | way.misjudged(tau, line, accuracy.clip, pair.segment.t_max)
        # By one point: the means along the part of what changes most, relative to its middle.
        change = part.slope * part.width * pair.sigma_t
        value = (density * _sinhc(0.5 * change) - rise * change / 12) * (arc.E1 * arc.E2 * part.width)
        value = dr.select(ringed, mi.Spectrum(ring), value)
        value *= _integrand(pair, line, w) * dr.exp(-_depth(pair, line))
        active = ((arc.once & (part.width > 0)) | ringed) & line.reaches(pair.segment.t_max)
        finite = dr.all(dr.isfinite(value))
        total = total + dr.select(active & finite, value, 0)
        return i + 1, total, contributes | active, cut, resolved & (~active | ((found | loop) & finite))

    n, last = dr.width(cut), dr.opaque(mi.Float, parts)
    state = mi.Float(0), dr.zeros(mi.Spectrum, n), dr.zeros(mi.Bool, n), cut, dr.full(mi.Bool, True, n)
    end = list(dr.while_loop(state, lambda i, *_: i < last, step, label="curve", mode="symbolic"))
    total, contributes, cut, resolved = end[1:]
    cut = may_cut & (arc.several | (cut & arc.once & way.in_sight(pair.sigma_t)))
    return total * dr.square(pair.h), contributes, cut, resolved


def _mean_density(arc, way):
    """Mean of lambda / |dg/dlambda| along a part of a curve (Simpson's rule), how much it rises, and how far the middle
    is from the mean, relative to it; infinite where the curve is not found."""
    middle, mean, rise, everywhere = mi.Float(0), mi.Float(0), mi.Float(0), mi.Bool(True)
    for share, weight in ((0.0, 1 / 6), (0.5, 2 / 3), (1.0, 1 / 6)):
        _, _, density, found = arc.meet(way.at(share))
        mean += weight * density
        rise += (2 * share - 1) * density
        everywhere &= found
        middle = density if share == 0.5 else middle
    return mean, rise, dr.select(everywhere, dr.abs(mean - middle) / middle, dr.inf)


def _depth(pair, line):
    """Optical depth of both ways (Spectrum)."""
    sigma_t = pair.sigma_t
    behind = pair.illumination.extinction(sigma_t, line.omega / line.size, pair.segment.d)
    return sigma_t * line.t + behind * line.s


def _loop(arc):
    """Closed curves inside: whether there is one (Bool), its middle (x, y), and what it counts for (Float)."""
    a, b, c, d, e, f = arc.c
    det = 4 * d * f - dr.square(e)
    safe = dr.select(det > 0, det, 1)
    x, y = (c * e - 2 * f * b) / safe, (b * e - 2 * d * c) / safe
    inside = (x > 0) & (y > 0) & (x + y < 1)
    middle = a + 0.5 * (b * x + c * y)
    return ~arc.once & ~arc.several & (det > 0) & inside & (middle * a < 0), (x, y), dr.two_pi * dr.rsqrt(safe)


def _integrand(pair, line, w):
    """phi |omega| p, times what the light sends into this direction (Spectrum or Float)."""
    beam, illumination = pair.beam, pair.illumination
    value = dr.maximum(beams.mix(w, beam.phi), 0) * line.size
    value *= illumination.phase(line.omega / line.size, pair.segment.d)
    if beam.more:
        return value * illumination.carried([beams.mix(w, x) for x in beam.more])
    if illumination.emission is None:
        return value
    P = beams.start(line.omega, line.m, beams.mix(w, beam.e)) + beam.centre
    return value * illumination.emitted(P, *illumination.light.seen_from(P))


def _sinhc(x):
    """sinh(x) / x to 1e-4 for |x| <= 1."""
    y = dr.square(dr.minimum(dr.abs(x), 1))
    return 1 + y / 6 + dr.square(y) / 120

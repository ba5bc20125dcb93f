"""The curve estimator: single scattering as an integral along the curve g = 0 in each light beam.

    L = sum over triangles of  integral over {g = 0} of
        I T A2 |omega . Ng| / d_L^2  sigma_s p exp(-sigma_t (t + s)) V(P,L) V(P,V) / |grad g|  dl,
    g(u, v) = (P - o) . (d x omega).

g is zero where the light beam refracted at (u, v) meets the camera line. This is the light-side form of the
single-scattering integral. It has no distance correction D as in Walter et al. 2009 and Holzschuch 2015, and no
singularity at folds of the caustic.

Take a beam whose corners have g of different signs. Let E1 and E2 be the points on its edges where the linear g
vanishes, and M a corner. With X = (1 - tau) E1 + tau E2 and g(M + lambda (X - M)) = 0 at lambda:

    integral over {g = 0} of F / |grad g| dl = |M E1 x M E2| * integral over tau of F lambda / |dg/dlambda|

with a constant integrand where g is linear and F constant. (The right side is the integral of F delta(g) in the
coordinates (tau, lambda), whose area element is |M E1 x M E2| lambda.)
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .. import optics, tolerances
from ..culling import beam as light_beam
from ..geometry.interval import gauss_legendre, positive_part
from .beam_curve import BeamCurve
from .chord import chord_of, limits_at, meeting
from .pair_data import PairData
from .protocol import Estimator


@dataclass
class CurvePoint:
    """The quantities of the integrand at one (u, v) per lane, in body coordinates.

    uv       Vector2f, place in the triangle
    P        Point3f
    area     Vector3f, normal of the surface, as long as its area per (u, v)
    omega_L  Vector3f, unit direction to the light
    omega    Vector3f, unit direction of the refracted light
    c_L      Float, cosine outside
    c_V      Float, cosine inside
    d_L      Float, distance of the light (1 if it is distant)
    slope    Float, derivative of g along a direction
    g        Float
    """

    uv: mi.Vector2f
    P: mi.Point3f
    area: mi.Vector3f
    omega_L: mi.Vector3f
    omega: mi.Vector3f
    c_L: mi.Float
    c_V: mi.Float
    d_L: mi.Float
    slope: mi.Float
    g: mi.Float


def _evaluate(pair, uv, D):
    """``CurvePoint`` at ``uv``, with the slope of g in the direction ``D`` (Vector2f)."""
    tri, eta, light, segment = pair.tri, pair.illumination.eta, pair.illumination.light, pair.segment
    P = tri.position(uv.x, uv.y)
    n, d_n = tri.normal_derivative(uv.x, uv.y, D.x, D.y)
    d_P = tri.P_u * D.x + tri.P_v * D.y
    omega_L, d_L = light.seen_from(P)
    d_omega_L = light.direction_change(omega_L, d_L, d_P)
    omega, c_L, c_V = optics.refract_in(omega_L, n, eta)
    d_omega = optics.refract_in_derivative(omega_L, n, eta, (c_L, c_V), d_omega_L, d_n)
    across = dr.cross(P - segment.o, segment.d)
    g = dr.dot(omega, across)
    slope = dr.dot(d_omega, across) + dr.dot(omega, dr.cross(d_P, segment.d))
    return CurvePoint(uv, P, dr.cross(tri.P_u, tri.P_v), omega_L, omega, c_L, c_V, d_L, slope, g)


@dataclass
class _Part:
    """The part of a chord, start < tau < end, from which light gets to the segment, lane by lane.

    start   Float, tau where it begins
    end     Float, tau where it ends
    unsure  Bool, whether it begins or ends inside the beam, or nearly so
    path    t + s as a linear function of tau: (tau0, value there, slope), Float each
    """

    start: mi.Float
    end: mi.Float
    unsure: mi.Bool
    path: tuple[mi.Float, mi.Float, mi.Float]

    def path_at(self, tau):
        """t + s at ``tau``."""
        tau0, value, slope = self.path
        return value + (tau - tau0) * slope


def _clip(limits, tau0, tau1):
    """The ``_Part`` of tau0 < tau < tau1 in which all limits are positive, given their values at both ends."""
    start, end = positive_part(limits)
    unsure, width = mi.Bool(False), tau1 - tau0
    for at_0, at_1 in limits:
        nearest = dr.minimum(dr.maximum(at_0, at_1), -dr.minimum(at_0, at_1))
        unsure |= nearest > -tolerances.MARGIN * dr.abs(at_0 - at_1)
    (t_0, t_1), _, (s_0, s_1) = limits[:3]
    path = (tau0, t_0 + s_0, (t_1 + s_1 - t_0 - s_0) / width)
    return _Part(tau0 + start * width, tau0 + end * width, unsure, path)


class Curve(Estimator):
    """Exact integration over the light's side, to float32 where ``tolerance`` is 0."""

    of_beams = BeamCurve()

    def classify(self, piece, segment):
        """The zeros of g."""
        return light_beam.classify(piece, segment)

    def accumulate(self, sums, pairs, segments, culling, illumination, accuracy):
        """As ``Estimator.accumulate``. Returns the pairs that were left out since their curves must be cut first.

        Where culling has proofs, the pairs that they show free come first, without any shadow ray, and then the others.
        Otherwise, and for parts of curves, which are few, all come at once.
        """

        def data(pairs):
            return PairData.of(pairs, segments, culling, illumination)

        def proof(pair, point, s, _active):
            free, blocked = pair.illumination.known(point.uv.x, point.uv.y, s, pair.taken)
            return free, ~(free | blocked)

        def rays(pair, point, s, active):
            return pair.visible(point.P, (point.uv.x, point.uv.y), point.omega, s, active), False

        if illumination.shadowless or not culling.for_one_light or pairs.tau0 is not None:
            return pairs.gather(dr.compress(_accumulate(sums, data(pairs), accuracy, rays)[1])).cut(tolerances.CUT)
        is_open, cut = _accumulate(sums, data(pairs), accuracy, proof)
        open_pairs = dr.compress(is_open)
        if dr.width(open_pairs) > 0:
            _accumulate(sums, data(pairs.gather(open_pairs)), accuracy, rays)
        return pairs.gather(dr.compress(cut)).cut(tolerances.CUT)


def part_of(pair, chord, ends, newton):
    """The ``_Part`` of the chord to integrate over.

    It is of all of the chord, or of the pairs' own parts, whose ends are solved for.

    pair    ``PairData``
    chord   its ``Chord``
    ends    the limits at both ends of all of the chord, as ``chord_of`` gives them
    newton  int, Newton steps
    """
    pairs = pair.pairs
    if pairs.tau0 is None:
        return _clip(ends, mi.Float(0), mi.Float(1))
    limits = []
    for tau in (pairs.tau0, pairs.tau1):
        point, _, _ = solve(pair, chord, chord.direction(tau), newton)
        t, s = meeting(point.P, point.omega, pair.segment)
        limits.append(limits_at(pair, point, t, s))
    return _clip(list(zip(*limits)), pairs.tau0, pairs.tau1)


@dataclass
class _Cutting:
    """Which curves are cut into parts before they are integrated, lane by lane.

    allowed  Bool, whether a curve may be cut at all
    needed   Bool, whether the optical depth changes too much along it
    change   Spectrum, change of the optical depth along it
    slack    Float, how far t + s may be from linear where it begins or ends inside the beam
    """

    allowed: mi.Bool
    needed: mi.Bool
    change: mi.Spectrum
    slack: mi.Float


def _cutting(pair, chord, part, width, clip):
    """``_Cutting`` of curves along a ``_Part`` of that ``width`` in tau; ``clip``: that of ``tolerances.Accuracy``."""
    pairs, sigma_t = pair.pairs, pair.sigma_t
    slope = dr.abs(part.path[2])
    change = slope * width * sigma_t
    # Where much is absorbed a part is short by its optical depth, and what is behind OPAQUE does not matter.
    steepest = dr.maximum(dr.max(sigma_t) * slope, 1)
    length = mi.Float(1) if pairs.tau0 is None else pairs.tau1 - pairs.tau0
    nearest = dr.minimum(part.path_at(part.start), part.path_at(part.end))
    nearest -= tolerances.MARGIN * slope * length
    allowed = chord.active & (length * steepest > tolerances.SHORTEST)
    allowed &= dr.min(sigma_t) * nearest < tolerances.OPAQUE
    needed = allowed & (dr.max(change) > tolerances.DEPTH)
    return _Cutting(allowed, needed, change, dr.opaque(mi.Float, clip) * slope / steepest)


def _accumulate(sums, pair, accuracy, shadow):
    """One kernel of ``accumulate``. Returns which pairs are open, and which must be cut (Bool).

    A pair with an open point is left out. So is one along which the optical depth changes too much, or that ends inside
    the beam at a place that is not known well enough. ``shadow(pair, point, s, active) -> (free, open)``.
    """
    segment, sigma_t, illumination = pair.segment, pair.sigma_t, pair.illumination
    chord, ends = chord_of(pair)
    newton = accuracy.newton
    part = part_of(pair, chord, ends, newton)
    width = dr.maximum(part.end - part.start, 0)
    cutting = _cutting(pair, chord, part, width, accuracy.clip)
    cut, scale = cutting.needed, chord.scale * width
    total, contributes, is_open = mi.Spectrum(0), mi.Bool(False), mi.Bool(False)
    resolved = chord.nonlinearity <= dr.opaque(mi.Float, accuracy.linear)
    points = accuracy.guest_points if illumination.inner_objects else accuracy.points
    for tau, weight in zip(*gauss_legendre(points)):
        tau = part.start + tau * (part.end - part.start)
        point, inverse_slope, solved = solve(pair, chord, chord.direction(tau), newton)
        t, s = meeting(point.P, point.omega, segment)
        cut |= cutting.allowed & part.unsure & (dr.abs(t + s - part.path_at(tau)) > cutting.slack)
        active = chord.active & ~cut & (width > 0)
        for limit in limits_at(pair, point, t, s):
            active &= limit > 0
        free, undecided = shadow(pair, point, s, active)
        is_open |= active & undecided
        active &= free
        value = weight * scale * inverse_slope * integrand(pair, point)
        value *= dr.exp(-sigma_t * t - illumination.extinction(sigma_t, point.omega, segment.d) * s)
        if points == 1:  # the mean of the exponential along the part, relative to its middle
            value *= _sinhc(0.5 * cutting.change)
        finite = dr.all(dr.isfinite(value))
        resolved &= ~active | (solved & finite)
        contributes |= active
        total += dr.select(active & finite, value, 0)
    is_open &= ~cut
    sums.add(pair.pairs, total, contributes & ~(is_open | cut), resolved, pair.pairs.share())
    sums.eval(is_open, cut)
    return is_open, cut


def integrand(pair, point):
    """What stands before the attenuation, per area in (u, v): T A2 |omega . Ng| p / d_L^2 (Spectrum or Float).

    For lights that do not send the same into all directions it is multiplied by what they send into this one.
    """
    illumination = pair.illumination
    measure = optics.transmission(point.c_L, point.c_V, illumination.eta) * dr.abs(dr.dot(point.omega, point.area))
    arriving = illumination.emitted(point.P, point.omega_L, point.d_L) / dr.square(point.d_L)
    return measure * illumination.phase(point.omega, pair.segment.d) * arriving


def _sinhc(x):
    """sinh(x) / x to 1e-4 for |x| <= 1."""
    y = dr.square(dr.minimum(x, 1))
    return 1 + y / 6 + dr.square(y) / 120


def solve(pair, chord, D, newton):
    """The root of g on the ray from M along D, starting at the chord (lambda = 1).

    pair    ``PairData``
    chord   its ``Chord``
    D       Vector2f, from M to a point of the chord
    newton  int, Newton steps

    Returns the ``CurvePoint`` there, lambda / |dg/dlambda| (Float), and whether it was found (Bool). Where Newton's
    method leaves the neighbourhood, or t has an extremum on the curve (a fold), the value of the linear beam stands in.
    """
    uv = chord.M + D
    lam = mi.Float(1)
    for _ in range(newton):
        point = _evaluate(pair, uv, D)
        step = point.g / dr.select(point.slope == 0, -chord.g_M, point.slope)
        lam = dr.clip(lam - step, 0, tolerances.OVERSHOOT)
        uv = chord.M + lam * D
    point = _evaluate(pair, uv, D)
    steepness = -point.slope * dr.sign(chord.g_M)
    linear = dr.maximum(dr.abs(chord.g_M), 1e-30)
    solved = (steepness > tolerances.SLOPE * linear) & (lam < tolerances.OVERSHOOT)
    return point, dr.select(solved, lam / dr.select(solved, steepness, 1), dr.rcp(linear)), solved

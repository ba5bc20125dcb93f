"""The curve estimator: single scattering as an integral along the curve g = 0 in each light beam.

    L = sum over triangles of  integral over {g = 0} of
        I T A2 |omega . Ng| / d_L^2  sigma_s p exp(-sigma_t (t + s)) V(P,L) V(P,V) / |grad g|  dl,
    g(u, v) = (P - o) . (d x omega).

g is zero where the light beam refracted at (u, v) meets the camera line. This is the light-side form of
the single-scattering integral: no distance correction D as in Walter et al. 2009 and Holzschuch
2015, and no singularity at folds of the caustic.

In a beam whose corners have g of different signs let E1 and E2 be the points on its edges where the linear
g vanishes, X = (1 - tau) E1 + tau E2, and M a corner. With g(M + lambda (X - M)) = 0 at lambda:

    integral over {g = 0} of F / |grad g| dl = |M E1 x M E2| * integral over tau of F lambda / |dg/dlambda|

with a constant integrand where g is linear and F constant. (The right side is the integral of F delta(g) in the
coordinates (tau, lambda), whose area element is |M E1 x M E2| lambda.)
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .. import optics, tolerances
from ..culling import beam as light_beam
from ..geometry.interval import gauss_legendre, positive_part
from .chord import chord_of, limits_at, meeting
from .protocol import Estimator


@dataclass
class _Point:
    """The quantities of the integrand at one (u, v), ``area`` of the surface per (u, v), and g with its derivative."""

    u: object
    v: object
    P: object
    area: object
    omega_L: object
    omega: object
    c_L: object
    c_V: object
    d_L: object
    slope: object
    g: object


def _evaluate(tri, illumination, segment, u, v, a, b):
    """The light at (u, v), g there and its derivative ``slope`` in the direction (a, b)."""
    P = tri.position(u, v)
    n, d_n = tri.normal_derivative(u, v, a, b)
    P_u, P_v = tri.tangents(u, v)
    d_P = P_u * a + P_v * b
    omega_L, d_L = illumination.light.seen_from(P)
    d_omega_L = illumination.light.direction_change(omega_L, d_L, d_P)
    omega, c_L, c_V = optics.refract_in(omega_L, n, illumination.eta)
    d_omega = optics.refract_in_derivative(omega_L, n, illumination.eta, c_L, c_V, d_omega_L, d_n)
    across = dr.cross(P - segment.o, segment.d)
    g = dr.dot(omega, across)
    slope = dr.dot(d_omega, across) + dr.dot(omega, dr.cross(d_P, segment.d))
    return _Point(u, v, P, dr.cross(P_u, P_v), omega_L, omega, c_L, c_V, d_L, slope, g)


@dataclass
class _Interval:
    """The part of a chord, start < tau < end, that light and segment reach; whether it begins or ends inside the
    beam, or nearly so (``unsure``); and ``path``: t + s as a linear function of tau, (tau0, value, slope)."""

    start: object
    end: object
    unsure: object
    path: tuple

    def path_at(self, tau):
        tau0, value, slope = self.path
        return value + (tau - tau0) * slope


def _clip(limits, tau0, tau1):
    """The ``_Interval`` of tau0 < tau < tau1 in which all limits are positive, given their values at both ends."""
    start, end = positive_part(limits)
    unsure, width = mi.Bool(False), tau1 - tau0
    for at_0, at_1 in limits:
        nearest = dr.minimum(dr.maximum(at_0, at_1), -dr.minimum(at_0, at_1))
        unsure |= nearest > -tolerances.MARGIN * dr.abs(at_0 - at_1)
    (t_0, t_1), _, (s_0, s_1) = limits[:3]
    path = (tau0, t_0 + s_0, (t_1 + s_1 - t_0 - s_0) / width)
    return _Interval(tau0 + start * width, tau0 + end * width, unsure, path)


class Curve(Estimator):
    """Exact integration over the light's side, to float32 where ``tolerance`` is 0."""

    takes_coarse_meshes = True

    def classify(self, piece, segment):
        """The zeros of g."""
        return light_beam.classify(piece, segment)

    def accumulate(self, sums, pairs, segments, culling, illumination, accuracy):
        """As ``Estimator.accumulate``.

        Where culling has proofs, first the pairs that they show free, without any shadow ray, then the others; otherwise, and for
        parts of curves, which are few, all at once. Returns the pairs that were left out since their curves must be cut first.
        """
        arguments = (sums, segments, culling, illumination, accuracy)

        def proof(illumination, point, _tri, s, taken, _active):
            free, blocked = illumination.known(point.u, point.v, s, taken)
            return free, ~(free | blocked)

        def rays(illumination, point, tri, s, taken, active):
            return illumination.visible(point.P, tri.Ng, point.omega, point.u, point.v, s, taken, active), False

        if illumination.shadowless or not culling.for_one_light or pairs.tau0 is not None:
            return pairs.gather(dr.compress(_accumulate(pairs, *arguments, rays)[1]))
        is_open, cut = _accumulate(pairs, *arguments, proof)
        open_pairs = dr.compress(is_open)
        if dr.width(open_pairs) > 0:
            _accumulate(pairs.gather(open_pairs), *arguments, rays)
        return pairs.gather(dr.compress(cut))


def lit_part(pairs, chord, ends, tri, illumination, segment, newton):
    """The interval of the chord to integrate over: all of it, or that of the pairs, whose ends are solved for."""
    if pairs.tau0 is None:
        return _clip(ends, mi.Float(0), mi.Float(1))
    limits = []
    for tau in (pairs.tau0, pairs.tau1):
        point, _, _ = solve(chord, chord.direction(tau), tri, illumination, segment, newton)
        t, s = meeting(point.P, point.omega, segment)
        limits.append(limits_at(point, t, s, tri, segment, illumination))
    return _clip(list(zip(*limits)), pairs.tau0, pairs.tau1)


def _accumulate(pairs, sums, segments, culling, illumination, accuracy, shadow):
    """One kernel of ``accumulate``. ``shadow(illumination, point, tri, s, taken, active) -> (free, open)``; a pair with
    a point that is open is left out, and so is one along which the optical depth changes too much, or that ends
    inside the beam at a place that is not known well enough. Returns which pairs are open, and which must be cut."""
    segment, illumination = segments.gather(pairs.segment), illumination.at(pairs.segment)
    taken = culling.take(pairs, illumination)
    tri = taken.tri
    chord, ends = chord_of(taken.piece, tri, illumination, segment)
    newton = max(accuracy.newton, 1) if tri.curved else accuracy.newton
    interval = lit_part(pairs, chord, ends, tri, illumination, segment, newton)
    sigma_t = segments.sigma_t_of(pairs.segment)
    width = dr.maximum(interval.end - interval.start, 0)
    slope = dr.abs(interval.path[2])
    change = slope * width * sigma_t
    # Where much is absorbed a part is short by its optical depth, and what is behind OPAQUE does not matter.
    steepest = dr.maximum(dr.max(sigma_t) * slope, 1)
    length = mi.Float(1) if pairs.tau0 is None else pairs.tau1 - pairs.tau0
    nearest = dr.minimum(interval.path_at(interval.start), interval.path_at(interval.end))
    nearest -= tolerances.MARGIN * slope * length
    may_cut = chord.active & (length * steepest > tolerances.SHORTEST)
    may_cut &= dr.min(sigma_t) * nearest < tolerances.OPAQUE
    cut = may_cut & (dr.max(change) > tolerances.DEPTH)
    slack = dr.opaque(mi.Float, accuracy.clip) * slope / steepest
    scale = chord.scale * width
    total, contributes, is_open = mi.Spectrum(0), mi.Bool(False), mi.Bool(False)
    resolved = chord.nonlinearity <= dr.opaque(mi.Float, accuracy.linear)
    points = accuracy.guest_points if illumination.guests else accuracy.points
    for tau, weight in zip(*gauss_legendre(points)):
        tau = interval.start + tau * (interval.end - interval.start)
        point, inverse_slope, solved = solve(chord, chord.direction(tau), tri, illumination, segment, newton)
        t, s = meeting(point.P, point.omega, segment)
        cut |= may_cut & interval.unsure & (dr.abs(t + s - interval.path_at(tau)) > slack)
        active = chord.active & ~cut & (width > 0)
        for limit in limits_at(point, t, s, tri, segment, illumination):
            active &= limit > 0
        free, undecided = shadow(illumination, point, tri, s, taken, active)
        is_open |= active & undecided
        active &= free
        value = weight * scale * inverse_slope * integrand(point, illumination, segment)
        value *= dr.exp(-sigma_t * t - illumination.extinction(sigma_t, point.omega, segment.d) * s)
        if points == 1:  # the mean of the exponential along the interval, relative to its middle
            value *= _sinhc(0.5 * change)
        finite = dr.all(dr.isfinite(value))
        resolved &= ~active | (solved & finite)
        contributes |= active
        total += dr.select(active & finite, value, 0)
    is_open &= ~cut
    sums.add(pairs, total, contributes & ~(is_open | cut), resolved, pairs.share())
    sums.eval(is_open, cut)
    return is_open, cut


def integrand(point, illumination, segment):
    """What stands before the attenuation, per area in (u, v): T A2 |omega . Ng| p / d_L^2, for lights that
    do not send the same into all directions times what they do."""
    measure = optics.transmission(point.c_L, point.c_V, illumination.eta) * dr.abs(dr.dot(point.omega, point.area))
    arriving = illumination.emitted(point.P, point.omega_L, point.d_L) / dr.square(point.d_L)
    return measure * illumination.phase(point.omega, segment.d) * arriving


def _sinhc(x):
    """sinh(x) / x to 1e-4 for |x| <= 1."""
    y = dr.square(dr.minimum(x, 1))
    return 1 + y / 6 + dr.square(y) / 120


def solve(chord, D, tri, illumination, segment, newton):
    """The root of g on the ray from M along D, starting at the chord (lambda = 1).

    Returns the point there, lambda / |dg/dlambda|, and whether it was found. Where Newton's method leaves the
    neighbourhood or the curve turns back (a fold) the value of the linear beam stands in.
    """
    uv = chord.M + D
    lam = mi.Float(1)
    for _ in range(newton):
        point = _evaluate(tri, illumination, segment, uv.x, uv.y, D.x, D.y)
        step = point.g / dr.select(point.slope == 0, -chord.g_M, point.slope)
        lam = dr.clip(lam - step, 0, tolerances.OVERSHOOT)
        uv = chord.M + lam * D
    point = _evaluate(tri, illumination, segment, uv.x, uv.y, D.x, D.y)
    steepness = -point.slope * dr.sign(chord.g_M)
    linear = dr.maximum(dr.abs(chord.g_M), 1e-30)
    solved = (steepness > tolerances.SLOPE * linear) & (lam < tolerances.OVERSHOOT)
    return point, dr.select(solved, lam / dr.select(solved, steepness, 1), dr.rcp(linear)), solved

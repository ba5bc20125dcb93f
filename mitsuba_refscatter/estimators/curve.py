"""The curve estimator: single scattering as an integral along the curve g = 0 in each light beam.

    L = sum over triangles of  integral over {g = 0} of
        I T A2 |omega . Ng| / d_L^2  sigma_s p exp(-sigma_t (t + s)) V(P,L) V(P,V) / |grad g|  dl,
    g(u, v) = (P - o) . (d x omega).

g is zero where the light beam refracted at (u, v) meets the camera line. This is the light-side form of
the single-scattering integral: no distance correction D as in Walter et al. 2009 (eq. 13) and Holzschuch
2015 (eq. 9), and no singularity at folds of the caustic.

In a beam whose corners have g of different signs let A be the corner that is alone with its sign. Every
ray from A crosses the curve once. With E1, E2 the zeros of the linear g on the two edges at A, at the
fractions r1, r2 of these edges, X = (1 - tau) E1 + tau E2, and g(A + lambda (X - A)) = 0 at lambda:

    integral over {g = 0} of F / |grad g| dl = r1 r2 * integral over tau in [0, 1] of F lambda / |dg/dlambda|

with a constant integrand where g is linear and F constant. (Area element of the map (tau, lambda) ->
(u, v): r1 r2 lambda.)
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .. import optics, tolerances
from ..culling import beam as light_beam
from ..geometry import triangle


@dataclass
class Lighting:
    """What the estimator knows of light and body besides the beams.

    ``L``: position of the light; ``eta``; ``total_reflection``: whether eta < 1; ``g``: asymmetry of
    Henyey-Greenstein or None for isotropic; ``lit(P, Ng, active)``, ``inside(P, Ng, direction, length, active)``: visibility tests or None
    where nothing can be in the way.
    """

    L: object
    eta: object
    total_reflection: bool
    g: object
    lit: object
    inside: object


@dataclass
class _Point:
    """The quantities of the integrand at one (u, v), and g with its derivative."""

    P: object
    n: object
    omega: object
    c_L: object
    c_V: object
    d_L: object
    slope: object
    g: object


def _evaluate(tri, lighting, segment, u, v, a, b):
    """The light at (u, v), g there and its derivative ``slope`` in the direction (a, b)."""
    P = tri.position(u, v)
    n, d_n = tri.normal_derivative(u, v, a, b)
    d_P = tri.P_u * a + tri.P_v * b
    to_light = lighting.L - P
    d_L = dr.norm(to_light)
    omega_L = to_light / d_L
    d_omega_L = (omega_L * dr.dot(omega_L, d_P) - d_P) / d_L
    omega, c_L, c_V = optics.refract_in(omega_L, n, lighting.eta)
    d_omega = optics.refract_in_derivative(omega_L, n, lighting.eta, c_L, c_V, d_omega_L, d_n)
    across = dr.cross(P - segment.o, segment.d)
    g = dr.dot(omega, across)
    slope = dr.dot(d_omega, across) + dr.dot(omega, dr.cross(d_P, segment.d))
    return _Point(P, n, omega, c_L, c_V, d_L, slope, g)


def _meeting(P, omega, segment):
    """Distances ``(t, s)`` along camera and light ray to where the two lines are closest."""
    normal = dr.cross(segment.d, omega)
    sine2 = dr.maximum(dr.squared_norm(normal), tolerances.PARALLEL)
    offset = P - segment.o
    t = dr.dot(dr.cross(offset, omega), normal) / sine2
    s = dr.dot(dr.cross(offset, segment.d), normal) / sine2
    return t, s


@dataclass
class _Chord:
    """The zero line of the linear g in a beam: lone corner, the two edge points, its valid part (start <
    tau < end), the path t + s at both edge points, and
    whether it begins or ends in the beam or nearly so."""

    A: object
    to_E1: object
    to_E2: object
    scale: object
    g_A: object
    start: object
    end: object
    path_1: object
    path_2: object
    active: object
    unsure: object


def _piece(x, pairs, tri, lighting):
    """Corners and place ``(P, omega, u0, v0, h)`` of the beams, or of the parts of them that are meant."""
    u0, v0, h = x[20:23]
    if pairs.code is None:
        return *light_beam.corners(x), u0, v0, h
    u, v, size = light_beam.sub_triangle(pairs.code, pairs.level)
    u0, v0, h = u0 + h * u, v0 + h * v, h * size
    corners = [light_beam.refracted(tri, u0 + h * u, v0 + h * v, lighting.L, lighting.eta) for u, v in light_beam.CORNERS]
    return *zip(*corners), u0, v0, h


def _chord(P, omega, u0, v0, h, tri, lighting, segment):
    """Finds the chord and clips it to where light and segment are: t, s, c_L and the facet's sides."""
    g = [dr.dot(w, dr.cross(p - segment.o, segment.d)) for p, w in zip(P, omega)]
    up = [value >= 0 for value in g]
    lone_1, lone_2 = (up[0] == up[2]) & (up[1] != up[0]), (up[0] == up[1]) & (up[2] != up[0])
    active = lone_1 | lone_2 | ((up[1] == up[2]) & (up[0] != up[1]))

    def turn(values):
        """The corners' values with the lone corner first, orientation kept."""
        a, b, c = values
        return (dr.select(lone_1, b, dr.select(lone_2, c, a)), dr.select(lone_1, c, dr.select(lone_2, a, b)),
                dr.select(lone_1, a, dr.select(lone_2, b, c)))  # fmt: skip

    g_A, g_B, g_C = turn(g)
    r1 = g_A / dr.select(active, g_A - g_B, 1)
    r2 = g_A / dr.select(active, g_A - g_C, 1)
    uv = turn([mi.Vector2f(u0 + h * u, v0 + h * v) for u, v in light_beam.CORNERS])
    start, end = mi.Float(0), mi.Float(1)

    def at_ends(values):
        at_A, at_B, at_C = turn(values)
        return at_A + r1 * (at_B - at_A), at_A + r2 * (at_C - at_A)

    limits = _limits(P, omega, u0, v0, h, tri, lighting, segment)
    unsure = mi.Bool(False)
    for values in limits:
        at_1, at_2 = at_ends(values)
        nearest = dr.minimum(dr.maximum(at_1, at_2), -dr.minimum(at_1, at_2))
        unsure |= nearest > -tolerances.MARGIN * dr.abs(at_1 - at_2)
        zero = at_1 / dr.select(at_1 == at_2, 1, at_1 - at_2)
        start = dr.select(at_1 < 0, dr.select(at_2 < 0, 2, dr.maximum(start, zero)), start)
        end = dr.select((at_2 < 0) & (at_1 >= 0), dr.minimum(end, zero), end)
    unsure &= active
    active &= start < end
    scale = r1 * r2 * dr.square(h) * (end - start)
    path_1, path_2 = at_ends([t + s for t, s in zip(limits[0], limits[2])])
    return _Chord(uv[0], r1 * (uv[1] - uv[0]), r2 * (uv[2] - uv[0]), scale, g_A, start, end, path_1, path_2, active, unsure)


def _limits(P, omega, u0, v0, h, tri, lighting, segment):
    """Corner values of the functions that must be positive where light reaches the segment."""
    t, s, facing, leaving = [], [], [], []
    for p, w, (u, v) in zip(P, omega, light_beam.CORNERS):
        t_i, s_i = _meeting(p, w, segment)
        t.append(t_i)
        s.append(s_i)
        facing.append(dr.dot(tri.n0 + tri.n_u * (u0 + h * u) + tri.n_v * (v0 + h * v), lighting.L - p))
        leaving.append(-dr.dot(w, tri.Ng))
    limits = [t, [segment.t_max - t_i for t_i in t], s, facing, leaving]
    if lighting.total_reflection:
        limits.append([_inside_cosine2(tri, lighting, u0 + h * u, v0 + h * v) for u, v in light_beam.CORNERS])
    return limits


def _inside_cosine2(tri, lighting, u, v):
    """Square of the refracted ray's cosine; negative where light is totally reflected."""
    c_L = dr.dot(dr.normalize(lighting.L - tri.position(u, v)), tri.normal(u, v))
    return 1 - (1 - dr.square(c_L)) / dr.square(lighting.eta)


def zeros(pairs, segments, beams, tri, lighting):
    """``beam.Zeros`` of parts of beams (``pairs`` with codes): bend and twist fall by 4 with every level."""
    x = triangle.gather_numbers(beams.records, pairs.beam, light_beam.BEAM)
    P, omega, _, _, _ = _piece(x, pairs, tri, lighting)
    smaller = dr.rcp(mi.Float(1 << (2 * pairs.level)))
    return light_beam.classify(P, omega, x[18] * smaller, x[19] * smaller, segments.gather(pairs.segment))


@dataclass
class Sums:
    """Per segment: the radiance ``value`` (without the segment's weight, sigma_s and the light's intensity),
    and the numbers of pairs that contributed and that were not resolved (None where not asked for)."""

    value: object
    contributions: object = None
    unresolved: object = None


def accumulate(sums, pairs, segments, beams, records, lighting, accuracy):
    """Adds what the beams bring to the segments of ``pairs`` (``beams.Pairs``) to ``sums``.

    First the pairs whose light path is proven to be free, without any shadow ray; then the others. Returns the
    pairs that were left out since their beams must be cut first.
    """
    arguments = (sums, segments, beams, records, lighting, accuracy)

    def proof(point, s, tri, clear, proven_lit, active):
        free = (s < clear if lighting.inside is not None else True) & proven_lit
        return free, ~free

    def rays(point, s, tri, clear, proven_lit, active):
        if lighting.inside is not None:
            free = s < clear
            active = active & (free | lighting.inside(point.P, tri.Ng, point.omega, s, active & ~free))
        if lighting.lit is not None:
            active = active & (proven_lit | lighting.lit(point.P, tri.Ng, active & ~proven_lit))
        return active, False

    if lighting.lit is None and lighting.inside is None:
        return pairs.gather(dr.compress(_accumulate(pairs, *arguments, lambda *_: (True, False))[1]))
    is_open, cut = _accumulate(pairs, *arguments, proof)
    open_pairs = dr.compress(is_open)
    if dr.width(open_pairs) > 0:
        _accumulate(pairs.gather(open_pairs), *arguments, rays)
    return pairs.gather(dr.compress(cut))


def _accumulate(pairs, sums, segments, beams, records, lighting, accuracy, shadow):
    """One kernel of ``accumulate``. ``shadow(point, s, tri, clear, proven_lit, active) -> (free, open)``; a pair with
    a point that is open is left out, and so is one along which the optical depth changes too much, or that ends
    inside the beam at a place that is not known well enough. Returns which pairs are open, and which must be cut."""
    index = pairs.segment
    segment = segments.gather(index)
    x = triangle.gather_numbers(beams.records, pairs.beam, light_beam.BEAM)
    tri = triangle.gather(records, dr.gather(mi.UInt32, beams.triangles, pairs.beam))
    proven_lit = dr.gather(mi.Bool, beams.proven_lit, pairs.beam)
    chord = _chord(*_piece(x, pairs, tri, lighting), tri, lighting, segment)
    A2 = dr.norm(dr.cross(tri.P_u, tri.P_v))
    sigma_t = segments.sigma_t_of(index)
    path = dr.abs(chord.path_2 - chord.path_1)
    change = sigma_t * path * (chord.end - chord.start)
    may_cut = True if pairs.level is None else pairs.level < tolerances.MAX_SUBDIVISION
    cut = chord.active & (dr.max(change) > tolerances.DEPTH) & may_cut
    total, resolved, contributes, is_open = mi.Spectrum(0), mi.Bool(True), mi.Bool(False), mi.Bool(False)
    for tau, weight in zip(*tolerances.gauss(accuracy.points)):
        tau = chord.start + tau * (chord.end - chord.start)
        D = chord.to_E1 + tau * (chord.to_E2 - chord.to_E1)
        point, inverse_slope, solved = _solve(chord, D, tri, lighting, segment, accuracy.newton)
        t, s = _meeting(point.P, point.omega, segment)
        curved = dr.abs(t + s - dr.lerp(chord.path_1, chord.path_2, tau)) > dr.opaque(mi.Float, accuracy.clip) * path
        cut |= chord.unsure & curved & may_cut
        active = chord.active & ~cut & _valid(point, t, s, tri, segment, lighting)
        free, undecided = shadow(point, s, tri, x[23], proven_lit, active)
        is_open |= active & undecided
        active &= free
        measure = optics.transmission(point.c_L, point.c_V, lighting.eta) * dr.abs(dr.dot(point.omega, tri.Ng))
        value = weight * chord.scale * A2 * measure * inverse_slope / dr.square(point.d_L)
        value *= _phase(lighting, -dr.dot(point.omega, segment.d))
        finite = dr.isfinite(value)
        resolved &= ~active | (solved & finite)
        contributes |= active
        attenuation = dr.exp(-sigma_t * (t + s))
        if accuracy.points == 1:  # the mean of the exponential along the chord, relative to its middle
            attenuation *= _sinhc(0.5 * change)
        total += dr.select(active & finite, value * attenuation, 0)
    is_open &= ~cut
    contributes &= ~(is_open | cut)
    dr.scatter_add(sums.value, total, index, contributes)
    if sums.contributions is not None:
        dr.scatter_add(sums.contributions, mi.Float(1), index, contributes)
        dr.scatter_add(sums.unresolved, mi.Float(1), index, contributes & ~resolved)
    dr.eval(is_open, cut, sums.value, sums.contributions, sums.unresolved)
    return is_open, cut


def _sinhc(x):
    """sinh(x) / x to 1e-4 for |x| <= 1."""
    y = dr.square(dr.minimum(x, 1))
    return 1 + y / 6 + dr.square(y) / 120


def _solve(chord, D, tri, lighting, segment, newton):
    """The root of g on the ray from A along D, starting at the chord (lambda = 1).

    Returns the point there, lambda / |dg/dlambda|, and whether it was found. Where Newton's method leaves the
    neighbourhood or the curve turns back (a fold) the value of the linear beam stands in.
    """
    uv = chord.A + D
    lam = mi.Float(1)
    for _ in range(newton):
        point = _evaluate(tri, lighting, segment, uv.x, uv.y, D.x, D.y)
        step = point.g / dr.select(point.slope == 0, -chord.g_A, point.slope)
        lam = dr.clip(lam - step, 0, tolerances.OVERSHOOT)
        uv = chord.A + lam * D
    point = _evaluate(tri, lighting, segment, uv.x, uv.y, D.x, D.y)
    steepness = -point.slope * dr.sign(chord.g_A)
    linear = dr.maximum(dr.abs(chord.g_A), 1e-30)
    solved = (steepness > tolerances.SLOPE * linear) & (lam < tolerances.OVERSHOOT)
    return point, dr.select(solved, lam / dr.select(solved, steepness, 1), dr.rcp(linear)), solved


def _valid(point, t, s, tri, segment, lighting):
    """Where light refracts in at P and meets the segment. Within half a unit of rounding of the chord's clip."""
    active = (point.c_L > 0) & (dr.dot(point.omega, tri.Ng) < 0) & (s > 0) & (t > 0) & (t < segment.t_max)
    return active & (point.c_V > 0) if lighting.total_reflection else active


def _phase(lighting, cosine):
    return optics.isotropic() if lighting.g is None else optics.henyey_greenstein(cosine, lighting.g)

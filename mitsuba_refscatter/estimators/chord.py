"""The chord of a light beam: between the zeros of g on its edges, and what limits the light along it."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .. import optics, tolerances
from ..culling import beam


def meeting(P, omega, segment):
    """Distances ``(t, s)`` along camera and light ray to where the two lines are closest.

    P        Point3f, where the light ray starts
    omega    Vector3f, its unit direction
    segment  ``LocalSegments``
    """
    normal = dr.cross(segment.d, omega)
    sine2 = dr.maximum(dr.squared_norm(normal), tolerances.PARALLEL)
    offset = P - segment.o
    t = dr.dot(dr.cross(offset, omega), normal) / sine2
    s = dr.dot(dr.cross(offset, segment.d), normal) / sine2
    return t, s


def may_meet(piece, segment):
    """False (Bool) only where all light lines of beams meet the camera line elsewhere than on the segment.

    The lines of the corners do, by twice as much as lines between them could meet it nearer, and none is nearly
    parallel to it. Light lines through a point V meet any segment of no length there.
    """
    t, s = zip(*(meeting(P, omega, segment) for P, omega in zip(piece.P, piece.omega)))
    edge, turn = (
        beam.fold(dr.maximum, [dr.norm(x[i] - x[j]) for i, j in ((0, 1), (1, 2), (2, 0))])
        for x in (piece.P, piece.omega)
    )
    sine = beam.fold(dr.minimum, [dr.norm(dr.cross(omega, segment.d)) for omega in piece.omega])
    margin = 2 * (edge + beam.fold(dr.maximum, [dr.abs(x) for x in s]) * turn) / dr.maximum(sine, 1e-30)
    before, behind = beam.fold(dr.maximum, t), beam.fold(dr.minimum, t) - segment.t_max
    beside = (-before > margin) | (behind > margin) | (-beam.fold(dr.maximum, s) > margin)
    return (sine <= 2 * turn) | ~beside


@dataclass
class Chord:
    """The line between the zeros of g on a beam's edges, lane by lane; points are (u, v) of the triangle.

    M             Vector2f, the corner from which rays look for the curve
    to_E1         Vector2f, from M to one end of the chord
    to_E2         Vector2f, from M to its other end
    scale         Float, twice the area of M E1 E2
    g_M           Float, g at M
    active        Bool, whether g changes its sign at all
    nonlinearity  Float, of ``beam.Zeros``
    """

    M: mi.Vector2f
    to_E1: mi.Vector2f
    to_E2: mi.Vector2f
    scale: mi.Float
    g_M: mi.Float
    active: mi.Bool
    nonlinearity: mi.Float

    def direction(self, tau):
        """From M to the chord's point at ``tau``, 0 to 1."""
        return self.to_E1 + tau * (self.to_E2 - self.to_E1)


def chord_of(pair):
    """``(Chord, limits)`` of ``PairData``: the limits (``limits_at``) are pairs of values at the chord's ends.

    The chord ends where a quadratic through the corners and the middle of an edge vanishes. There the curves of
    neighbouring triangles meet, or of parts of them, whatever their size. The rays start from the lone corner A. Only
    where the curve runs along an edge at A do they start from the corner opposite to that edge.
    """
    piece = pair.piece
    zeros = beam.classify(piece, pair.segment)
    g = zeros.g
    up = [value >= 0 for value in g]
    lone_1, lone_2 = (up[0] == up[2]) & (up[1] != up[0]), (up[0] == up[1]) & (up[2] != up[0])
    active = lone_1 | lone_2 | ((up[1] == up[2]) & (up[0] != up[1]))

    def lone_first(values):
        """The corners' values in cyclic order from the lone corner on."""
        a, b, c = values
        return (dr.select(lone_1, b, dr.select(lone_2, c, a)), dr.select(lone_1, c, dr.select(lone_2, a, b)),
                dr.select(lone_1, a, dr.select(lone_2, b, c)))  # fmt: skip

    g_A, g_B, g_C = lone_first(g)
    A, B, C = lone_first(piece.uv())
    r1, flat_B = _root(pair, A, B, g_A, g_B)
    r2, flat_C = _root(pair, A, C, g_A, g_C)
    size_A, size_B, size_C = dr.abs(g_A), dr.abs(g_B), dr.abs(g_C)
    from_B = flat_C & (size_B >= dr.maximum(size_A, size_C))
    from_C = flat_B & (size_C > dr.maximum(size_A, size_B))
    M = dr.select(from_B, B, dr.select(from_C, C, A))
    to_E1, to_E2 = A + r1 * (B - A) - M, A + r2 * (C - A) - M
    scale = dr.abs(to_E1.x * to_E2.y - to_E1.y * to_E2.x)
    g_M = dr.select(from_B, g_B, dr.select(from_C, g_C, g_A))
    chord = Chord(M, to_E1, to_E2, scale, g_M, active, zeros.nonlinearity)
    ends = []
    for values in _corner_limits(pair):
        at_A, at_B, at_C = lone_first(values)
        ends.append((at_A + r1 * (at_B - at_A), at_A + r2 * (at_C - at_A)))
    return chord, ends


def _root(pair, a, b, g_a, g_b):
    """Where g vanishes on edges from a to b (uv), as a share of them, and whether the curve may run along the edge.

    g has different signs at the ends and is quadratic in between. Where that is far from linear the curve may run along
    it.
    """
    middle, segment = 0.5 * (a + b), pair.segment
    P, omega, _ = beam.refracted(pair.tri, middle.x, middle.y, pair.illumination)
    g = dr.dot(omega, dr.cross(P - segment.o, segment.d))
    q, p = 2 * (g_a + g_b - 2 * g), 4 * g - 3 * g_a - g_b
    slope = dr.copysign(dr.safe_sqrt(dr.square(p) - 4 * q * g_a), g_b - g_a)
    steep = p * slope > 0
    x = dr.select(steep, -2 * g_a, slope - p) / dr.select(steep, p + slope, 2 * q)
    x = dr.clip(dr.select(dr.isfinite(x), x, 0.5), 0, 1)
    return x, dr.abs(g_a - g_b) < tolerances.FLAT * dr.abs(0.25 * q)


def limits_at(pair, point, t, s):
    """What must be positive for light to get to the segment, a list of Float.

    These are t, t_max - t, s, the cosine to the light, and the cosine to the facet inside. Where light may be totally
    reflected the square of the refracted ray's cosine follows.

    pair   ``PairData``
    point  ``curve.CurvePoint``
    t, s   Float, distances from there as ``meeting`` gives them
    """
    limits = [t, pair.segment.t_max - t, s, point.c_L, -dr.dot(point.omega, pair.tri.Ng)]
    if pair.illumination.total_reflection:
        limits.append(optics.inside_cosine2(point.c_L, pair.illumination.eta))
    return limits


def _corner_limits(pair):
    """``limits_at`` at the corners of a piece, three values each; the cosine to the light times positive lengths."""
    piece, tri, illumination, segment = pair.piece, pair.tri, pair.illumination, pair.segment
    t, s, facing, leaving = [], [], [], []
    for P, omega, uv in zip(piece.P, piece.omega, piece.uv()):
        t_i, s_i = meeting(P, omega, segment)
        t.append(t_i)
        s.append(s_i)
        facing.append(dr.dot(tri.normal_before(uv.x, uv.y), illumination.light.to(P)))
        leaving.append(-dr.dot(omega, tri.Ng))
    limits = [t, [segment.t_max - t_i for t_i in t], s, facing, leaving]
    if illumination.total_reflection:
        # Square of the refracted ray's cosine; negative where light is totally reflected.
        limits.append([beam.refracted(tri, uv.x, uv.y, illumination)[2] for uv in piece.uv()])
    return limits

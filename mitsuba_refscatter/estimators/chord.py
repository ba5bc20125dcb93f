"""The chord of a light beam: where the linear g vanishes, and what limits the light along it."""

from dataclasses import dataclass

import drjit as dr

from .. import optics, tolerances
from ..culling import beam


def meeting(P, omega, segment):
    """Distances ``(t, s)`` along camera and light ray to where the two lines are closest."""
    normal = dr.cross(segment.d, omega)
    sine2 = dr.maximum(dr.squared_norm(normal), tolerances.PARALLEL)
    offset = P - segment.o
    t = dr.dot(dr.cross(offset, omega), normal) / sine2
    s = dr.dot(dr.cross(offset, segment.d), normal) / sine2
    return t, s


@dataclass
class Chord:
    """The zero line of the linear g in a beam: the corner M of the rays that look for the curve, the edge points
    E1 and E2 from there, twice the area of M E1 E2, g at the corner, and whether g changes its sign at all (``active``)."""

    M: object
    to_E1: object
    to_E2: object
    scale: object
    g_M: object
    active: object

    def direction(self, tau):
        return self.to_E1 + tau * (self.to_E2 - self.to_E1)


def chord_of(piece, tri, lighting, segment):
    """The chord of beams, and the limits (``limits_at``) at its two ends, interpolated from the corners.

    The rays start from the lone corner A: then the curves of neighbouring triangles meet on their common edge. Only
    where g changes less along an edge at A than it can deviate from linear, as where the curve runs along that
    edge, do they start from the corner where |g| is largest.
    """
    zeros = beam.classify(piece, segment)
    g = zeros.g
    up = [value >= 0 for value in g]
    lone_1, lone_2 = (up[0] == up[2]) & (up[1] != up[0]), (up[0] == up[1]) & (up[2] != up[0])
    active = lone_1 | lone_2 | ((up[1] == up[2]) & (up[0] != up[1]))

    def turn(values):
        """The corners' values with the lone corner first, orientation kept."""
        a, b, c = values
        return (dr.select(lone_1, b, dr.select(lone_2, c, a)), dr.select(lone_1, c, dr.select(lone_2, a, b)),
                dr.select(lone_1, a, dr.select(lone_2, b, c)))  # fmt: skip

    g_A, g_B, g_C = turn(g)
    A, B, C = turn(piece.uv())
    r1 = g_A / dr.select(active, g_A - g_B, 1)
    r2 = g_A / dr.select(active, g_A - g_C, 1)
    flat = dr.minimum(dr.abs(g_A - g_B), dr.abs(g_A - g_C)) < zeros.bound
    from_B, from_C = flat & (dr.abs(g_B) >= dr.abs(g_C)), flat & (dr.abs(g_B) < dr.abs(g_C))
    M = dr.select(from_B, B, dr.select(from_C, C, A))
    to_E1, to_E2 = A + r1 * (B - A) - M, A + r2 * (C - A) - M
    scale = dr.abs(to_E1.x * to_E2.y - to_E1.y * to_E2.x)
    chord = Chord(M, to_E1, to_E2, scale, dr.select(from_B, g_B, dr.select(from_C, g_C, g_A)), active)
    ends = []
    for values in _corner_limits(piece, tri, lighting, segment):
        at_A, at_B, at_C = turn(values)
        ends.append((at_A + r1 * (at_B - at_A), at_A + r2 * (at_C - at_A)))
    return chord, ends


def limits_at(point, t, s, tri, segment, lighting):
    """What must be positive for light to reach the segment: t, t_max - t, s, the cosine to the light, the cosine to
    the facet inside, and where light may be totally reflected the square of the refracted ray's cosine."""
    limits = [t, segment.t_max - t, s, point.c_L, -dr.dot(point.omega, tri.Ng)]
    if lighting.total_reflection:
        limits.append(optics.inside_cosine2(point.c_L, lighting.eta))
    return limits


def _corner_limits(piece, tri, lighting, segment):
    """``limits_at`` at the corners of a piece, three values each; the cosine to the light times positive lengths."""
    t, s, facing, leaving = [], [], [], []
    for P, omega, uv in zip(piece.P, piece.omega, piece.uv()):
        t_i, s_i = meeting(P, omega, segment)
        t.append(t_i)
        s.append(s_i)
        facing.append(dr.dot(tri.normal_before(uv.x, uv.y), lighting.light.to(P)))
        leaving.append(-dr.dot(omega, tri.Ng))
    limits = [t, [segment.t_max - t_i for t_i in t], s, facing, leaving]
    if lighting.total_reflection:
        limits.append([_inside_cosine2(tri, lighting, uv) for uv in piece.uv()])
    return limits


def _inside_cosine2(tri, lighting, uv):
    """Square of the refracted ray's cosine; negative where light is totally reflected."""
    return beam.refracted(tri, uv.x, uv.y, lighting.light)[2]

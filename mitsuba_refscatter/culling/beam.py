"""One light beam: a triangle, or a part of one, with the light that it refracts.

P are points of a triangle of a body, and omega are the refracted directions there. g is the function of (u, v) whose
zeros are the points that send light onto a camera line (o, d):

    g = (P - o) . (d x omega).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .. import optics, tolerances

BEAM = 28
"""Numbers per beam: P and omega at 3 corners (18), bend, twist, u0, v0, h, and how far it gets (``pairs.Reach``, 5)."""

CORNERS = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
MIDDLES = ((0.5, 0.5), (0.0, 0.5), (0.5, 0.0))
"""Middle of the edge opposite to each corner."""


def sub_triangle(code, level):
    """Corner and signed size (u0, v0, h) of sub-triangle ``code`` of the 4^level similar ones.

    code   UInt32, a base-4 digit per level: 0, 1, 2 keep a corner of the parent, 3 is the inverted middle part (h < 0)
    level  UInt32, 0 to ``tolerances.MOST_LEVELS``

    The corners are (u0, v0), (u0 + h, v0), (u0, v0 + h).
    """
    u, v, h = mi.Float(0), mi.Float(0), mi.Float(1)
    for k in range(tolerances.MOST_LEVELS):
        digit = (code >> (2 * k)) & 3
        active = level > k
        half = 0.5 * h
        middle = digit == 3
        u = dr.select(active & ((digit == 1) | middle), u + half, u)
        v = dr.select(active & ((digit == 2) | middle), v + half, v)
        h = dr.select(active, dr.select(middle, -half, half), h)
    return u, v, h


def refracted(tri, u, v, incidence):
    """Position and refracted direction at points of triangles, and the square of the direction's cosine.

    tri        ``triangle.Triangle``
    u, v       Float, place in the triangle
    incidence  ``optics.Incidence`` of the light

    The direction is continued where the light does not come from outside. The square is negative under total
    reflection.
    """
    P = tri.position(u, v)
    omega, c_L, _ = optics.refract_in(incidence.light.seen_from(P)[0], tri.normal(u, v), incidence.eta)
    return P, omega, optics.inside_cosine2(c_L, incidence.eta)


@dataclass
class Piece:
    """A light beam or a part of one, and how its light bends; body coordinates, lane by lane.

    P       three Vector3f, positions of the corners
    omega   three Vector3f, unit refracted directions there
    bend    Float, bound of how far omega is from linear in between
    twist   Float, the same for what is bilinear in P and omega, as a length; -1 where there is no beam
    u0, v0  Float, corner of the part in the (u, v) of its triangle
    h       Float, signed size of the part in (u, v)
    """

    P: list[mi.Vector3f]
    omega: list[mi.Vector3f]
    bend: mi.Float
    twist: mi.Float
    u0: mi.Float
    v0: mi.Float
    h: mi.Float

    def uv(self):
        """(u, v) of the corners."""
        return [mi.Vector2f(self.u0 + self.h * u, self.v0 + self.h * v) for u, v in CORNERS]


def piece_at(tri, incidence, u0, v0, h):
    """``Piece``: the light beams that light makes of parts of triangles.

    tri        ``triangle.Triangle``
    incidence  ``optics.Incidence`` of the light
    u0, v0, h  Float, corner and signed size of the parts in (u, v)

    ``bend`` bounds how far omega is from linear, in any direction. A quadratic deviates by at most 4/3 of what it does
    at the edges' middles; 2 leaves room for the cubic part. Where the critical angle may be passed, omega has a square
    root in it: all of c_V may be missed. ``twist`` bounds the same for what is bilinear in position and direction, as g
    is, by 4/3 of |edge| |change| / 4.
    """
    P, omega, c_V2 = zip(*(refracted(tri, dr.fma(h, u, u0), dr.fma(h, v, v0), incidence) for u, v in CORNERS))
    bend, twist, curved = mi.Float(0), mi.Float(0), mi.Float(0)
    for i, (u, v) in enumerate(MIDDLES):
        j, k = (i + 1) % 3, (i + 2) % 3
        _, middle, inside = refracted(tri, dr.fma(h, u, u0), dr.fma(h, v, v0), incidence)
        bend = dr.maximum(bend, 2 * dr.norm(middle - 0.5 * (omega[j] + omega[k])))
        twist = dr.maximum(twist, dr.norm(P[j] - P[k]) * dr.norm(omega[j] - omega[k]) / 3)
        curved = dr.maximum(curved, 2 * dr.abs(inside - 0.5 * (c_V2[j] + c_V2[k])))
    low, high = fold(dr.minimum, c_V2), fold(dr.maximum, c_V2)
    bend = dr.select(low < curved, dr.maximum(bend, dr.safe_sqrt(high + curved)), bend)
    return Piece(list(P), list(omega), bend, twist, u0, v0, h)


def nothing(piece, empty):
    """``piece`` with those that are ``empty`` (Bool) such that g has no zeros for any line."""
    piece.omega = [dr.select(empty, mi.Vector3f(0), x) for x in piece.omega]
    piece.bend, piece.twist = dr.select(empty, 0, piece.bend), dr.select(empty, -1, piece.twist)
    return piece


def excess(piece, light):
    """How many times (Float) the size of beams, or the turn of their directions, is what ``NEAR`` and ``TURN`` allow.

    piece  ``Piece``
    light  ``optics.LocalLight``
    """
    distance = None if light.distant else fold(dr.minimum, [dr.norm(light.L - p) for p in piece.P])
    out = mi.Float(0)
    for j, k in ((0, 1), (1, 2), (2, 0)):
        edge, turn = dr.norm(piece.P[j] - piece.P[k]), dr.norm(piece.omega[j] - piece.omega[k])
        out = dr.maximum(out, turn / tolerances.TURN)
        if distance is not None:
            out = dr.maximum(out, edge / (tolerances.NEAR * dr.maximum(distance, 1e-30)))
    return out


def numbers(piece, reach):
    """The record of a beam, a list of ``BEAM`` Float; ``reach``: the last 5 of them (``pairs.Reach``)."""
    out = []
    for p, w in zip(piece.P, piece.omega):
        out += [p.x, p.y, p.z, w.x, w.y, w.z]
    return out + [piece.bend, piece.twist, piece.u0, piece.v0, piece.h, *reach]


def unpack(numbers):
    """``Piece`` of a gathered record, a list of ``BEAM`` Float."""
    P = [mi.Vector3f(numbers[6 * i : 6 * i + 3]) for i in range(3)]
    omega = [mi.Vector3f(numbers[6 * i + 3 : 6 * i + 6]) for i in range(3)]
    return Piece(P, omega, *numbers[18:23])


@dataclass
class Zeros:
    """Where g vanishes on beams, lane by lane.

    possible      Bool, False only if it surely does not
    bracketed     Bool, whether the corners have different signs
    g             list of Float, its values at the corners
    nonlinearity  Float, how far g can deviate from linear in between, relative to its range
    """

    possible: mi.Bool
    bracketed: mi.Bool
    g: list[mi.Float]
    nonlinearity: mi.Float


def classify(piece, segment):
    """``Zeros`` of g on beams (``Piece``) for camera segments (``LocalSegments``)."""
    g, farthest = [], mi.Float(0)
    for p, w in zip(piece.P, piece.omega):
        across = dr.cross(p - segment.o, segment.d)
        g.append(dr.dot(w, across))
        farthest = dr.maximum(farthest, dr.norm(across))
    bound = piece.bend * farthest + piece.twist
    low, high = fold(dr.minimum, g), fold(dr.maximum, g)
    # A pair of which only an edge is touched, g = 0 at a corner, is bracketed on one side of it only.
    possible, bracketed = (low <= bound) & (high >= -bound), (low < 0) & (high >= 0)
    return Zeros(possible, bracketed, g, bound / dr.maximum(high - low, 1e-30))


def fold(f, items):
    """``f`` of all items: fold(dr.minimum, [a, b, c]) is the smallest."""
    return functools.reduce(f, items)

"""One light beam: a triangle, or a part of one, with the light that it refracts.

A triangle of a body with corner positions P and refracted directions omega; g is the function of
(u, v) whose zeros are the points that send light onto a camera line (o, d):

    g = (P - o) . (d x omega).
"""

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

    Its corners are (u0, v0), (u0 + h, v0), (u0, v0 + h). Per base-4 digit: 0, 1, 2 keep a corner of the
    parent, 3 is the middle one, turned by half a turn (h < 0).
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
    """Position and refracted direction at (u, v) of triangles (continued where unlit), and the square of its cosine, negative
    under total reflection. ``incidence``: ``optics.Incidence``."""
    P = tri.position(u, v)
    omega, c_L, _ = optics.refract_in(incidence.light.seen_from(P)[0], tri.normal(u, v), incidence.eta)
    return P, omega, optics.inside_cosine2(c_L, incidence.eta)


@dataclass
class Piece:
    """A light beam or a part of one, and how its light bends.

    Corner positions ``P`` and refracted directions ``omega`` (lists of three Vector3f); ``bend``: bound of how far
    omega is from linear in between; ``twist``: the same for what is bilinear in P and omega; ``u0``, ``v0``, ``h``:
    the corner and signed size of its triangle in (u, v).
    """

    P: list
    omega: list
    bend: object
    twist: object
    u0: object
    v0: object
    h: object

    def uv(self):
        """(u, v) of the corners."""
        return [mi.Vector2f(self.u0 + self.h * u, self.v0 + self.h * v) for u, v in CORNERS]


def piece_at(tri, incidence, u0, v0, h):
    """``Piece``: the light beams that an ``optics.Incidence`` makes of parts of triangles.

    ``bend`` bounds how far omega is from linear, in any direction: a quadratic deviates by at most 4/3 of what it
    does at the edges' middles; 2 leaves room for the cubic part. Where the critical angle may be passed, omega has
    a square root in it: all of c_V may be missed. ``twist`` bounds the same for what is bilinear in position and
    direction, as g is: 4/3 of |edge| |change| / 4; and how far a curved one is from its plane triangle.
    """
    P, omega, c_V2 = zip(*(refracted(tri, dr.fma(h, u, u0), dr.fma(h, v, v0), incidence) for u, v in CORNERS))
    bend, twist, curved, sag = mi.Float(0), mi.Float(0), mi.Float(0), mi.Float(0)
    for i, (u, v) in enumerate(MIDDLES):
        j, k = (i + 1) % 3, (i + 2) % 3
        at, middle, inside = refracted(tri, dr.fma(h, u, u0), dr.fma(h, v, v0), incidence)
        if tri.curved:
            sag = dr.maximum(sag, 4 / 3 * dr.norm(at - 0.5 * (P[j] + P[k])))
        bend = dr.maximum(bend, 2 * dr.norm(middle - 0.5 * (omega[j] + omega[k])))
        twist = dr.maximum(twist, dr.norm(P[j] - P[k]) * dr.norm(omega[j] - omega[k]) / 3)
        curved = dr.maximum(curved, 2 * dr.abs(inside - 0.5 * (c_V2[j] + c_V2[k])))
    low, high = fold(dr.minimum, c_V2), fold(dr.maximum, c_V2)
    bend = dr.select(low < curved, dr.maximum(bend, dr.safe_sqrt(high + curved)), bend)
    return Piece(list(P), list(omega), bend, twist + sag, u0, v0, h)


def nothing(piece, empty):
    """``piece`` with those that are ``empty`` such that g has no zeros for any line."""
    piece.omega = [dr.select(empty, mi.Vector3f(0), x) for x in piece.omega]
    piece.bend, piece.twist = dr.select(empty, 0, piece.bend), dr.select(empty, -1, piece.twist)
    return piece


def excess(piece, light):
    """How many times the size of beams, or the turn of their directions, is what ``tolerances.NEAR`` and ``TURN`` allow."""
    distance = None if light.distant else fold(dr.minimum, [dr.norm(light.L - p) for p in piece.P])
    out = mi.Float(0)
    for j, k in ((0, 1), (1, 2), (2, 0)):
        edge, turn = dr.norm(piece.P[j] - piece.P[k]), dr.norm(piece.omega[j] - piece.omega[k])
        out = dr.maximum(out, turn / tolerances.TURN)
        if distance is not None:
            out = dr.maximum(out, edge / (tolerances.NEAR * dr.maximum(distance, 1e-30)))
    return out


def numbers(piece, reach):
    """The record of a beam; ``reach``: the last 5 of its numbers."""
    out = []
    for p, w in zip(piece.P, piece.omega):
        out += [p.x, p.y, p.z, w.x, w.y, w.z]
    return out + [piece.bend, piece.twist, piece.u0, piece.v0, piece.h, *reach]


def unpack(numbers):
    """``Piece`` of a gathered record."""
    P = [mi.Vector3f(numbers[6 * i : 6 * i + 3]) for i in range(3)]
    omega = [mi.Vector3f(numbers[6 * i + 3 : 6 * i + 6]) for i in range(3)]
    return Piece(P, omega, *numbers[18:23])


@dataclass
class Zeros:
    """Where g vanishes on beams. ``possible``: False only if it surely doesn't; ``bracketed``: the corners have
    different signs; ``g``: its values there; ``nonlinearity``: how far it can deviate from linear in between, relative to its range."""

    possible: object
    bracketed: object
    g: list
    nonlinearity: object


def classify(piece, segment):
    """``Zeros`` of g on beams for segments."""
    g, reach = [], mi.Float(0)
    for p, w in zip(piece.P, piece.omega):
        across = dr.cross(p - segment.o, segment.d)
        g.append(dr.dot(w, across))
        reach = dr.maximum(reach, dr.norm(across))
    bound = piece.bend * reach + piece.twist
    low, high = fold(dr.minimum, g), fold(dr.maximum, g)
    # A pair of which only an edge is touched, g = 0 at a corner, is bracketed on one side of it only.
    possible, bracketed = (low <= bound) & (high >= -bound), (low < 0) & (high >= 0)
    return Zeros(possible, bracketed, g, bound / dr.maximum(high - low, 1e-30))


def fold(f, items):
    """``f`` of all items: fold(dr.minimum, [a, b, c]) is the smallest."""
    return functools.reduce(f, items)

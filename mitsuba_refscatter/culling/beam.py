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

BEAM = 24
"""Numbers per beam: P and omega at 3 corners (18), bend, twist, u0, v0, h, and the clear length."""

CORNERS = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
MIDDLES = ((0.5, 0.5), (0.0, 0.5), (0.5, 0.0))
"""Middle of the edge opposite to each corner."""


def sub_triangle(code, level):
    """Corner and signed size (u0, v0, h) of sub-triangle ``code`` of the 4^level similar ones.

    Its corners are (u0, v0), (u0 + h, v0), (u0, v0 + h). Per base-4 digit: 0, 1, 2 keep a corner of the
    parent, 3 is the middle one, turned by half a turn (h < 0).
    """
    u, v, h = mi.Float(0), mi.Float(0), mi.Float(1)
    for k in range(tolerances.MAX_SUBDIVISION):
        digit = (code >> (2 * k)) & 3
        active = level > k
        half = 0.5 * h
        middle = digit == 3
        u = dr.select(active & ((digit == 1) | middle), u + half, u)
        v = dr.select(active & ((digit == 2) | middle), v + half, v)
        h = dr.select(active, dr.select(middle, -half, half), h)
    return u, v, h


def refracted(tri, u, v, L, eta):
    """Position and refracted direction at (u, v) of triangles lit from ``L`` (continued where unlit)."""
    P = tri.position(u, v)
    omega, _, _ = optics.refract_in(dr.normalize(L - P), tri.normal(u, v), eta)
    return P, omega


def corners(numbers):
    """Corner positions and directions of a gathered beam record."""
    P = [mi.Vector3f(numbers[6 * i : 6 * i + 3]) for i in range(3)]
    omega = [mi.Vector3f(numbers[6 * i + 3 : 6 * i + 6]) for i in range(3)]
    return P, omega


@dataclass
class Zeros:
    """Where g vanishes on beams. ``possible``: False only if it surely doesn't; ``bracketed``: the corners have
    different signs; ``g``: its values there; ``bound``: how far it can deviate from linear in between; ``nonlinearity``:
    the same relative to its range."""

    possible: object
    bracketed: object
    g: list
    bound: object
    nonlinearity: object


def classify(P, omega, bend, twist, segment):
    """``Zeros`` of g for beams with these corners, whose bend and twist are as in the record."""
    g, reach = [], mi.Float(0)
    for p, w in zip(P, omega):
        across = dr.cross(p - segment.o, segment.d)
        g.append(dr.dot(w, across))
        reach = dr.maximum(reach, dr.norm(across))
    bound = bend * reach + twist
    low, high = fold(dr.minimum, g), fold(dr.maximum, g)
    # A pair of which only an edge is touched, g = 0 at a corner, is bracketed on one side of it only.
    possible, bracketed = (low <= bound) & (high >= -bound), (low < 0) & (high >= 0)
    return Zeros(possible, bracketed, g, bound, bound / dr.maximum(high - low, 1e-30))


def fold(f, items):
    """``f`` of all items: fold(dr.minimum, [a, b, c]) is the smallest."""
    return functools.reduce(f, items)

"""Light beams: cells of a boundary with the light that they send on, quadratic between six nodes.

A cell has coordinates (u, v) in the unit triangle. Its light follows the lines (omega, m), m = P x omega (Plücker's
numbers), where P is where the light leaves the boundary and omega its unit direction there. A camera line (o, d) meets
that of (u, v) where

    g = (P - o) . (d x omega) = -(d . m + (o x d) . omega) = 0.

omega, m, e = P . omega, the flux density phi per area in (u, v), and the length of the light's way behind P are known
at the corners and in the middles of the edges, and quadratic in between. So g is quadratic, too. P is relative to a
point in the cell, so that float32 keeps its digits.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..geometry import triangle

CORNERS = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
NODES = (*CORNERS, (0.5, 0.0), (0.5, 0.5), (0.0, 0.5))
"""(u, v) of the corners 0, 1, 2 and of the middles of the edges 01, 12, 20."""

LINES, BEAM = 24, 60
"""Numbers of a record of the lines alone, and of all of it."""

RADIUS = 23
"""Place of the radius in a record."""

NOTHING = -1.0
"""Radius of a cell that is none."""


@dataclass
class Lines:
    """What tells where g may vanish on beams, lane by lane; body coordinates.

    centre   Vector3f, to which m is relative
    omega    three Vector3f, directions at the corners
    m        three Vector3f, moments there
    d_omega  Float, how far omega is from linear in between, at most
    d_m      Float, the same of m
    radius   Float, largest distance of the cell from the centre; negative where there is none
    """

    centre: mi.Vector3f
    omega: list[mi.Vector3f]
    m: list[mi.Vector3f]
    d_omega: mi.Float
    d_m: mi.Float
    radius: mi.Float

    @classmethod
    def gather(cls, records, index, active=True, more=0):
        """Those at ``index`` (UInt32) of packed ``records`` (Float); ``more``: as ``LightBeams.gather`` has it."""
        x = _numbers(records, index, LINES, active, stride(more))
        v = [mi.Vector3f(x[i : i + 3]) for i in range(0, 21, 3)]
        return cls(v[0], v[1:4], v[4:7], *x[21:24])

    def at_corners(self, o, d):
        """g at the corners for camera lines, and how far it is from linear in between at most (Float)."""
        q = dr.cross(o - self.centre, d)
        g = [-(dr.dot(m, d) + dr.dot(w, q)) for w, m in zip(self.omega, self.m)]
        return g, self.d_m + self.d_omega * dr.norm(q)

    def may_meet(self, o, d, pad=0):
        """False (Bool) only where g does not vanish; ``pad``: how far it may be from what it is for the line."""
        g, bound = self.at_corners(o, d)
        bound += pad
        low, high = dr.minimum(dr.minimum(g[0], g[1]), g[2]), dr.maximum(dr.maximum(g[0], g[1]), g[2])
        return (self.radius >= 0) & (low <= bound) & (high >= -bound)


@dataclass
class LightBeams:
    """Light beams, lane by lane, body coordinates. Lists are of the ``NODES``.

    centre  Vector3f, to which m and e are relative
    omega   six Vector3f, directions; unit at the nodes
    m       six Vector3f, moments P x omega
    e       six Float, P . omega
    phi     six Float, flux density per area in (u, v), of light of intensity 1
    length  six Float, of the light's way behind P
    more    what else is known of the light, each six Float
    """

    centre: mi.Vector3f
    omega: list[mi.Vector3f]
    m: list[mi.Vector3f]
    e: list[mi.Float]
    phi: list[mi.Float]
    length: list[mi.Float]
    more: list

    @classmethod
    def gather(cls, records, index, active=True, more=0):
        """Those at ``index`` (UInt32) of packed ``records`` (Float); ``more``: number of quadratics in ``more``."""
        x = _numbers(records, index, stride(more), active, stride(more))
        v = [mi.Vector3f(x[i : i + 3]) for i in range(0, 21, 3)]
        w = [mi.Vector3f(x[i : i + 3]) for i in range(24, 42, 3)]
        extra = [x[BEAM + 6 * k : BEAM + 6 * k + 6] for k in range(more)]
        return cls(v[0], v[1:4] + w[:3], v[4:7] + w[3:], x[42:48], x[48:54], x[54:60], extra)


def stride(more):
    """Numbers of a record with ``more`` quadratics."""
    return BEAM + -(-6 * more // 4) * 4


def _numbers(records, index, count, active, stride):
    out = []
    for k in range(count // 4):
        out.extend(dr.gather(mi.Vector4f, records, index * (stride // 4) + k, active))
    return out


def pack(P, omega, phi, length, exists, more=()):
    """The numbers of records (list of Float, ``stride`` of them) of beams with values at the ``NODES``.

    P       six Vector3f, body coordinates
    omega   six Vector3f, unit
    phi     six Float
    length  six Float
    exists  Bool
    more    list of six Float each
    """
    low = high = P[0]
    for p in P[1:]:
        low, high = dr.minimum(low, p), dr.maximum(high, p)
    centre = 0.5 * (low + high)
    P = [p - centre for p in P]
    m = [dr.cross(p, w) for p, w in zip(P, omega)]
    radius = mi.Float(0)
    for p in control(P):
        radius = dr.maximum(radius, dr.norm(p))
    out = [*centre]
    for x in (omega[:3], m[:3]):
        for v in x:
            out += [*v]
    out += [bend(omega), bend(m), dr.select(exists, radius, NOTHING)]
    for x in (omega[3:], m[3:]):
        for v in x:
            out += [*v]
    out += [dr.dot(p, w) for p, w in zip(P, omega)] + list(phi) + list(length)
    for values in more:
        out += list(values)
    return out + [mi.Float(0)] * (stride(len(more)) - len(out))


def write(records, numbers, first, count):
    """Writes records from number ``first`` on."""
    triangle.scatter_numbers(records, numbers, dr.opaque(mi.UInt32, first) + dr.arange(mi.UInt32, count))


def control(f):
    """Bezier control points of the quadratic through six values at the ``NODES``: its hull holds the quadratic."""
    return [*f[:3], *(2 * f[3 + k] - 0.5 * (f[k] + f[(k + 1) % 3]) for k in range(3))]


def bend(f):
    """How far the quadratic through six Vector3f is from linear, at most (Float): by 4/3 of what it is in the middle
    of an edge."""
    out = mi.Float(0)
    for k in range(3):
        out = dr.maximum(out, dr.norm(f[3 + k] - 0.5 * (f[k] + f[(k + 1) % 3])))
    return 4 / 3 * out


def start(omega, m, e):
    """The point P (Vector3f) of the line (omega, m) with P . omega = e."""
    return (dr.cross(omega, m) + e * omega) / dr.squared_norm(omega)


def weights(u, v):
    """What the values at the six ``NODES`` count for at (u, v)."""
    w = 1 - u - v
    return [w * (2 * w - 1), u * (2 * u - 1), v * (2 * v - 1), 4 * w * u, 4 * u * v, 4 * v * w]


def mix(x, f):
    """The sum of values ``f`` by ``weights`` ``x``."""
    out = f[0] * x[0]
    for weight, value in zip(x[1:], f[1:]):
        out = dr.fma(value, weight, out)
    return out


def monomials(f):
    """(1, u, v, u^2, uv, v^2) coefficients of the quadratic through six values."""
    return (
        f[0],
        4 * f[3] - 3 * f[0] - f[1],
        4 * f[5] - 3 * f[0] - f[2],
        2 * (f[0] + f[1]) - 4 * f[3],
        4 * (f[0] - f[3] + f[4] - f[5]),
        2 * (f[0] + f[2]) - 4 * f[5],
    )

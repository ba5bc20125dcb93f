"""The tree over light beams: what its nodes bound, and the test of a camera segment against a node.

A node bounds all its light lines, each through a point P with direction omega, by a linear model:

    omega = omega0 + A delta + e,   delta = P - c,  |delta| <= h,  |e| <= r   (by component)

with ``c`` the centre of the P box. Such a line meets the camera line (o, d) where

    g = (P - o) . (d x omega) = omega0 . k + delta . (A^T k - omega0 x d) + e . k - d . (delta x (A delta + e)),

k = (c - o) x d, is zero. The last two terms are small, so the first two tell nearly exactly whether that is
possible. This bounds the beams along their whole length: no beam is cut into pieces along it and no pair is found
twice. A box around the beams tells whether the segment comes to them at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..geometry import bvh, triangle
from . import beam

NODE = 28
"""Numbers per node: c, h, omega0, A's columns, r, box (9 x 3), and a bound of the quadratic term."""


@dataclass
class Bounds:
    """What a node bounds, body coordinates, lane by lane.

    P_low, P_high        Vector3f, box of P
    A0, A1, A2           Vector3f, columns of the linear model
    rest_low, rest_high  Vector3f, box of omega - A (P - c)
    box_low, box_high    Vector3f, box of the beams
    count                Float, number of beams (for means); the node is empty where that is 0
    skew                 Float, how far moments are from P x omega, at most
    """

    P_low: mi.Vector3f
    P_high: mi.Vector3f
    A0: mi.Vector3f
    A1: mi.Vector3f
    A2: mi.Vector3f
    rest_low: mi.Vector3f
    rest_high: mi.Vector3f
    box_low: mi.Vector3f
    box_high: mi.Vector3f
    count: mi.Float
    skew: mi.Float

    def centre(self):
        """Centre c of the box of P."""
        return 0.5 * (self.P_low + self.P_high)

    def half(self):
        """Half of its size."""
        return 0.5 * (self.P_high - self.P_low)

    def columns(self):
        """Those of the linear model."""
        return self.A0, self.A1, self.A2

    def rest_about(self, c, columns):
        """Box of omega minus another linear model, with these ``columns`` about ``c``."""
        shift = times(columns, self.centre() - c)
        slack = times([dr.abs(a - b) for a, b in zip(self.columns(), columns)], self.half())
        return self.rest_low - shift - slack, self.rest_high - shift + slack

    def fields(self):
        """All of it as a tuple, for ``bvh.fold``."""
        return tuple(self.__dict__.values())


def times(columns, x):
    """The matrix with these ``columns`` times x."""
    return columns[0] * x.x + columns[1] * x.y + columns[2] * x.z


def merge(a, b):
    """Bounds of two nodes' union; ``a`` and ``b`` are field tuples of ``Bounds``."""
    a, b = Bounds(*a), Bounds(*b)
    P_low, P_high = dr.minimum(a.P_low, b.P_low), dr.maximum(a.P_high, b.P_high)
    c, share = 0.5 * (P_low + P_high), a.count / dr.maximum(a.count + b.count, 1)
    columns = [share * x + (1 - share) * y for x, y in zip(a.columns(), b.columns())]
    (a_low, a_high), (b_low, b_high) = a.rest_about(c, columns), b.rest_about(c, columns)
    union = Bounds(
        P_low, P_high, *columns, dr.minimum(a_low, b_low), dr.maximum(a_high, b_high),
        dr.minimum(a.box_low, b.box_low), dr.maximum(a.box_high, b.box_high), a.count + b.count,
        dr.maximum(a.skew, b.skew),
    )  # fmt: skip
    return tuple(dr.select(b.count == 0, x, dr.select(a.count == 0, y, z))
                 for x, y, z in zip(a.fields(), b.fields(), union.fields()))  # fmt: skip


def pack(fields):
    """The ``NODE`` numbers of a node; ``fields``: those of ``Bounds``."""
    b = Bounds(*fields)
    h, r = b.half(), 0.5 * (b.rest_high - b.rest_low)
    change = times([dr.abs(x) for x in b.columns()], h)
    out, nowhere = [], mi.Vector3f(tolerances.ENDLESS)  # no segment comes to the box of an empty node
    for x in (
        b.centre(), h, 0.5 * (b.rest_low + b.rest_high), *b.columns(), r,
        dr.select(b.count == 0, nowhere, b.box_low), dr.select(b.count == 0, nowhere, b.box_high),
    ):  # fmt: skip
        out += [x.x, x.y, x.z]
    return out + [dr.norm(h) * (dr.norm(change) + dr.norm(r)) + b.skew]


def tree_of(count, bounds_at):
    """The tree over items, in their order.

    count      int, number of items
    bounds_at  (index) -> ``Bounds`` of items (UInt32), whose ``count`` is 0 where there is nothing
    """
    depth = bvh.depth_for(count)
    first = dr.arange(mi.UInt32, 1 << depth) * bvh.LEAF
    last = dr.opaque(mi.UInt32, count - 1)
    bounds = None
    for j in range(bvh.LEAF):
        item = bounds_at(dr.minimum(first + j, last))
        item.count = dr.select(first + j <= last, item.count, 0)
        bounds = item.fields() if bounds is None else merge(bounds, item.fields())
    return bvh.fold(bounds, depth, merge, pack, NODE)


def _beam_bounds(piece, body):
    """Bounds of single beams: the linear model is exact at the corners, ``bend`` bounds what is left in between."""
    P, omega, bend = piece.P, piece.omega, piece.bend
    columns = linear_model(P, omega)
    P_low, P_high = bvh.box(P)
    c = 0.5 * (P_low + P_high)
    rest_low, rest_high = _hull([w - times(columns, p - c) for p, w in zip(P, omega)], bend)
    return Bounds(
        P_low, P_high, *columns, rest_low, rest_high, *_beam_box(P, omega, bend, body), mi.Float(1), mi.Float(0)
    )


def linear_model(P, omega):
    """Columns of the linear model that is exact at three corners."""
    e1, e2 = P[1] - P[0], P[2] - P[0]
    n = dr.cross(e1, e2)
    area2 = dr.squared_norm(n)
    # The dual basis of the edges in the triangle's plane; no model for needles, whose omega changes little.
    fine = area2 > tolerances.NEEDLE * dr.squared_norm(e1) * dr.squared_norm(e2)
    b1, b2 = (dr.select(fine, x / dr.select(fine, area2, 1), 0) for x in (dr.cross(e2, n), dr.cross(n, e1)))
    w1, w2 = omega[1] - omega[0], omega[2] - omega[0]
    return [w1 * b1[k] + w2 * b2[k] for k in range(3)]


def _hull(points, pad):
    low, high = bvh.box(points)
    return low - pad, high + pad


def _beam_box(P, omega, bend, body):
    """Box of a beam inside the box of its body: from its triangle as far as any of its rays can go.

    A ray leaves the body's box at the latest where it passes the wall ahead along any one axis. Rays between the
    corners may go further than the corners' own: per axis the longest way is taken, over the axes the shortest.
    """
    low, high, least = *(dr.opaque(mi.Vector3f, x) for x in (body.box_low, body.box_high)), tolerances.ALONG_WALL
    longest = dr.norm(high - low)
    P_low, P_high = bvh.box(P)
    w_low, w_high = _hull(omega, bend)
    for k in range(3):
        up, down = (
            (high[k] - P_low[k]) / dr.maximum(w_low[k], least),
            (P_high[k] - low[k]) / dr.maximum(-w_high[k], least),
        )
        along = dr.select(w_low[k] > least, up, dr.select(w_high[k] < -least, down, tolerances.ENDLESS))
        longest = dr.minimum(longest, along)
    ends = [p + longest * w for p, w in zip(P, omega)]
    box_low, box_high = _hull(list(P) + ends, bend * longest)
    return dr.maximum(box_low, low), dr.minimum(box_high, high)


def build(records, count, body):
    """The tree over the light beams of a body.

    records  Float, flat, ``beam.BEAM`` numbers per beam
    count    int, number of beams
    body     ``scene.boundaries.Body``
    """

    def bounds_at(index):
        piece = beam.unpack(triangle.gather_numbers(records, index, beam.BEAM))
        out = _beam_bounds(piece, body)
        out.count = dr.select(piece.twist >= 0, out.count, 0)
        return out

    return tree_of(count, bounds_at)


def node_test(segments):
    """The conservative test of bundles of camera segments (``Bundles.middle``) against a node, for ``bvh.traverse``.

    From its middle to another line of a bundle (P - o) x d changes by at most |P - o| spread_d + spread_o, and g by
    that, too.
    """
    o, d, t_max, inverse_d = segments.o, segments.d, segments.t_max, segments.inverse_d
    spread_o, spread_d = segments.spread_o, segments.spread_d
    pad = spread_o + t_max * spread_d

    def hit(x):
        c, h, omega, a0, a1, a2, r, low, high = (mi.Vector3f(x[i : i + 3]) for i in range(0, 27, 3))
        k = dr.cross(c - o, d)
        linear = mi.Vector3f(dr.dot(a0, k), dr.dot(a1, k), dr.dot(a2, k)) - dr.cross(omega, d)
        bound = dr.dot(dr.abs(linear), h) + dr.dot(r, dr.abs(k)) + x[27]
        bound += (dr.norm(c - o) + dr.norm(h)) * spread_d + spread_o
        t0, t1 = (low - pad - o) * inverse_d, (high + pad - o) * inverse_d
        near = dr.max(dr.minimum(t0, t1))
        far = dr.min(dr.maximum(t0, t1))
        return (dr.abs(dr.dot(omega, k)) <= bound) & (near <= far) & (far >= 0) & (near <= t_max)

    return hit

"""The tree over light beams: what its nodes bound, and the test of a camera segment against a node.

A node bounds the Pluecker coordinates of all its light lines. With ``c`` the node's centre, a line through
P with direction omega meets the camera line (o, d) where

    g = (P - o) . (d x omega) = omega . k - d . m,   k = (c - o) x d,   m = (P - c) x omega

is zero, so a node whose intervals of omega and m keep g off zero is skipped. This bounds the beams along
their whole length; no beam is cut into pieces along it and no pair is found twice. A box around the beams
tells whether the segment reaches them at all.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..geometry import bvh, triangle
from . import beam

NODE = 24
"""Numbers per node: centre c, omega's middle and half width, m's middle and half width, box (7 x 3), pad."""


def _cross_bound(a, b):
    """Componentwise bound of |x cross y| for |x| <= a, |y| <= b."""
    return mi.Vector3f(a.y * b.z + a.z * b.y, a.z * b.x + a.x * b.z, a.x * b.y + a.y * b.x)


@dataclass
class Bounds:
    """What a node bounds, as lower and upper corners: P, omega, m = (P - c) x omega, and the beams' box.

    ``c`` is the middle of the P box. Empty where ``P_low > P_high``.
    """

    P_low: object
    P_high: object
    omega_low: object
    omega_high: object
    m_low: object
    m_high: object
    box_low: object
    box_high: object

    def centre(self):
        return 0.5 * (self.P_low + self.P_high)

    def m_about(self, c):
        """Interval of (P - c) x omega about another centre."""
        shift = self.centre() - c
        middle = dr.cross(shift, 0.5 * (self.omega_low + self.omega_high))
        half = _cross_bound(dr.abs(shift), 0.5 * (self.omega_high - self.omega_low))
        return self.m_low + middle - half, self.m_high + middle + half

    def fields(self):
        return tuple(self.__dict__.values())


def merge(a, b):
    """Bounds of two nodes' union; ``a`` and ``b`` are field tuples of ``Bounds``."""
    a, b = Bounds(*a), Bounds(*b)
    union = Bounds(*(dr.minimum(x, y) if i % 2 == 0 else dr.maximum(x, y)
                     for i, (x, y) in enumerate(zip(a.fields(), b.fields()))))  # fmt: skip
    c = union.centre()
    (a_low, a_high), (b_low, b_high) = a.m_about(c), b.m_about(c)
    union.m_low, union.m_high = dr.minimum(a_low, b_low), dr.maximum(a_high, b_high)
    a_empty, b_empty = a.P_low.x > a.P_high.x, b.P_low.x > b.P_high.x
    return tuple(dr.select(b_empty, x, dr.select(a_empty, y, z))
                 for x, y, z in zip(a.fields(), b.fields(), union.fields()))  # fmt: skip


FAR = 1e30
"""Where the box of an empty node is: no segment comes there."""


def pack(fields):
    """The ``NODE`` numbers of a node."""
    b = Bounds(*fields)
    empty = b.P_low.x > b.P_high.x
    out = []
    for x in (
        b.centre(),
        0.5 * (b.omega_low + b.omega_high),
        0.5 * (b.omega_high - b.omega_low),
        0.5 * (b.m_low + b.m_high),
        0.5 * (b.m_high - b.m_low),
        dr.select(empty, mi.Vector3f(FAR), b.box_low),
        dr.select(empty, mi.Vector3f(FAR), b.box_high),
    ):
        out += [x.x, x.y, x.z]
    return out + [mi.Float(0)] * 3


def _leaf_bounds(records, count, depth, body):
    """Bounds of the leaves, each of ``bvh.LEAF`` consecutive beams."""
    first = dr.arange(mi.UInt32, 1 << depth) * bvh.LEAF
    last = dr.opaque(mi.UInt32, count - 1)
    items = []
    for j in range(bvh.LEAF):
        x = triangle.gather_numbers(records, dr.minimum(first + j, last), beam.BEAM)
        items.append((beam.corners(x), x[18], x[19]))
    every = [p for (P, _), _, _ in items for p in P]
    P_low, P_high = _hull(every)
    c = 0.5 * (P_low + P_high)
    parts = []
    for (P, omega), bend, twist in items:
        reach = dr.maximum(dr.norm(P[0] - c), dr.maximum(dr.norm(P[1] - c), dr.norm(P[2] - c)))
        parts.append((_hull(omega, bend), _hull([dr.cross(p - c, w) for p, w in zip(P, omega)], bend * reach + twist),
                      _beam_box(P, omega, bend, body)))  # fmt: skip
    fields = [P_low, P_high]
    for k in range(3):
        fields += [beam.fold(dr.minimum, [p[k][0] for p in parts]), beam.fold(dr.maximum, [p[k][1] for p in parts])]
    empty = first > last
    return tuple(dr.select(empty, mi.Vector3f(FAR if i % 2 == 0 else -FAR), x) for i, x in enumerate(fields))


def _hull(points, pad=0):
    return beam.fold(dr.minimum, points) - pad, beam.fold(dr.maximum, points) + pad


def _beam_box(P, omega, bend, body):
    """Box of a beam inside the box of its body: from its triangle as far as its longest ray goes."""
    low, high = (dr.opaque(mi.Vector3f, x) for x in (body.box_low, body.box_high))
    reach = mi.Float(0)
    for p, w in zip(P, omega):
        wall = dr.select(w > 0, high, low)
        leave = (wall - p) / dr.select(dr.abs(w) < 1e-12, 1e-12, w)
        reach = dr.maximum(reach, dr.min(dr.abs(leave)))
    reach = dr.minimum(reach, dr.norm(high - low))
    ends = [p + reach * w for p, w in zip(P, omega)]
    box_low, box_high = _hull(list(P) + ends, bend * reach)
    return dr.maximum(box_low, low), dr.minimum(box_high, high)


def build(records, count, body):
    """The tree over ``count`` packed beams of a body."""
    depth = bvh.depth_for(count)
    return bvh.fold(_leaf_bounds(records, count, depth, body), depth, merge, pack, NODE)


def node_test(segments):
    """The conservative test of a camera segment against a node, for ``bvh.traverse``."""
    o, d, t_max, inverse_d = segments.o, segments.d, segments.t_max, segments.inverse_d
    absolute_d = dr.abs(d)

    def hit(x):
        c, omega, e, m, r, low, high = (mi.Vector3f(x[i : i + 3]) for i in range(0, 21, 3))
        k = dr.cross(c - o, d)
        g = dr.dot(omega, k) - dr.dot(d, m)
        met = dr.abs(g) <= dr.dot(e, dr.abs(k)) + dr.dot(r, absolute_d)
        t0, t1 = (low - o) * inverse_d, (high - o) * inverse_d
        near = dr.max(dr.minimum(t0, t1))
        far = dr.min(dr.maximum(t0, t1))
        return met & (near <= far) & (far >= 0) & (near <= t_max)

    return hit

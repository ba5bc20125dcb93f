"""Culling by light beams: which triangles refract light onto which camera segment, for a point light.

A triangle and the rays that its points refract make a *light beam*. Beams that bend too much are cut in
similar sub-triangles, so that the refracted direction is close to linear on each. A tree over the beams
bounds, per node, the Pluecker coordinates of all its light lines: with ``c`` the node's centre, a line
through P with direction omega meets the camera line (o, d) where

    g = (P - o) . (d x omega) = omega . k - d . m,   k = (c - o) x d,   m = (P - c) x omega

is zero, so a node whose intervals of omega and m keep g off zero is skipped. This bounds the beams along
their whole length; no beam is cut into pieces along it and no pair is found twice. A box around the beams
tells whether the segment reaches them at all.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import optics, tolerances
from ..geometry import bvh, triangle

BEAM = 24
"""Numbers per beam: P and omega at 3 corners (18), bend, twist, u0, v0, h, and the clear length."""

NODE = 24
"""Numbers per node: centre c, omega's middle and half width, m's middle and half width, box (7 x 3), pad."""

CORNERS = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
MIDDLES = ((0.5, 0.5), (0.0, 0.5), (0.5, 0.0))
"""Middle of the edge opposite to each corner."""


@dataclass
class Beams:
    """The light beams of one light in one body, and their tree.

    ``records``: flat, ``BEAM`` numbers each; ``triangles``: parent triangle of each beam; ``proven_lit``:
    whether the whole beam is known to see the light.
    """

    records: object
    triangles: object
    proven_lit: object
    count: int
    tree: bvh.Tree


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


class _Light:
    """The refracted light at points of triangles."""

    def __init__(self, position, eta):
        self.position, self.eta = position, eta

    def refracted(self, tri, u, v):
        """Position and refracted direction (continued smoothly where unlit)."""
        P = tri.position(u, v)
        omega, _, _ = optics.refract_in(dr.normalize(self.position - P), tri.normal(u, v), self.eta)
        return P, omega


def _lit(tri, L):
    """False only if no point of the triangle is lit: the facet turns away, or n . (L - P) < 0 throughout.

    The latter is quadratic in (u, v): the largest of its six Bernstein coefficients bounds it.
    """
    a = [L - tri.position(u, v) for u, v in CORNERS]
    n = [tri.n0, tri.n0 + tri.n_u, tri.n0 + tri.n_v]
    top = dr.dot(n[0], a[0])
    for i in range(3):
        for j in range(i, 3):
            top = dr.maximum(top, 0.5 * (dr.dot(n[i], a[j]) + dr.dot(n[j], a[i])))
    return (top > 0) & (dr.dot(tri.Ng, a[0]) > 0)


def _levels(tri, light, size, bend):
    """Subdivisions after which the bend of the beam is below ``bend`` times its width.

    Width and bend are taken at the distance ``size``. Per level the bend falls by 4, the width by 2.
    """
    P, omega = zip(*(light.refracted(tri, u, v) for u, v in CORNERS))
    width, deviation = mi.Float(0), mi.Float(0)
    for i, (u, v) in enumerate(MIDDLES):
        j, k = (i + 1) % 3, (i + 2) % 3
        _, middle = light.refracted(tri, u, v)
        deviation = dr.maximum(deviation, size * dr.norm(middle - 0.5 * (omega[j] + omega[k])))
        width = dr.maximum(width, dr.norm(P[j] - P[k]) + size * dr.norm(omega[j] - omega[k]))
    ratio = deviation / dr.maximum(bend * width, 1e-30)
    level = dr.ceil(dr.log2(dr.maximum(ratio, 1e-6)))
    return mi.UInt32(dr.clip(level, 0, tolerances.MAX_SUBDIVISION))


def build(body, scene_records, L, bend, seen, clear):
    """Light beams of the point light at ``L`` (body coordinates, Point3f) in ``body``; None if none is lit.

    ``seen(triangles) -> (kept, proven)``: which triangles the light may reach, as indices into the argument, and
    for each of these whether all of it is known to be lit. ``clear(P, omega, bend)``: length to which beams
    with these corners are known to be free, or None where no beam is ever blocked.
    """
    light = _Light(L, dr.opaque(mi.Float, body.eta))
    every = dr.opaque(mi.UInt32, body.first_record) + dr.arange(mi.UInt32, body.triangle_count)
    lit = dr.compress(_lit(triangle.gather(scene_records, every), L))
    lit = dr.gather(mi.UInt32, every, lit)
    if dr.width(lit) > 0:
        kept, proven = seen(lit)
        lit = dr.gather(mi.UInt32, lit, kept)
    if dr.width(lit) == 0:
        return None
    size = dr.opaque(mi.Float, body.size)
    level = _levels(triangle.gather(scene_records, lit), light, size, dr.opaque(mi.Float, bend))

    parent, code, level = _expand(level)
    u0, v0, h = sub_triangle(code, level)
    index = dr.gather(mi.UInt32, lit, parent)
    proven = dr.gather(mi.Bool, proven, parent)
    centre = triangle.gather(scene_records, index).position(u0 + h / 3, v0 + h / 3)
    order = mi.UInt32(bvh.median_order(centre.numpy().T).astype(np.uint32))
    index, proven, u0, v0, h = (dr.gather(type(x), x, order) for x in (index, proven, u0, v0, h))

    count = dr.width(index)
    records = dr.empty(mi.Float, count * BEAM)
    tri = triangle.gather(scene_records, index)
    triangle.scatter_numbers(records, _beam(tri, light, u0, v0, h, clear), dr.arange(mi.UInt32, count))
    dr.eval(records, index, proven)
    return Beams(records, index, proven, count, _tree(records, count, body))


def _expand(level):
    """One entry per sub-triangle: index of its parent in ``level``, code, level."""
    if dr.all(level == 0):
        parent = dr.arange(mi.UInt32, dr.width(level))
        return parent, dr.zeros(mi.UInt32, dr.width(level)), level
    counts = 4 ** level.numpy().astype(np.int64)
    parent = np.repeat(np.arange(len(counts)), counts)
    code = np.arange(len(parent)) - np.repeat(np.cumsum(counts) - counts, counts)
    parent = mi.UInt32(parent.astype(np.uint32))
    return parent, mi.UInt32(code.astype(np.uint32)), dr.gather(mi.UInt32, level, parent)


def _beam(tri, light, u0, v0, h, clear):
    """The numbers of a beam's record.

    ``bend`` bounds how far omega is from linear on the beam, in any direction: a quadratic deviates by at
    most 4/3 of what it does at the edges' middles; 2 leaves room for the cubic part. ``twist`` bounds the
    same for what is bilinear in position and direction, as g and m are: 4/3 of |edge| |change| / 4.
    """
    P, omega = zip(*(light.refracted(tri, dr.fma(h, u, u0), dr.fma(h, v, v0)) for u, v in CORNERS))
    bend, twist = mi.Float(0), mi.Float(0)
    for i, (u, v) in enumerate(MIDDLES):
        j, k = (i + 1) % 3, (i + 2) % 3
        _, middle = light.refracted(tri, dr.fma(h, u, u0), dr.fma(h, v, v0))
        bend = dr.maximum(bend, 2 * dr.norm(middle - 0.5 * (omega[j] + omega[k])))
        twist = dr.maximum(twist, dr.norm(P[j] - P[k]) * dr.norm(omega[j] - omega[k]) / 3)
    numbers = []
    for p, w in zip(P, omega):
        numbers += [p.x, p.y, p.z, w.x, w.y, w.z]
    free = mi.Float(0) if clear is None else clear(P, omega, bend)
    return numbers + [bend, twist, u0, v0, h, free]


def corners(numbers):
    """Corner positions and directions of a gathered beam record."""
    P = [mi.Vector3f(numbers[6 * i : 6 * i + 3]) for i in range(3)]
    omega = [mi.Vector3f(numbers[6 * i + 3 : 6 * i + 6]) for i in range(3)]
    return P, omega


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
        x = triangle.gather_numbers(records, dr.minimum(first + j, last), BEAM)
        items.append((corners(x), x[18], x[19]))
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
        fields += [_fold(dr.minimum, [p[k][0] for p in parts]), _fold(dr.maximum, [p[k][1] for p in parts])]
    empty = first > last
    return tuple(dr.select(empty, mi.Vector3f(FAR if i % 2 == 0 else -FAR), x) for i, x in enumerate(fields))


def _fold(f, items):
    out = items[0]
    for x in items[1:]:
        out = f(out, x)
    return out


def _hull(points, pad=0):
    return _fold(dr.minimum, points) - pad, _fold(dr.maximum, points) + pad


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


def _tree(records, count, body):
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


def filter_pairs(beams, segments, lane, leaf, count):
    """From (segment, leaf) to the (segment, beam) pairs in which g may have a zero.

    ``count`` of the places of ``lane`` and ``leaf`` are used. Conservative: a pair goes only where g at the
    three corners has one sign and is further from zero than it can deviate from linear in between.
    """
    i = dr.arange(mi.UInt32, count * bvh.LEAF)
    pair = i // bvh.LEAF
    beam = dr.gather(mi.UInt32, leaf, pair) * bvh.LEAF + (i & (bvh.LEAF - 1))
    active = beam < dr.opaque(mi.UInt32, beams.count)
    index = dr.gather(mi.UInt32, lane, pair)
    segment = segments.gather(index)
    x = triangle.gather_numbers(beams.records, dr.select(active, beam, 0), BEAM)
    P, omega = corners(x)
    g, reach = [], mi.Float(0)
    for p, w in zip(P, omega):
        across = dr.cross(p - segment.o, segment.d)
        g.append(dr.dot(w, across))
        reach = dr.maximum(reach, dr.norm(across))
    bound = x[18] * reach + x[19]
    keep = active & (_fold(dr.minimum, g) <= bound) & (_fold(dr.maximum, g) >= -bound)
    kept = dr.compress(keep)
    if dr.width(kept) == 0:
        return kept, kept
    pair = kept // bvh.LEAF
    beam = dr.gather(mi.UInt32, leaf, pair) * bvh.LEAF + (kept & (bvh.LEAF - 1))
    return dr.gather(mi.UInt32, lane, pair), beam

"""Culling by light beams: which triangles refract light onto which camera segment, for a point light.

A triangle and the rays that its points refract make a *light beam*. Beams that bend too much are cut in
similar sub-triangles, so that the refracted direction is close to linear on each. A tree
over the beams (``beam_tree``) finds those that a camera segment may meet.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import lanes, tolerances
from ..geometry import bvh, triangle
from . import beam as light_beam
from . import beam_tree


@dataclass
class Beams:
    """The light beams of one light in one body, and their tree.

    ``records``: flat, ``beam.BEAM`` numbers each; ``triangles``: parent triangle of each beam; ``proven_lit``:
    whether the whole beam is known to see the light.
    """

    records: object
    triangles: object
    proven_lit: object
    count: int
    tree: bvh.Tree


def _lit(tri, L):
    """False only if no point of the triangle is lit: the facet turns away, or n . (L - P) < 0 throughout.

    The latter is quadratic in (u, v): the largest of its six Bernstein coefficients bounds it.
    """
    a = [L - tri.position(u, v) for u, v in light_beam.CORNERS]
    n = [tri.n0, tri.n0 + tri.n_u, tri.n0 + tri.n_v]
    top = dr.dot(n[0], a[0])
    for i in range(3):
        for j in range(i, 3):
            top = dr.maximum(top, 0.5 * (dr.dot(n[i], a[j]) + dr.dot(n[j], a[i])))
    return (top > 0) & (dr.dot(tri.Ng, a[0]) > 0)


def _levels(tri, light, size, bend):
    """Subdivisions after which a beam is simple enough.

    Its bend is below ``bend`` times its width (both at the distance ``size``; per level the bend falls by 4, the
    width by 2), and its edges and directions are within ``tolerances.NEAR`` and ``TURN``.
    """
    P, omega = zip(*(light_beam.refracted(tri, u, v, *light) for u, v in light_beam.CORNERS))
    distance = light_beam.fold(dr.minimum, [dr.norm(light[0] - p) for p in P])
    width, deviation, excess = mi.Float(0), mi.Float(0), mi.Float(0)
    for i, (u, v) in enumerate(light_beam.MIDDLES):
        j, k = (i + 1) % 3, (i + 2) % 3
        _, middle = light_beam.refracted(tri, u, v, *light)
        deviation = dr.maximum(deviation, size * dr.norm(middle - 0.5 * (omega[j] + omega[k])))
        edge, turn = dr.norm(P[j] - P[k]), dr.norm(omega[j] - omega[k])
        width = dr.maximum(width, edge + size * turn)
        near = edge / (tolerances.NEAR * dr.maximum(distance, 1e-30))
        excess = dr.maximum(excess, dr.maximum(near, turn / tolerances.TURN))
    excess = dr.maximum(excess, deviation / dr.maximum(bend * width, 1e-30))
    level = dr.ceil(dr.log2(dr.clip(excess, 1e-6, 1e6)))
    return mi.UInt32(dr.clip(level, 0, tolerances.MAX_SUBDIVISION))


def build(body, scene_records, L, bend, seen, clear):
    """Light beams of the point light at ``L`` (body coordinates, Point3f) in ``body``; None if none is lit.

    ``seen(triangles) -> (kept, proven)``: which triangles the light may reach, as indices into the argument, and
    for each of these whether all of it is known to be lit. ``clear(P, omega, bend)``: length to which beams
    with these corners are known to be free, or None where no beam is ever blocked.
    """
    light = (L, dr.opaque(mi.Float, body.eta))
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
    u0, v0, h = light_beam.sub_triangle(code, level)
    index = dr.gather(mi.UInt32, lit, parent)
    proven = dr.gather(mi.Bool, proven, parent)
    centre = triangle.gather(scene_records, index).position(u0 + h / 3, v0 + h / 3)
    order = mi.UInt32(bvh.median_order(centre.numpy().T).astype(np.uint32))
    index, proven, u0, v0, h = (dr.gather(type(x), x, order) for x in (index, proven, u0, v0, h))

    count = dr.width(index)
    records = dr.empty(mi.Float, count * light_beam.BEAM)
    tri = triangle.gather(scene_records, index)
    triangle.scatter_numbers(records, _beam(tri, light, u0, v0, h, clear), dr.arange(mi.UInt32, count))
    dr.eval(records, index, proven)
    return Beams(records, index, proven, count, beam_tree.build(records, count, body))


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
    P, omega = zip(
        *(light_beam.refracted(tri, dr.fma(h, u, u0), dr.fma(h, v, v0), *light) for u, v in light_beam.CORNERS)
    )
    bend, twist = mi.Float(0), mi.Float(0)
    for i, (u, v) in enumerate(light_beam.MIDDLES):
        j, k = (i + 1) % 3, (i + 2) % 3
        _, middle = light_beam.refracted(tri, dr.fma(h, u, u0), dr.fma(h, v, v0), *light)
        bend = dr.maximum(bend, 2 * dr.norm(middle - 0.5 * (omega[j] + omega[k])))
        twist = dr.maximum(twist, dr.norm(P[j] - P[k]) * dr.norm(omega[j] - omega[k]) / 3)
    numbers = []
    for p, w in zip(P, omega):
        numbers += [p.x, p.y, p.z, w.x, w.y, w.z]
    free = mi.Float(0) if clear is None else clear(P, omega, bend)
    return numbers + [bend, twist, u0, v0, h, free]


@dataclass
class Pairs:
    """(segment, beam) pairs as UInt32 arrays. Pairs may be of a part of a beam only: the sub-triangle ``code`` of
    ``level`` (``beam.sub_triangle``; None where the whole beam is meant); and of a part tau0 < tau < tau1 of
    the curve in it only (Float; None where all is meant)."""

    segment: object
    beam: object
    code: object = None
    level: object = None
    tau0: object = None
    tau1: object = None

    def gather(self, index):
        """The pairs at ``index``."""
        return Pairs(*(None if x is None else lanes.gather(x, index) for x in self.__dict__.values()))

    def halves(self):
        """The pairs as two lists."""
        n = len(self) // 2
        return [self.gather(dr.arange(mi.UInt32, n)), self.gather(n + dr.arange(mi.UInt32, len(self) - n))]

    def cut(self, n):
        """Each part of the curve in ``n`` shorter ones."""
        i = dr.arange(mi.UInt32, n * len(self))
        parts = self.gather(i // n)
        if parts.tau0 is None:
            parts.tau0, parts.tau1 = mi.Float(0), mi.Float(1)
        step = (parts.tau1 - parts.tau0) / n
        parts.tau0 = parts.tau0 + mi.Float(i % n) * step
        parts.tau1 = parts.tau0 + step
        return parts

    def __len__(self):
        return dr.width(self.segment)


def pairs_at(lane, leaf, index):
    """The pairs numbered ``index``: beam ``index % LEAF`` of the (segment, leaf) pair ``index // LEAF``."""
    if dr.width(index) == 0:
        return Pairs(index, index)
    place = index // bvh.LEAF
    return Pairs(lanes.gather(lane, place), lanes.gather(leaf, place) * bvh.LEAF + (index & (bvh.LEAF - 1)))


def candidates(beams, segments, lane, leaf, count):
    """Which (segment, beam) pairs of the first ``count`` (segment, leaf) pairs may have a zero of g.

    Returns ``beam.Zeros`` for each of ``LEAF * count`` pairs, numbered as in ``pairs_at``.
    """
    pairs = pairs_at(lane, leaf, dr.arange(mi.UInt32, count * bvh.LEAF))
    active = pairs.beam < dr.opaque(mi.UInt32, beams.count)
    x = triangle.gather_numbers(beams.records, pairs.beam, light_beam.BEAM, active)
    P, omega = light_beam.corners(x)
    zeros = light_beam.classify(P, omega, x[18], x[19], segments.gather(pairs.segment))
    zeros.possible &= active
    zeros.bracketed &= active
    return zeros

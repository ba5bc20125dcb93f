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
from .pairs import Reach, Taken


@dataclass
class Beams:
    """The light beams of one light in one body, and their tree.

    ``triangle_records``: the scene's; ``records``: flat, ``beam.BEAM`` numbers each; ``triangles``:
    parent triangle of each beam; ``proven_lit``: whether the whole beam is known to see the light.
    """

    triangle_records: object
    records: object
    triangles: object
    proven_lit: object
    tree: bvh.Tree
    width: float

    most_levels = tolerances.MAX_PAIR_SUBDIVISION
    """Levels to which beams are cut for single segments, besides those when they were made."""
    bundle = tolerances.BUNDLED
    """Camera segments that go through the tree together."""
    for_one_light = True
    """Made for one light point: knows the zeros of g before an estimator does, and proofs of visibility."""

    def node_test(self, segments, _light):
        """The conservative test of bundles of camera segments against a node of the tree, for ``bvh.traverse``."""
        return beam_tree.node_test(segments)

    def plausible(self, _pairs, _segment, _light):
        """Places of the leaves without a beam hold ``beam.nothing``."""
        return mi.Bool(True)

    def near(self, beam, bundles):
        """Which beams (indices) may have zeros of g for a segment of bundles, lane by lane."""
        piece = light_beam.unpack(triangle.gather_numbers(self.records, beam, light_beam.BEAM))
        low, high = mi.Float(tolerances.ENDLESS), mi.Float(-tolerances.ENDLESS)
        reach, far = mi.Float(0), mi.Float(0)
        for p, w in zip(piece.P, piece.omega):
            to = p - bundles.o
            across = dr.cross(to, bundles.d)
            g = dr.dot(w, across)
            low, high = dr.minimum(low, g), dr.maximum(high, g)
            reach, far = dr.maximum(reach, dr.squared_norm(across)), dr.maximum(far, dr.squared_norm(to))
        pad = dr.sqrt(far) * bundles.spread_d + bundles.spread_o
        bound = piece.bend * (dr.sqrt(reach) + pad) + piece.twist + pad
        return (piece.twist >= 0) & (low <= bound) & (high >= -bound)

    def triangle_of(self, pairs, active=True):
        """Indices of the pairs' triangles among the scene's records."""
        return dr.gather(mi.UInt32, self.triangles, pairs.beam, active)

    def take(self, pairs, light, active=True):
        """``Taken``: triangles, light beams and proofs for pairs."""
        x = triangle.gather_numbers(self.records, pairs.beam, light_beam.BEAM, active)
        tri = triangle.gather(self.triangle_records, self.triangle_of(pairs, active), active)
        piece = light_beam.unpack(x)
        reach = Reach(piece.u0, piece.v0, piece.h, x[23:26], *x[26:28])
        if pairs.code is not None:
            piece = light_beam.piece_at(tri, light, *pairs.place(piece.u0, piece.v0, piece.h))
        proven_lit = dr.gather(mi.Bool, self.proven_lit, pairs.beam, active)
        # Beams are cut when they are made until they are fine.
        return Taken(tri, piece, True, reach, proven_lit, mi.Bool(False))


def _lit(tri, light):
    """False only if no point of the triangle is lit: the facet turns away, or n . (L - P) < 0 throughout.

    The latter is a polynomial in (u, v), of which the largest Bernstein coefficient is a bound: these are means of the values for
    pairs of control points, for plane triangles one pair each.
    """
    points, n = tri.controls()
    a = [light.to(p) for p in points]
    top = dr.dot(n[0], a[0])
    for i in range(len(a)):
        for j in range(i, len(a)):
            top = dr.maximum(top, 0.5 * (dr.dot(n[i], a[j]) + dr.dot(n[j], a[i])))
    return (top > 0) & (dr.dot(tri.Ng, a[0]) > 0)


def _levels(tri, light, size, bend, proven_lit):
    """Subdivisions after which a beam is simple enough.

    Its bend is below ``bend`` times its width (both at the distance ``size``; per level the bend falls by 4, the
    width by 2), its edges and directions are within ``tolerances.NEAR`` and ``TURN``, and where a shadow may end on it
    within ``PARTLY_LIT``.
    """
    piece = light_beam.piece_at(tri, light, mi.Float(0), mi.Float(0), mi.Float(1))
    P, omega = piece.P, piece.omega
    width, deviation, longest = mi.Float(0), mi.Float(0), mi.Float(0)
    for i, (u, v) in enumerate(light_beam.MIDDLES):
        j, k = (i + 1) % 3, (i + 2) % 3
        edge = dr.norm(P[j] - P[k])
        longest = dr.maximum(longest, edge)
        _, middle, _ = light_beam.refracted(tri, u, v, light)
        deviation = dr.maximum(deviation, size * dr.norm(middle - 0.5 * (omega[j] + omega[k])))
        width = dr.maximum(width, edge + size * dr.norm(omega[j] - omega[k]))
    excess = dr.maximum(light_beam.excess(piece, light), deviation / dr.maximum(bend * width, 1e-30))
    excess = dr.maximum(excess, dr.select(proven_lit, 0, longest / (tolerances.PARTLY_LIT * size)))
    level = dr.ceil(dr.log2(dr.clip(excess, *tolerances.EXCESS)))
    return mi.UInt32(dr.clip(level, 0, tolerances.MAX_SUBDIVISION))


def order_of(body):
    """Triangles (UInt32, scene's numbering) of a body in the order in which the tree takes them."""
    return lanes.array(mi.UInt32, bvh.median_order(body.corners.mean(axis=1)) + body.first_record)


def build(body, scene_records, order, light, bend, seen, clear):
    """Light beams of ``light`` (``optics.Source``, one, body coordinates) in ``body``; None if none is lit. ``order``: ``order_of(body)``.

    ``seen(triangles) -> (kept, proven)``: which triangles the light may reach, as indices into the argument, and
    for each of these whether all of it is known to be lit. ``clear(tri, piece)``: the numbers of ``pairs.Reach``, or None
    where nothing is known of it.
    """
    place = dr.compress(_lit(triangle.gather(scene_records, order), light))
    lit = lanes.gather(order, place)
    if dr.width(lit) > 0:
        kept, proven = seen(lit)
        place, lit = lanes.gather(place, kept), lanes.gather(lit, kept)
    if dr.width(lit) == 0:
        return None
    size = dr.opaque(mi.Float, body.size)
    level = _levels(triangle.gather(scene_records, lit), light, size, dr.opaque(mi.Float, bend), proven)

    parent, code, level = _expand(level)
    parent, code, level, exists = _in_leaves(place, parent, code, level)
    u0, v0, h = light_beam.sub_triangle(code, level)
    index = dr.gather(mi.UInt32, lit, parent)
    proven = dr.gather(mi.Bool, proven, parent)
    count = dr.width(index)
    records = dr.empty(mi.Float, count * light_beam.BEAM)
    tri = triangle.gather(scene_records, index)
    piece = light_beam.nothing(light_beam.piece_at(tri, light, u0, v0, h), ~exists)
    reach = [mi.Float(0)] * 4 + [mi.Float(tolerances.ENDLESS)] if clear is None else clear(tri, piece)
    triangle.scatter_numbers(records, light_beam.numbers(piece, reach), dr.arange(mi.UInt32, count))
    width = float(dr.mean(dr.norm(h * tri.P_u))[0])
    dr.eval(records, index, proven)
    return Beams(scene_records, records, index, proven, beam_tree.build(records, count, body), width)


def _in_leaves(place, parent, code, level):
    """The beams such that each leaf holds those of ``bvh.LEAF`` places of the order at most: the nodes of the tree then bound the
    same places for every light. Returns ``parent``, ``code``, ``level`` for all places in leaves, and which of these hold a beam."""
    cell = place.numpy()[parent.numpy()] // bvh.LEAF
    count = np.bincount(cell)
    count = count[count > 0]
    room = -(-count // bvh.LEAF) * bvh.LEAF
    shift = np.cumsum(room - count) - (room - count)
    holds = np.zeros(room.sum(), dtype=bool)
    holds[np.arange(len(cell)) + np.repeat(shift, count)] = True
    beam = lanes.array(mi.UInt32, np.maximum(np.cumsum(holds) - 1, 0))
    return *(dr.gather(mi.UInt32, x, beam) for x in (parent, code, level)), lanes.array(mi.Bool, holds)


def _expand(level):
    """One entry per sub-triangle: index of its parent in ``level``, code, level. Neighbours in order are so in the triangle."""
    parent, number = lanes.repeat(4 ** level.numpy().astype(np.int64))
    level = dr.gather(mi.UInt32, level, parent)
    code = mi.UInt32(0)
    for k in range(tolerances.MAX_SUBDIVISION):  # the digits in reverse: the first one is that of the largest part
        code = dr.select(k < level, (code << 2) | ((number >> (2 * k)) & 3), code)
    return parent, code, level

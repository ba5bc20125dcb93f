"""Culling by light beams: which triangles refract light onto which camera segment, for a point light.

A triangle and the rays that its points refract make a *light beam*. Beams that bend too much are cut in
similar sub-triangles, so that the refracted direction is close to linear on each. A tree
over the beams (``beam_tree``) finds those that a camera segment may meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..geometry import bvh, triangle
from ..light import first_cells
from . import beam as light_beam
from . import beam_tree
from .clearance import estimate
from .light_beams import LightBeams
from .pairs import Reach, Taken
from .protocol import Culling


@dataclass
class Beams(Culling):
    """The light beams of one light in one body, and their tree.

    triangle_records  the packed triangles of the body, and maybe others
    records           Float, flat, ``beam.BEAM`` numbers per beam
    triangles         UInt32, index of each beam's triangle among the scene's records
    proven_lit        Bool, whether the whole beam is known to see the light
    tree              over the beams
    width             mean width of the beams, in units of the scene
    """

    triangle_records: mi.Float
    records: mi.Float
    triangles: mi.UInt32
    proven_lit: mi.Bool
    tree: bvh.Tree
    width: float

    most_levels = tolerances.MAX_PAIR_SUBDIVISION  # besides those when they were made
    bundle = tolerances.BUNDLED
    of_beams = LightBeams
    for_one_light = True

    @classmethod
    def of(cls, body, shadows, structures, drawn):
        """As ``Culling.of``. Beams of a light point that other renders may have, too, are made once."""
        if drawn or structures.scene.geometry is None or dr.width(shadows.light.L) > 1:
            return build(body, shadows, structures)
        return structures.beams(cls, lambda: build(body, shadows, structures), body, shadows)

    def node_test(self, segments, _incidence):
        """The conservative test of bundles of camera segments against a node of the tree, for ``bvh.traverse``."""
        return beam_tree.node_test(segments)

    def plausible(self, _pairs, _segment, _incidence):
        """Places of the leaves without a beam hold ``beam.nothing``."""
        return mi.Bool(True)

    def near(self, beam, bundles):
        """Which beams (UInt32, indices) may have zeros of g for a segment of ``Bundles``, lane by lane (Bool)."""
        piece = light_beam.unpack(triangle.gather_numbers(self.records, beam, light_beam.BEAM))
        low, high = mi.Float(tolerances.ENDLESS), mi.Float(-tolerances.ENDLESS)
        far_line, far = mi.Float(0), mi.Float(0)  # squared distances of the corners from line and origin
        for p, w in zip(piece.P, piece.omega):
            to = p - bundles.o
            across = dr.cross(to, bundles.d)
            g = dr.dot(w, across)
            low, high = dr.minimum(low, g), dr.maximum(high, g)
            far_line, far = dr.maximum(far_line, dr.squared_norm(across)), dr.maximum(far, dr.squared_norm(to))
        pad = dr.sqrt(far) * bundles.spread_d + bundles.spread_o
        bound = piece.bend * (dr.sqrt(far_line) + pad) + piece.twist + pad
        return (piece.twist >= 0) & (low <= bound) & (high >= -bound)

    def triangle_of(self, pairs, active=True):
        """Indices (UInt32) of the pairs' triangles among the scene's records."""
        return dr.gather(mi.UInt32, self.triangles, pairs.beam, active)

    def take(self, pairs, incidence, active=True):
        """``Taken``: triangles, light beams and proofs for pairs."""
        x = triangle.gather_numbers(self.records, pairs.beam, light_beam.BEAM, active)
        tri = triangle.gather(self.triangle_records, self.triangle_of(pairs, active), active)
        piece = light_beam.unpack(x)
        reach = Reach(piece.u0, piece.v0, piece.h, x[23:26], *x[26:28])
        if pairs.code is not None:
            piece = light_beam.piece_at(tri, incidence, *pairs.place(piece.u0, piece.v0, piece.h))
        proven_lit = dr.gather(mi.Bool, self.proven_lit, pairs.beam, active)
        # Beams are cut when they are made until they are fine.
        return Taken(tri, piece, True, reach, proven_lit, mi.Bool(False))


def _on_rim(tri, shadows):
    """Whether the light sends much more to some of the corners and the middle of triangles than to others."""
    if shadows.emission is None or not shadows.emission.has_rim:
        return mi.Bool(False)
    low, high = mi.Float(tolerances.ENDLESS), mi.Float(0)
    for P in (*tri.corners(), tri.position(1 / 3, 1 / 3)):
        sent = dr.max(mi.Spectrum(shadows.emission(P, *shadows.light.seen_from(P))))
        low, high = dr.minimum(low, sent), dr.maximum(high, sent)
    return low < tolerances.EVENLY_SENT * high


def _levels(tri, incidence, size, bend, proven_lit):
    """Subdivisions (UInt32) after which a beam is simple enough.

    tri         ``triangle.Triangle``, the whole beam's
    incidence   ``optics.Incidence`` of the light
    size        Float, of the body
    bend        Float, that of ``tolerances.Accuracy``
    proven_lit  Bool, whether no shadow ends on it

    Its bend is then below ``bend`` times its width, both at the distance ``size``: per level the bend falls by 4, the
    width by 2. Its edges and directions are within ``tolerances.NEAR`` and ``TURN``, and where a shadow may end on it
    within ``PARTLY_LIT``.
    """
    piece = light_beam.piece_at(tri, incidence, mi.Float(0), mi.Float(0), mi.Float(1))
    P, omega = piece.P, piece.omega
    width, deviation, longest = mi.Float(0), mi.Float(0), mi.Float(0)
    for i, (u, v) in enumerate(light_beam.MIDDLES):
        j, k = (i + 1) % 3, (i + 2) % 3
        edge = dr.norm(P[j] - P[k])
        longest = dr.maximum(longest, edge)
        _, middle, _ = light_beam.refracted(tri, u, v, incidence)
        deviation = dr.maximum(deviation, size * dr.norm(middle - 0.5 * (omega[j] + omega[k])))
        width = dr.maximum(width, edge + size * dr.norm(omega[j] - omega[k]))
    excess = dr.maximum(light_beam.excess(piece, incidence.light), deviation / dr.maximum(bend * width, 1e-30))
    excess = dr.maximum(excess, dr.select(proven_lit, 0, longest / (tolerances.PARTLY_LIT * size)))
    level = dr.ceil(dr.log2(dr.clip(excess, *tolerances.EXCESS)))
    return mi.UInt32(dr.clip(level, 0, tolerances.MAX_SUBDIVISION))


def build(body, shadows, structures):
    """``Beams`` of a light in a body; None if none of its triangles is lit.

    body        ``scene.boundaries.Body``
    shadows     ``visibility.Shadows`` of the light
    structures  ``Structures`` of the scene
    """
    scene_records, order, incidence = structures.scene.records, structures.order(body), shadows.incidence
    place = dr.compress(first_cells.faces_light(triangle.gather(scene_records, order), incidence.light))
    lit = arrays.gather(order, place)
    if dr.width(lit) > 0:
        seen, proven = shadows.seen(lit)
        place, lit = arrays.gather(place, seen), arrays.gather(lit, seen)
    if dr.width(lit) == 0:
        return None
    size, bend = (dr.opaque(mi.Float, x) for x in (body.size, structures.accuracy.bend))
    tri = triangle.gather(scene_records, lit)
    level = _levels(tri, incidence, size, bend, proven & ~_on_rim(tri, shadows))

    parent, code, level = _expand(level)
    parent, code, level, exists = _in_leaves(place, parent, code, level)
    u0, v0, h = light_beam.sub_triangle(code, level)
    index = dr.gather(mi.UInt32, lit, parent)
    proven = dr.gather(mi.Bool, proven, parent)
    count = dr.width(index)
    records = dr.empty(mi.Float, count * light_beam.BEAM)
    tri = triangle.gather(scene_records, index)
    piece = light_beam.nothing(light_beam.piece_at(tri, incidence, u0, v0, h), ~exists)
    reach = _reach(tri, piece, body, shadows, structures)
    triangle.scatter_numbers(records, light_beam.numbers(piece, reach), dr.arange(mi.UInt32, count))
    width = float(dr.mean(dr.norm(h * tri.P_u))[0])
    dr.eval(records, index, proven)
    return Beams(scene_records, records, index, proven, beam_tree.build(records, count, body), width)


def _reach(tri, piece, body, shadows, structures):
    """The numbers of ``pairs.Reach`` of beams."""
    if not shadows.may_prove_inside:
        return [mi.Float(0)] * 4 + [mi.Float(tolerances.ENDLESS)]
    if structures.accuracy.samples_visibility:
        return estimate(tri, piece, shadows)
    return structures.clearance(body).clear(piece)


def _in_leaves(place, parent, code, level):
    """The beams in an order such that each leaf holds those of ``bvh.LEAF`` places of the body's order at most.

    The nodes of the tree then bound the same places for every light.

    place   UInt32, of each triangle in the body's order
    parent  UInt32, index in ``place`` of each beam's triangle
    code    UInt32, sub-triangle of each beam
    level   UInt32, level of that

    Returns ``parent``, ``code``, ``level`` for all places in leaves, and which of these hold a beam (Bool).
    """
    cell = place.numpy()[parent.numpy()] // bvh.LEAF
    count = np.bincount(cell)
    count = count[count > 0]
    room = -(-count // bvh.LEAF) * bvh.LEAF
    shift = np.cumsum(room - count) - (room - count)
    holds = np.zeros(room.sum(), dtype=bool)
    holds[np.arange(len(cell)) + np.repeat(shift, count)] = True
    beam = arrays.array(mi.UInt32, np.maximum(np.cumsum(holds) - 1, 0))
    return *(dr.gather(mi.UInt32, x, beam) for x in (parent, code, level)), arrays.array(mi.Bool, holds)


def _expand(level):
    """One entry per sub-triangle: index of its parent in ``level``, code, level (UInt32).

    Neighbours in this order are neighbours in the triangle, too.
    """
    parent, number = arrays.repeat(4 ** level.numpy().astype(np.int64))
    level = dr.gather(mi.UInt32, level, parent)
    code = mi.UInt32(0)
    for k in range(tolerances.MAX_SUBDIVISION):  # the digits in reverse: the first one is that of the largest part
        code = dr.select(k < level, (code << 2) | ((number >> (2 * k)) & 3), code)
    return parent, code, level

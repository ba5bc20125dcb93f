"""Culling by light beams that are quadratic between their nodes (``light.beams``)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..geometry import bvh
from ..light import beams, coarse_mesh, first_cells, refinement
from . import beam_tree
from .pairs import Taken
from .protocol import Culling


@dataclass
class LightBeams(Culling):
    """The light beams of one light sample in one body, and their tree.

    records   Float, flat, ``beams.stride(more)`` numbers per beam
    tree      over the beams
    width     mean width of the beams, in units of the scene
    estimate  relative L1 error of the image that is expected
    slack     how much larger it may be than what the tolerance says
    apart     how far the quadratics' points may be from the boundary
    more      quadratics of a record besides those that each has (``beams.LightBeams``)
    looser    () -> list of ``LightBeams`` of larger errors, one for each of ``tolerances.LOOSER``
    """

    records: mi.Float
    tree: bvh.Tree
    width: float
    estimate: float
    slack: float = 1.0
    apart: float = 0.0
    more: int = 0
    looser: Callable = list

    bundle = tolerances.BUNDLED
    for_one_light = True
    most_levels = tolerances.MAX_PAIR_SUBDIVISION

    def parts(self, accuracy):
        """Parts of the curve in each of them that are summed by one point."""
        return tolerances.parts_along(dr.width(self.records) // beams.stride(self.more), accuracy.along * self.slack)

    @classmethod
    def of(cls, body, shadows, structures, drawn):
        """As ``Culling.of``. Beams of a light point that other renders may have, too, are made once: but where it sends
        more into some directions, which tells where cells are small."""

        def make():
            return _Maker(body, shadows, structures, drawn).make()

        if drawn or structures.scene.geometry is None or shadows.emission is not None:
            return make()
        return structures.beams(cls, make, body, shadows)

    def by_share(self):
        """As ``Culling.by_share``."""
        every = [self, *self.looser()]
        return [(0.0, self)] if len(every) == 1 else list(zip(tolerances.SHARES, every))

    def node_test(self, segments, _incidence):
        """The conservative test of bundles of camera segments against a node of the tree, for ``bvh.traverse``."""
        return beam_tree.node_test(segments)

    def plausible(self, _pairs, _segment, _incidence):
        """Places of the leaves without a beam have a negative radius."""
        return mi.Bool(True)

    def near(self, item, bundles):
        """Which beams (UInt32, indices) may have zeros of g for a segment of ``Bundles``, lane by lane (Bool)."""
        lines = beams.Lines.gather(self.records, item, more=self.more)
        pad = (dr.norm(bundles.o - lines.centre) + lines.radius) * bundles.spread_d + bundles.spread_o
        return lines.may_meet(bundles.o, bundles.d, pad * (1 + lines.d_omega))

    def triangle_of(self, _pairs, _active=True):
        """As ``Culling.triangle_of``: beams have none."""
        raise NotImplementedError

    def take(self, pairs, _incidence, active=True):
        """As ``Culling.take``; of beams the lines alone."""
        lines = beams.Lines.gather(self.records, pairs.beam, active, self.more)
        return Taken(None, lines, True, None, mi.Bool(True), mi.Bool(False))


class _Maker:
    """Makes ``LightBeams`` of one light sample in a body.

    body        ``scene.boundaries.Body``
    shadows     ``visibility.Shadows`` of the light
    structures  ``Structures`` of the scene
    drawn       as ``Culling.of`` has it
    """

    def __init__(self, body, shadows, structures, drawn):
        self.body, self.structures, self.drawn = body, structures, drawn
        self.slack = max(drawn, 1) ** 0.5
        most = float(np.linalg.norm(np.array(body.box_high) - np.array(body.box_low)))
        scene = structures.scene

        def tracing(domain):
            return refinement.Tracing(domain, shadows, body.size, most)

        self.facets = tracing(first_cells.Facets(scene.records, structures.order(body), shadows.light))
        mesh = None
        if structures.accuracy.coarse:
            mesh = structures.once("coarse", lambda: coarse_mesh.coarsest(body), body)
        self.sheets = None if mesh is None else tracing(first_cells.Sheets(scene, body, mesh))

    def make(self):
        """``LightBeams``; None if nothing is lit. Of many light samples each is for few segments: all take the same."""
        out = self._beams(1.0)
        if out is None or self.sheets is None or self.drawn:
            return out
        made = []

        def looser():
            if not made:
                made.extend(self._beams(x) or out for x in tolerances.LOOSER)
            return made

        out.looser = looser
        return out

    def _beams(self, factor):
        """``LightBeams`` whose error is below the tolerance times ``factor``; None if nothing is lit."""
        if len(self.facets.domain) == 0:
            return None
        slack = factor * self.slack
        cells, estimate, tracing = self._cells(slack * self.structures.accuracy.cells)
        return _of_cells(cells, tracing, (estimate, slack), self.body)

    def _cells(self, tolerance):
        """``Cells`` and their estimate: of the coarse mesh if these are few, else of facets; and the ``Tracing``. What
        is better for one of many light samples is so for all."""
        known, key = self.structures.fewer_facets, (self.body.key, tolerance)
        if self.sheets is not None and not (self.drawn and key in known):
            most = tolerances.FEWER_CELLS * len(self.facets.domain)
            cells, estimate = refinement.refine(self.sheets, tolerance, most)
            if cells is not None:
                return cells, estimate, self.sheets
            known.add(key)
        return *refinement.refine(self.facets, tolerance, None), self.facets


def _of_cells(cells, tracing, errors, body):
    """``LightBeams`` of the leaves of ``Cells``; None if none is lit. ``errors``: ``estimate`` and ``slack``."""
    chosen = np.flatnonzero(cells.leaf & cells.lit)
    if len(chosen) == 0:
        return None
    index = arrays.array(mi.UInt32, chosen)
    _, middle = tracing.domain.edges()
    middle = dr.gather(mi.Vector3f, middle, dr.gather(mi.UInt32, cells.first, index)).numpy().T
    order = chosen[bvh.median_order(middle)]
    room = -(-len(order) // bvh.LEAF) * bvh.LEAF  # every place in a leaf holds a record
    order = np.concatenate([order, np.full(room - len(order), order[-1])])
    exists = dr.arange(mi.UInt32, room) < dr.opaque(mi.UInt32, len(chosen))
    records = dr.empty(mi.Float, room * beams.BEAM)
    beams.write(records, tracing.packed(cells, arrays.array(mi.UInt32, order), exists), 0, room)
    dr.eval(records)
    tree = beam_tree.tree_of(len(chosen), lambda index: bounds(beams.LightBeams.gather(records, index), body))
    return LightBeams(records, tree, float(cells.size[chosen].mean()), *errors, float(cells.apart[chosen].max()))


def bounds(beam, body):
    """``beam_tree.Bounds`` of single beams: the Bezier control points of all that is quadratic hold it."""
    omega, m, e, length = (beams.control(x) for x in (beam.omega, beam.m, beam.e, beam.length))
    P = beams.control([beams.start(*x) for x in zip(beam.omega, beam.m, beam.e)])
    skew = mi.Float(0)
    for p, w, x in zip(P, omega, m):
        skew = dr.maximum(skew, dr.norm(x - dr.cross(p, w)))
    P = [p + beam.centre for p in P]
    columns = beam_tree.linear_model(P, omega)
    low, high = bvh.box(P)
    c = 0.5 * (low + high)
    rest = bvh.box([w - beam_tree.times(columns, p - c) for p, w in zip(P, omega)])
    longest = mi.Float(0)
    for x in length:
        longest = dr.maximum(longest, x)
    box = bvh.box(P + [p + longest * w for p, w in zip(P, omega)])
    wall_low, wall_high = (dr.opaque(mi.Vector3f, x) for x in (body.box_low, body.box_high))
    box = dr.maximum(box[0] - skew, wall_low), dr.minimum(box[1] + skew, wall_high)
    return beam_tree.Bounds(low, high, *columns, *rest, *box, mi.Float(1), skew)

"""Light beams behind all chains of refractions and reflections of one light sample: one tree for each region."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..geometry import bvh
from ..light import beams, coarse_mesh, first_cells, refinement
from ..light.chain_tracing import ChainTracing, Sent
from ..light.chains import REFLECTED, THROUGH, Chain, Surroundings, first_boundaries
from ..scene.media import visible
from . import beam_tree
from .light_beams import LightBeams, bounds


@dataclass
class Walls:
    """How far light beams of a region go, as ``light_beams.bounds`` asks: three floats each, relative to ``centre``."""

    centre: list[float]
    box_low: list[float]
    box_high: list[float]


@dataclass
class _Family:
    """Light behind one chain.

    tracing  ``ChainTracing``
    cells    ``refinement.Cells``, the first ones
    flux     float, of what comes to regions that scatter
    onward   float, of what comes to boundaries behind
    """

    tracing: ChainTracing
    cells: refinement.Cells
    flux: float
    onward: float


def of(structures, sample, bounces, accuracy, drawn):
    """``{index of a region: LightBeams}`` of a ``LightSample``; places are relative to the centre of the region's
    ``walls``.

    structures  ``Structures`` of the scene
    bounces     int, how many events besides a first refraction are followed
    accuracy    ``tolerances.Accuracy``
    drawn       as ``Culling.of`` has it
    """
    maker = _Maker(structures, sample, (bounces, accuracy), drawn)
    out = maker.beams(1.0)
    if not drawn:
        for index, one in out.items():
            one.looser = lambda index=index, one=one: [maker.beams(x).get(index, one) for x in tolerances.LOOSER]
    return out


def walls(scene, region):
    """``Walls`` of a region of a ``Scene``."""
    if region.body is not None:
        return Walls(region.body.centre, region.body.box_low, region.body.box_high)
    low, high = scene.box()
    centre = np.float64(np.float32(0.5 * (low + high)))
    reach = region.visible_range or 0.0
    return Walls(centre.tolist(), (low - centre - reach).tolist(), (high - centre + reach).tolist())


class _Maker:
    """Makes the light beams of chains.

    structures, sample, drawn  as ``of`` has them
    limits                     bounces and accuracy, as ``of`` has them
    """

    def __init__(self, structures, sample, limits, drawn):
        bounces, accuracy = limits
        self.structures, self.sample = structures, sample
        self.scene = structures.scene
        self.around = Surroundings(self.scene, bounces)
        self.slack = max(drawn, 1) ** 0.5
        self.asked, self.coarse = accuracy.cells * self.slack, accuracy.coarse
        low, high = self.scene.box()
        self.far = float(np.linalg.norm(high - low))
        self.families, self.total, self.made = None, 0.0, {}

    def beams(self, factor):
        """As ``of``, for errors larger by a ``factor``; without ``looser``."""
        if factor not in self.made:
            self.made[factor] = self._beams(factor)
        return self.made[factor]

    def _beams(self, factor):
        if self.families is None:
            self.families, self.total = self._families()
        if not self.families:
            return {}
        shares = np.array([one.flux / self.total for one in self.families])
        # Errors of chains are independent, and fall with the power 1.5 of the number of cells: so these are fewest.
        loose = shares**-0.75 / np.sum(shares**0.5) ** 0.5 / tolerances.CANCELS
        loose = np.minimum(factor * self.asked * loose, tolerances.WEAKEST)
        parts, error = {}, 0.0
        for one, tolerance in zip(self.families, loose):
            tracing, cells, estimate = self._refined(one, float(tolerance))
            error += estimate * one.flux
            self._pack(tracing, cells, parts)
        brought = sum(one.flux for one in self.families)
        out = {index: self._joined(index, some, factor) for index, some in parts.items()}
        for one in out.values():
            one.most_levels, one.estimate = tolerances.levels(error / brought), tolerances.CANCELS * error / brought
        return out

    def _refined(self, family, tolerance):
        """``(ChainTracing, Cells, estimate)`` of a family: of a coarse mesh if these are few, else of facets."""
        tracing = family.tracing
        if isinstance(tracing.domain, first_cells.Sheets):
            facets = self._facets(tracing.first_boundary)
            most = max(tolerances.FEWER_CHAIN_CELLS * len(facets), 2 * len(family.cells))
            cells, estimate = refinement.refine(tracing, tolerance, most, family.cells.copy(), evenly=False)
            if cells is not None:
                return tracing, cells, estimate
            tracing = self._tracing(facets, tracing.first_boundary, tracing.chain)
            return tracing, *refinement.refine(tracing, tolerance, None, self._first(tracing), evenly=False)
        return tracing, *refinement.refine(tracing, tolerance, None, family.cells.copy(), evenly=False)

    def _families(self):
        """List of ``_Family`` that bring light to regions that scatter, and the flux (float) of these and of first
        refractions that are summed elsewhere."""
        waiting, found, incident, total = [], [], 0.0, 0.0
        for first in first_boundaries(self.scene):
            domain = self._domain(first)
            if len(domain) == 0:
                continue
            for choice in first.choices:
                family = self._family(domain, first, Chain((choice,)))
                incident += family.flux + family.onward
                waiting.append(family)
        least = tolerances.LOST * self.asked * incident
        while waiting:
            family = waiting.pop(0)
            chain = family.tracing.chain
            computed = chain.choices == (THROUGH,) and self._is_computed(family.tracing.first_boundary)
            total += family.flux
            if family.flux > least and not computed:
                found.append(family)
            if family.onward > least and len(chain.choices) < tolerances.CHAIN_SURFACES:
                waiting += [
                    self._family(family.tracing.domain, family.tracing.first_boundary, chain.then(choice))
                    for choice in (THROUGH, REFLECTED)
                ]
        return found, total

    def _is_computed(self, first):
        """Whether the first refraction is summed without chains."""
        regions = self.scene.regions
        return any(
            body.shape is first.body.shape and body.inside == first.behind
            for region in regions for body in region.boundaries
        )  # fmt: skip

    def _domain(self, first):
        """First cells: of a coarse mesh where there is one."""
        mesh = None
        if self.coarse and first.side > 0 and first.body.refracts:
            mesh = self.structures.once("coarse", lambda: coarse_mesh.coarsest(first.body), first.body)
        return self._facets(first) if mesh is None else first_cells.Sheets(self.scene, first.body, mesh)

    def _facets(self, first):
        light = self.sample.local(dr.opaque(mi.Point3f, first.body.centre))
        return first_cells.Facets(self.scene.records, self.structures.order(first.body), light, first.side)

    def _family(self, domain, first, chain):
        tracing = self._tracing(domain, first, chain)
        cells = self._first(tracing)
        return _Family(tracing, cells, float(cells.flux[cells.leaf].sum()), tracing.onward(cells))

    def _tracing(self, domain, first, chain):
        centre = dr.opaque(mi.Point3f, first.body.centre)
        light, emission = self.sample.local(centre), self.sample.emission(centre, visible())
        return ChainTracing(domain, Sent(light, emission, first, self.around), chain, self.far)

    def _first(self, tracing):
        """``Cells`` to begin with."""
        cells = tracing.first()
        if len(self.scene.bodies) + len(self.scene.others) == 1:
            return cells
        size = tolerances.CHAIN_CELL * tracing.first_boundary.body.size
        return refinement.no_larger(tracing, cells, size, unlit=True)

    def _pack(self, tracing, cells, parts):
        """Adds the beams of cells to ``parts``: {region: list of (numbers, middles, number of further
        quadratics, width)}."""
        lit = np.flatnonzero(cells.leaf & cells.lit)
        if len(lit) == 0:
            return
        labels = tracing.labels(cells, lit)
        mixed = cells.mixed.numpy()[lit]
        new = np.ones_like(labels, dtype=bool)
        for k in range(1, labels.shape[1]):
            new[:, k] = (labels[:, :k] != labels[:, k : k + 1]).all(axis=1)
        new &= labels >= refinement.FREE
        first = np.argmax(labels >= refinement.FREE, axis=1)
        new &= mixed[:, None] | (np.arange(labels.shape[1]) == first[:, None])
        cell, reference = np.nonzero(new)
        chosen, reference = arrays.array(mi.UInt32, lit[cell]), arrays.array(mi.UInt32, reference)
        centre = np.array(tracing.first_boundary.body.centre)
        regions = tracing.regions(cells, chosen, reference)
        for index in np.unique(regions):
            some = arrays.array(mi.UInt32, np.flatnonzero(regions == index))
            shift = (centre - np.array(walls(self.scene, self.scene.regions[index]).centre)).tolist()
            P, numbers = tracing.packed_of(
                cells, arrays.gather(chosen, some), arrays.gather(reference, some), dr.opaque(mi.Point3f, shift)
            )
            middle = (P[0] + P[1] + P[2]) / 3
            numbers = [x + dr.zeros(mi.Float, dr.width(some)) for x in numbers]
            dr.eval(middle, numbers)
            parts.setdefault(int(index), []).append((numbers, middle.numpy().T, tracing.more, cells.size[lit].mean()))

    def _joined(self, index, parts, factor):
        """``LightBeams`` of all beams in a region."""
        each, middles, mores, widths = zip(*parts)
        numbers, middle = [arrays.concat(x) for x in zip(*each)], np.concatenate(middles)
        more, width = mores[0], float(np.average(widths, weights=[len(x) for x in middles]))
        count = len(middle)
        order = bvh.median_order(middle)
        room = -(-count // bvh.LEAF) * bvh.LEAF
        place = arrays.array(mi.UInt32, np.concatenate([order, np.full(room - count, order[-1])]))
        numbers = [dr.gather(mi.Float, x, place) for x in numbers]
        exists = dr.arange(mi.UInt32, room) < dr.opaque(mi.UInt32, count)
        numbers[beams.RADIUS] = dr.select(exists, numbers[beams.RADIUS], beams.NOTHING)
        records = dr.empty(mi.Float, room * beams.stride(more))
        beams.write(records, numbers, 0, room)
        dr.eval(records)
        edge = walls(self.scene, self.scene.regions[index])
        tree = beam_tree.tree_of(count, lambda i: bounds(beams.LightBeams.gather(records, i, more=more), edge))
        return LightBeams(records, tree, width, slack=factor * self.slack, more=more)

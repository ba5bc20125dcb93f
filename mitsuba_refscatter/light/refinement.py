"""Which cells light beams are made of: the largest errors are cut until what is left is below the tolerance.

Each cell is asked at nine further nodes, those that its quarters need. What the quadratic through its six nodes says
there is wrong by

    e = flux min(1, 2 |dx| / width + (|mean dphi| + |dphi| / 4) / phi + |dlength| / length),

means over the nine nodes, with dx the distance of light lines, at their start, middle or end, whichever is worst, and
the width of the beam there. Of a cell on which light is stopped by different things, or not at all, a quarter counts
as wrong. The sum of e over that of the flux estimates the relative L1 error of the image.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import optics, tolerances
from ..core import arrays
from ..geometry import triangle
from . import beams
from .beams import NODES, mix, weights

FURTHER = tuple((i / 4, j / 4) for j, i in ((j, i) for j in range(5) for i in range(5 - j)) if i % 2 == 1 or j % 2 == 1)
"""(u, v) of the nine further nodes."""

LATTICE = (*NODES, *FURTHER)
QUARTERS = ((0.0, 0.0, 0.5), (0.5, 0.0, 0.5), (0.0, 0.5, 0.5), (0.5, 0.5, -0.5))
"""Corner and signed size of a cell's quarters in its (u, v)."""

OF_QUARTER = np.array([[LATTICE.index((u0 + h * u, v0 + h * v)) for u, v in NODES] for u0, v0, h in QUARTERS])
"""Which of a cell's fifteen nodes are those of its quarters, (4, 6)."""

NODE = 12
"""Numbers of a node: P, omega, phi, length, label, whether light comes there, how much of it is sent, and one more."""

UNLIT, DARK, FREE = 0, 1, 2
"""Labels: no light comes there, which no shadow is to blame for; a shadow or total reflection; the first of what stops
light."""


@dataclass
class Cells:
    """Cells that have been looked at; arrays of Dr.Jit, and of NumPy where a choice depends on them.

    first      UInt32, the first cell that it is a part of
    u0, v0, h  Float, corner and signed size of the part
    nodes      Float, flat, fifteen of ``Tracing.numbers`` numbers per cell
    wrong      Float, how wrong lines and flux are, relative: the first of e
    error      (N,) e
    flux       (N,) of light of intensity 1
    lit        (N,) whether light comes anywhere, if it is sent there
    share      Float, part of it that gets in
    mixed      Bool, whether the nodes' labels differ
    edge       (N,) whether they do, or the boundary has kinks that cutting does not mend
    size       (N,) longest edge, units of the scene
    apart      (N,) how far the quadratic's points are from the boundary
    leaf       (N,) whether it is not cut
    """

    first: mi.UInt32
    u0: mi.Float
    v0: mi.Float
    h: mi.Float
    nodes: mi.Float
    wrong: mi.Float | None = None
    error: np.ndarray = field(default_factory=lambda: np.zeros(0))
    flux: np.ndarray = field(default_factory=lambda: np.zeros(0))
    lit: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    share: mi.Float | None = None
    mixed: mi.Bool | None = None
    edge: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    size: np.ndarray = field(default_factory=lambda: np.zeros(0))
    apart: np.ndarray = field(default_factory=lambda: np.zeros(0))
    leaf: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def __len__(self):
        return dr.width(self.first)

    def copy(self):
        """The same, to be cut."""
        return replace(self, leaf=self.leaf.copy())

    def joined(self, other):
        """These and others."""
        out = {}
        for name, x in vars(self).items():
            y = getattr(other, name)
            out[name] = np.concatenate([x, y]) if isinstance(x, np.ndarray) else arrays.concat([x, y])
        return Cells(**out)


class Tracing:
    """Light of one sample on the cells of a boundary.

    domain   ``first_cells.Facets`` or ``Sheets``
    shadows  ``visibility.Shadows`` of the light sample
    far      float, how far light goes that matters, units of the scene
    most     float, how far it goes where nothing stops it

    ``numbers``: of a node, ``NODE`` and those that only this kind of light has.
    """

    numbers = NODE

    def __init__(self, domain, shadows, far, most):
        self.domain, self.shadows, self.emission = domain, shadows, shadows.emission
        self.lengths_differ = shadows.inside is not None
        self.far, self.most = (dr.opaque(mi.Float, x) for x in (far, most))

    def first(self):
        """All first cells."""
        n = len(self.domain)
        u0, v0, h, before = (dr.opaque(mi.Float, x, n) for x in (0, 0, 1, tolerances.ENDLESS))
        cells = Cells(dr.arange(mi.UInt32, n), u0, v0, h, dr.empty(mi.Float, n * len(LATTICE) * self.numbers))
        dr.make_opaque(cells.first)
        self._trace(cells, 0)
        return self._judge(cells, before)

    def quarters(self, cells, chosen):
        """The quarters of the ``chosen`` (UInt32) of cells."""
        n = 4 * dr.width(chosen)
        i = dr.arange(mi.UInt32, n)
        parent, quarter = dr.gather(mi.UInt32, chosen, i // 4), i & 3
        first = dr.gather(mi.UInt32, cells.first, parent)
        u0, v0, h = (dr.gather(mi.Float, x, parent) for x in (cells.u0, cells.v0, cells.h))
        du, dv, dh = (_pick(quarter, x) for x in zip(*QUARTERS))
        out = Cells(first, u0 + h * du, v0 + h * dv, h * dh, dr.empty(mi.Float, n * len(LATTICE) * self.numbers))
        dr.eval(out.first, out.u0, out.v0, out.h)
        for k in range(len(NODES)):
            source = parent * len(LATTICE) + _pick(quarter, [int(x) for x in OF_QUARTER[:, k]], mi.UInt32)
            triangle.scatter_numbers(
                out.nodes, triangle.gather_numbers(cells.nodes, source, self.numbers), i * len(LATTICE) + k
            )
        dr.eval(out.nodes)
        self._trace(out, len(NODES))
        before = dr.gather(mi.Float, cells.wrong, parent)
        dr.eval(before)  # so that first cells and quarters take the same kernel
        return self._judge(out, before)

    def _trace(self, cells, begin):
        """Traces the nodes of cells from number ``begin`` on."""
        several, begin = (dr.opaque(mi.UInt32, x) for x in (len(LATTICE) - begin, begin))
        i = dr.arange(mi.UInt32, int(several[0]) * len(cells))
        cell, node = i // several, i % several + begin
        u, v = (dr.gather(mi.Float, arrays.array(mi.Float, x), node) for x in zip(*LATTICE))
        u0, v0, h = (dr.gather(mi.Float, x, cell) for x in (cells.u0, cells.v0, cells.h))
        at = self.domain.points(
            dr.gather(mi.UInt32, cells.first, cell), dr.fma(h, u, u0), dr.fma(h, v, v0), (u0 + h / 3, v0 + h / 3)
        )
        triangle.scatter_numbers(cells.nodes, self._node(at), cell * len(LATTICE) + node)
        dr.eval(cells.nodes)

    def _node(self, at):
        """The numbers of nodes at ``Points``."""
        shadows, incidence = self.shadows, self.shadows.incidence
        omega_L, d_L = incidence.light.seen_from(at.P)
        omega, c_L, c_V = optics.refract_in(omega_L, at.n, incidence.eta)
        phi = optics.transmission(c_L, c_V, incidence.eta) * dr.abs(dr.dot(omega, at.Ng)) * at.area / dr.square(d_L)
        phi = dr.select(at.found & (dr.dot(omega_L, at.Ng) > 0) & (dr.dot(omega, at.Ng) < 0), phi, 0)
        comes = optics.inside_cosine2(c_L, incidence.eta) > 0
        if shadows.lit is not None:
            comes &= shadows.lit(at.start, at.Ng, shadows.light.L, phi > 0)
        length, stop = self.most, mi.UInt32(0)
        if shadows.inside is not None:
            length, stop = shadows.stop(at.start, at.Ng, omega, self.most)
        label = dr.select(
            ~at.found,
            mi.Float(DARK),
            dr.select(phi > 0, dr.select(comes, mi.Float(FREE + stop), mi.Float(DARK)), mi.Float(UNLIT)),
        )
        comes, length = dr.select(comes, mi.Float(1), 0), length + mi.Float(0)
        return [*at.P, *omega, phi, length, label, comes, self._sent(at.P, omega_L, d_L), mi.Float(0)]

    def _sent(self, P, omega_L, d_L):
        """What the light sends to P (Float), relative to one that sends the same everywhere."""
        if self.emission is None:
            return mi.Float(1)
        return dr.max(mi.Spectrum(self.emission(P, omega_L, d_L)))

    def nodes(self, cells, chosen, which):
        """List of ``Node``: those of the numbers ``which`` of the ``chosen`` (UInt32) of cells."""
        return [Node.gather(cells.nodes, chosen * len(LATTICE) + k, self.numbers) for k in which]

    def _judge(self, cells, before):
        """Cells with their errors; ``before``: how ``wrong`` those are that they were cut from.

        Where cutting does not help, neighbouring facets differ by more than the surface bends. Then light goes astray
        to all sides, and less is wrong where several beams and places are added up.
        """
        n = len(cells)
        i = dr.arange(mi.UInt32, n)
        nodes = self.nodes(cells, i, range(len(LATTICE)))
        six, nine = nodes[: len(NODES)], nodes[len(NODES) :]
        wrong, d_length = self._error(six, nine)
        kinks = wrong > tolerances.NO_BETTER * before
        error = wrong * dr.select(kinks, tolerances.SCATTERED, 1) + d_length
        cells.wrong, low, high = wrong, mi.Float(tolerances.ENDLESS), mi.Float(0)
        comes, lit, sent = mi.Float(0), mi.Float(0), mi.Float(0)
        for x in nodes:
            low = dr.minimum(low, dr.select(x.label == UNLIT, tolerances.ENDLESS, x.label))
            high = dr.maximum(high, x.label)
            lit += x.phi
            comes += x.phi * x.comes
            sent += x.phi * x.sent
        cells.mixed = (low < high) & (high > UNLIT)
        cells.share = dr.select(lit > 0, comes / dr.maximum(lit, 1e-30), 0)
        flux = dr.square(cells.h) * sent / (2 * len(LATTICE))
        error = flux * dr.select(cells.mixed, tolerances.MIXED, dr.minimum(error, 1))
        error = dr.select(cells.share > 0, error, 0)
        longest, _ = self.domain.edges()
        size = dr.gather(mi.Float, longest, cells.first) * dr.abs(cells.h)
        flux, lit, apart = flux * cells.share, cells.share > 0, _apart(six, nine)
        found = flux, error, size, apart
        edge = cells.mixed | kinks
        dr.eval(found, lit, edge, cells.mixed, cells.share, cells.wrong)
        cells.flux, cells.error, cells.size, cells.apart = (x.numpy().astype(np.float64) for x in found)
        cells.lit, cells.edge = lit.numpy().copy(), edge.numpy().copy()
        cells.leaf = np.ones(n, dtype=bool)
        return cells

    def _error(self, six, nine):
        """What stands in e: of lines and flux, and of lengths (Float)."""
        centre = six[0].P
        m, omega = [dr.cross(x.P - centre, x.omega) for x in six], [x.omega for x in six]
        phi, length = [x.phi * x.sent for x in six], [x.length for x in six]
        apart, d_length, all_length = [mi.Float(0)] * 3, mi.Float(0), mi.Float(0)
        d_phi, bias, all_phi = mi.Float(0), mi.Float(0), mi.Float(0)
        for (u, v), x in zip(FURTHER, nine):
            w = weights(u, v)
            there_m, there_omega, here = mix(w, m), mix(w, omega), x.phi * x.sent
            for k in range(3):
                X = x.P - centre + 0.5 * k * dr.minimum(x.length, self.far) * x.omega
                apart[k] = apart[k] + here * dr.norm(there_m - dr.cross(X, there_omega))
            wrong = mix(w, phi) - here
            d_phi, bias = d_phi + dr.abs(wrong), bias + wrong
            d_length += here * dr.abs(mix(w, length) - x.length)
            all_phi += here
            all_length += here * x.length
        width = mi.Float(0)
        for k in range(3):
            X = [x.P + 0.5 * k * dr.minimum(x.length, self.far) * x.omega for x in six[:3]]
            for a, b in ((0, 1), (1, 2), (2, 0)):
                width = dr.maximum(width, dr.norm(dr.cross(X[a] - X[b], six[a].omega)))
        worst = dr.maximum(dr.maximum(apart[0], apart[1]), apart[2])
        total = dr.maximum(all_phi, 1e-30)
        error = tolerances.ASTRAY * worst / (total * dr.maximum(width, 1e-30))
        error += (tolerances.SCATTERED * d_phi + dr.abs(bias)) / total
        return error, d_length / dr.maximum(all_length, 1e-30) if self.lengths_differ else mi.Float(0)

    def packed(self, cells, chosen, exists):
        """The numbers of records (``beams.pack``) of the ``chosen`` (UInt32) of cells; ``exists``: which count."""
        nodes = self.nodes(cells, chosen, range(len(NODES)))
        mixed = dr.gather(mi.Bool, cells.mixed, chosen)
        scale = dr.square(dr.gather(mi.Float, cells.h, chosen)) * dr.select(
            mixed, dr.gather(mi.Float, cells.share, chosen), 1
        )
        length = [x.length for x in nodes]
        for k in range(3):
            length[3 + k] = dr.select(mixed, 0.5 * (length[k] + length[(k + 1) % 3]), length[3 + k])
        return beams.pack(
            [x.P for x in nodes], [x.omega for x in nodes], [scale * x.phi for x in nodes], length, exists
        )


def _apart(six, nine):
    """How far the starts of the light lines of cells are from the boundary (Float)."""
    centre, out = six[0].P, mi.Float(0)
    m, omega = [dr.cross(x.P - centre, x.omega) for x in six], [x.omega for x in six]
    e = [dr.dot(x.P - centre, x.omega) for x in six]
    for (u, v), x in zip(FURTHER, nine):
        w = weights(u, v)
        start = beams.start(mix(w, omega), mix(w, m), mix(w, e))
        out = dr.maximum(out, dr.norm(start + centre - x.P))
    return out


@dataclass
class Node:
    """Nodes, lane by lane: body coordinates, see ``NODE``. ``more``: list of Float, all numbers after ``sent``."""

    P: mi.Vector3f
    omega: mi.Vector3f
    phi: mi.Float
    length: mi.Float
    label: mi.Float
    comes: mi.Float
    sent: mi.Float
    more: list[mi.Float]

    @classmethod
    def gather(cls, nodes, index, count):
        """Those at ``index`` (UInt32); ``count``: of their numbers."""
        x = triangle.gather_numbers(nodes, index, count)
        return cls(mi.Vector3f(x[:3]), mi.Vector3f(x[3:6]), *x[6:11], x[11:])


def _pick(number, values, kind=None):
    """Of four values that with a ``number`` (UInt32)."""
    kind = kind or mi.Float
    out = kind(values[0])
    for k in range(1, 4):
        out = dr.select(number == k, kind(values[k]), out)
    return out


def refine(tracing, tolerance, most, cells=None, evenly=True):
    """``(Cells, estimate)``: cells whose leaves are good for a relative error ``tolerance`` of the image, and the error
    that is expected. ``most``: leaves, at most; None where they are more. ``cells``: to begin with, if not the first
    ones; ``evenly``: whether no part of the light may be far worse than the rest."""
    cells = tracing.first() if cells is None else cells
    if tracing.emission is not None and tracing.emission.has_rim:
        cells = no_larger(tracing, cells, tolerances.RIM_CELL * float(tracing.far[0]))
    while True:
        alive = np.flatnonzero(cells.leaf & (cells.error > 0))
        total, error = cells.flux[cells.leaf].sum(), cells.error[alive].sum()
        wanted = tolerance * total
        can = alive[cells.size[alive] > tolerances.LEAST_CELL * float(tracing.far[0])]
        left = cells.error[can].sum()
        # What can't be cut any more takes no more than its share of what is allowed.
        poor = _poor(cells, can, tolerance) if evenly else can[:0]
        if len(poor) == 0 and (error <= wanted or left <= tolerances.LEFT_OF_ERROR * wanted):
            return cells, _relative(error, total)
        order = can[np.argsort(-cells.error[can])]
        enough = np.searchsorted(np.cumsum(cells.error[order]), left - tolerances.LEFT_OF_ERROR * wanted) + 1
        chosen = poor if error <= wanted else np.union1d(order[:enough], poor)
        if most is not None and cells.leaf.sum() + 3 * len(chosen) > most:
            return None, _relative(error, total)
        if len(cells) + 4 * len(chosen) > tolerances.MOST_CELLS:
            return cells, _relative(error, total)
        cells.leaf[chosen] = False
        cells = cells.joined(tracing.quarters(cells, arrays.array(mi.UInt32, chosen)))


def _poor(cells, can, tolerance):
    """Those of the cells ``can`` (numbers) whose error per area is too large where they are small parts of all, too;
    but shadows' edges and kinks, which stay."""
    lit = cells.leaf & cells.lit
    density = cells.flux[lit].sum() / max((cells.size[lit] ** 2).sum(), 1e-30)
    high = cells.error[can] > tolerances.LOCAL * tolerance * density * cells.size[can] ** 2
    return can[high & ~cells.edge[can]]


def _relative(error, total):
    """The error relative to the flux; 0 where nothing is lit."""
    return float(error / total) if total > 0 else 0.0


def no_larger(tracing, cells, size, unlit=False):
    """``Cells`` that are cut where they are lit and larger than ``size``, so that no light goes between their nodes.
    ``unlit``: whether others are cut, too."""
    while True:
        chosen = np.flatnonzero(cells.leaf & (cells.lit | unlit) & (cells.size > size))
        if len(chosen) == 0 or len(cells) + 4 * len(chosen) > tolerances.MOST_CELLS:
            return cells
        cells.leaf[chosen] = False
        cells = cells.joined(tracing.quarters(cells, arrays.array(mi.UInt32, chosen)))

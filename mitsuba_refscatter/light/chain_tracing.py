"""What *tracing* finds of light behind a chain at the nodes of cells on its first boundary.

With c the cosines of shading normals and Ng facets' normals, the flux density behind a chain is

    phi = |omega_L . Ng| |P_u x P_v| / d_L^2 prod (1 - F or F) kappa,
    kappa = c_in |omega_out . Ng| / (c_out |omega_in . Ng|),

per area in (u, v) on the first boundary, where P_u and P_v are. It stays smooth where light lines cross (Walter et al.
2009 divide by the area of the cross-section instead, which vanishes there).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import optics, tolerances
from ..core import arrays
from ..scene.media import visible
from ..transport import crossing
from ..transport.transmittance import BLOCKED
from . import beams
from .chains import REFLECTED, FirstBoundary, Surroundings
from .refinement import DARK, FREE, LATTICE, NODE, NODES, Node, Tracing

REGION, ONWARD, START = 0, 1, 2
"""Places among the further numbers of a node: 1 + the region of the last leg (0: none that counts), how much of the
light comes to a boundary behind it, and where its way began, three numbers. After these the optical depths."""


@dataclass
class Sent:
    """Light of one sample towards a first boundary.

    light     ``optics.LocalLight`` in the boundary's coordinates
    emission  what it sends, by direction (``LightSample.emission``), or None where that is the same everywhere
    first     ``FirstBoundary``
    around    ``Surroundings``
    """

    light: optics.LocalLight
    emission: Callable | None
    first: FirstBoundary
    around: Surroundings


@dataclass
class State:
    """Light on its way, lane by lane.

    o       Point3f, world, just off where the leg starts
    d       Vector3f, unit
    P       Vector3f, where it starts, relative to the first boundary's centre
    region  UInt32, around it
    phi     Float, flux density
    depth   Spectrum, optical depth so far
    label   UInt32, tells chains from others
    events  UInt32, that count
    alive   Bool
    """

    o: mi.Point3f
    d: mi.Vector3f
    P: mi.Vector3f
    region: mi.UInt32
    phi: mi.Float
    depth: mi.Spectrum
    label: mi.UInt32
    events: mi.UInt32
    alive: mi.Bool


class ChainTracing(Tracing):
    """Light of one sample behind one chain.

    domain  as of ``Tracing``
    sent    ``Sent``
    chain   ``Chain``
    far     float, how far light goes that matters, units of the scene
    """

    lengths_differ = True

    def __init__(self, domain, sent, chain, far):
        self.domain, self.chain, self.far = domain, chain, dr.opaque(mi.Float, far)
        self.light, self.emission, self.first_boundary, self.around = vars(sent).values()
        self.bits, self.steps = dr.opaque(mi.UInt32, chain.bits), dr.opaque(mi.UInt32, len(chain.choices))
        self.centre = dr.opaque(mi.Point3f, self.first_boundary.body.centre)
        self.eta = dr.opaque(mi.Float, self.first_boundary.eta)
        self.spectrum = len(dr.zeros(mi.Spectrum)) if self.around.coloured else 0
        self.numbers = -(-(NODE - 1 + START + 3 + self.spectrum) // 4) * 4

    @property
    def more(self):
        """Number of quadratics of a beam's record besides those that each has."""
        return self.spectrum + (0 if self.emission is None else 3)

    def _node(self, at):
        """As ``Tracing._node``."""
        omega_L, d_L = self.light.seen_from(at.P)
        state = self._enter(at, omega_L, d_L)
        lit, left = self._arrives(at, omega_L, d_L, state.phi > 0)
        state.depth = state.depth - dr.log(dr.maximum(left, tolerances.BLACK))
        # Where the boundary faces away light lines go on, so that cells at the edge of what is lit are smooth.
        dark = (state.phi > 0) & ~lit
        state.alive = state.alive & at.found
        state = self._follow(state)
        hit, length, here = self._meet(state)
        scatters, most = self.around.follows(here)
        endless = most > 0
        arrives = hit.valid | endless
        length = dr.select(endless, dr.minimum(dr.select(hit.valid, length, dr.inf), most), length)
        length = dr.select(arrives, length, 0)
        covered = state.events <= self.around.bounces
        comes = state.alive & arrives & scatters & covered & ~dark
        on = state.alive & ~dark & hit.valid & self._may_go_on(hit, state)
        stop = _mixed(state.label, dr.select(hit.valid, dr.reinterpret_array(mi.UInt32, hit.pi.shape) + 1, 0))
        stop = _mixed(stop, here)
        label = dr.select(comes, FREE + mi.Float(stop & 0x3FFFFF), DARK)
        sent = self._sent(at.P, omega_L, d_L) * dr.exp(-dr.mean(state.depth))
        out = [*state.P, *state.d, dr.select(comes, state.phi, 0), length, label]
        out += [dr.select(comes, mi.Float(1), 0), sent]
        out += [dr.select(comes, mi.Float(here + 1), 0), dr.select(on, state.phi * sent, 0), *at.P]
        out += [*state.depth] if self.spectrum else []
        return out + [mi.Float(0)] * (self.numbers - len(out))

    def _enter(self, at, omega_L, d_L):
        """``State`` behind the first boundary."""
        first, reflected = self.first_boundary, self.chain.choices[0] == REFLECTED
        through, c_L, c_V = optics.refract_in(omega_L, at.n, self.eta)
        total = optics.inside_cosine2(c_L, self.eta) <= 0
        what, value, width = "specular_transmittance", mi.Spectrum(1), dr.width(c_L)
        omega, share = through, optics.transmission(c_L, c_V, self.eta)
        if reflected:
            what, omega = "specular_reflectance", optics.reflect(-omega_L, at.n)
            share, _ = optics.fresnel(dr.clip(c_L, 0, 1), self.eta)
            share = optics.twice(share) if first.body.kind == "thin" else share
        if first.is_mirror:
            share, value, total = mi.Float(1), self._mirrored(at, omega_L), mi.Bool(False)
        side = dr.dot(omega, at.Ng)
        phi = share * dr.abs(side) * at.area / dr.square(d_L)
        right = (side > 0) if reflected else (side < 0)
        phi = dr.select((dr.dot(omega_L, at.Ng) > 0) & (c_L > 0) & right, phi, 0)
        off = dr.opaque(mi.Float, tolerances.CAMERA_OFFSET * first.body.extent)
        factor = dr.maximum(first.body.tint(what, visible()) * value, tolerances.BLACK)
        region = dr.opaque(mi.UInt32, first.before if reflected else first.behind)
        return State(
            o=mi.Point3f(at.start) + at.Ng * dr.copysign(off, side) + self.centre,
            d=mi.Vector3f(omega),
            P=mi.Vector3f(at.P),
            region=region + dr.zeros(mi.UInt32, width),
            phi=phi,
            depth=-dr.log(factor) + dr.zeros(mi.Spectrum, width),
            label=_mixed(dr.zeros(mi.UInt32, width), dr.select(total, mi.UInt32(1), 0)),
            events=dr.full(mi.UInt32, int(reflected), width),
            alive=dr.full(mi.Bool, True, width) & (mi.Bool(reflected) | ~total),
        )

    def _mirrored(self, at, omega_L):
        """What a mirror leaves (Spectrum) of light that comes to ``Points`` on it."""
        off = dr.opaque(mi.Float, tolerances.MIRROR_OFFSET * self.first_boundary.body.extent)
        ray = mi.Ray3f(mi.Point3f(at.start) + omega_L * off + self.centre, -omega_L)
        scene = self.around.scene
        hit = crossing.trace(scene, ray.o, ray.d)
        met = hit.valid & scene.is_mirror(hit.pi.shape)
        return dr.select(met, crossing.mirrored(scene, hit.pi, ray, visible())[2], 0)

    def _arrives(self, at, omega_L, d_L, active):
        """Whether light comes to ``Points`` of the first boundary (Bool), and what is left of it (Spectrum)."""
        body = self.first_boundary.body
        start = mi.Point3f(at.start) + at.Ng * dr.opaque(mi.Float, tolerances.SHADOW_OFFSET * body.extent) + self.centre
        distance = tolerances.ENDLESS if self.light.distant else d_L * (1 - tolerances.SHADOW_END)
        before = dr.opaque(mi.UInt32, self.first_boundary.before)
        left, crossed = self.around.transmittance.follow(start, omega_L, distance, before, active)
        return crossed != BLOCKED, left

    def _follow(self, state):
        """``State`` behind all choices but the first."""
        names = [field.name for field in fields(State)]

        def step(i, *values):
            now = self._event(State(**dict(zip(names, values))), (dr.opaque(mi.UInt32, 1) & (self.bits >> i)) > 0)
            return (i + 1, *(getattr(now, name) for name in names))

        state = dr.while_loop(
            (mi.UInt32(1), *(getattr(state, name) for name in names)),
            lambda i, *values: (i < self.steps) & values[-1],
            step,
            label="chain",
            mode="symbolic",
        )
        return State(**dict(zip(names, state[1:])))

    def _meet(self, state):
        """What light meets next (``crossing.Hit``), how far it is, and the region on the way."""
        scene = self.around.scene
        hit = crossing.trace(scene, state.o, state.d, state.alive)
        here = dr.select(hit.boundary, hit.near, state.region)
        return hit, dr.select(hit.valid, hit.pi.t, 0), here

    def _event(self, state, reflects):
        """``State`` behind what light meets next; ``reflects`` (Bool): whether it is reflected there."""
        scene = self.around.scene
        hit, length, here = self._meet(state)
        at = crossing.cross(scene, state.d, hit)
        d = mi.Vector3f(dr.select(reflects, at.reflected, at.refracted))
        n, Ng = hit.tri.normal(*hit.uv), hit.tri.Ng
        c_in, c_out = dr.abs(dr.dot(state.d, n)), dr.abs(dr.dot(d, n))
        g_in, g_out = dr.dot(state.d, Ng), dr.dot(d, Ng)
        share = dr.select(reflects, at.F, 1 - at.F)
        right = hit.boundary & (share > 0) & (c_out > 0) & (dr.select(reflects, -g_in, g_in) * g_out > 0)
        kappa = c_in * dr.abs(g_out) / dr.maximum(c_out * dr.abs(g_in), 1e-30)
        through, back = (
            hit.tint(scene.bodies, what, visible()) for what in ("specular_transmittance", "specular_reflectance")
        )
        leaves = crossing.depart(scene, hit, d)
        centre = dr.gather(mi.Point3f, scene.centre, hit.target, hit.boundary)
        shape = dr.select(hit.valid, dr.reinterpret_array(mi.UInt32, hit.pi.shape) + 1, 0)
        out = State(
            o=leaves.origin,
            d=d,
            P=mi.Vector3f(hit.tri.position(*hit.uv) + (centre - self.centre)),
            region=leaves.region,
            phi=dr.select(right, state.phi * share * kappa, 0),
            depth=-dr.log(dr.maximum(dr.select(reflects, back, through), tolerances.BLACK)),
            label=_mixed(state.label, 2 * shape + dr.select(at.F >= 1, mi.UInt32(1), 0)),
            events=state.events + dr.select(reflects | ~scene.lets_pass(hit), mi.UInt32(1), 0),
            alive=state.alive & right,
        )
        if scene.mirrors is not None:
            self._reflect(state, hit, reflects, out)
        out.depth = out.depth + state.depth + self.around.along(state.d, here, length)
        return out

    def _reflect(self, before, hit, reflects, after):
        """Changes the state ``after`` where what is met is a mirror."""
        scene = self.around.scene
        mirror = hit.valid & scene.is_mirror(hit.pi.shape)
        origin, d, value = crossing.mirrored(scene, hit.pi, mi.Ray3f(before.o, before.d), visible())
        after.o, after.d = dr.select(mirror, origin, after.o), dr.select(mirror, d, after.d)
        after.P = dr.select(mirror, mi.Vector3f(origin - self.centre), after.P)
        after.region = dr.select(mirror, before.region, after.region)
        after.phi = dr.select(mirror, before.phi, after.phi)
        after.depth = dr.select(mirror, -dr.log(dr.maximum(value, tolerances.BLACK)), after.depth)
        after.alive = dr.select(mirror, before.alive & reflects & (dr.max(value) > 0), after.alive)

    def _may_go_on(self, hit, state):
        """Whether what is met may send light on that is followed (Bool)."""
        scene, more = self.around.scene, state.events < self.around.bounces
        on = hit.boundary & (more | scene.lets_pass(hit))
        return on if scene.mirrors is None else on | (hit.valid & more & scene.is_mirror(hit.pi.shape))

    def onward(self, cells):
        """The flux that comes to boundaries behind the last legs of leaves (float)."""
        chosen = arrays.array(mi.UInt32, np.flatnonzero(cells.leaf))
        h = dr.gather(mi.Float, cells.h, chosen)
        nodes = self.nodes(cells, chosen, range(len(LATTICE)))
        total = mi.Float(0)
        for x in nodes:
            total += x.more[ONWARD]
        return float(dr.sum(total * dr.square(h))[0]) / (2 * len(LATTICE))

    def labels(self, cells, chosen):
        """Labels of the nodes of cells (NumPy, numbers), (N, nodes)."""
        nodes = self.nodes(cells, arrays.array(mi.UInt32, chosen), range(len(LATTICE)))
        return np.stack([x.label.numpy() for x in nodes], axis=1)

    def regions(self, cells, chosen, reference):
        """Index of the region (NumPy) that the light of nodes comes to. ``chosen``, ``reference``: as of
        ``packed_of``."""
        node = Node.gather(cells.nodes, chosen * len(LATTICE) + reference, self.numbers)
        return node.more[REGION].numpy().astype(int) - 1

    def packed_of(self, cells, chosen, reference, shift):
        """Where cells' light starts, six Vector3f, and the numbers of records (``beams.pack``).

        chosen     UInt32, which cells
        reference  UInt32, which of their nodes tells the label; others take its direction where theirs differs
        shift      Point3f, the first boundary's centre relative to that of the records
        """
        every = self.nodes(cells, chosen, range(len(LATTICE)))
        mixed = dr.gather(mi.Bool, cells.mixed, chosen)
        it = every[0]
        for k in range(1, len(LATTICE)):
            it = _select(reference == k, every[k], it)
        flux = mi.Float(0)
        for x in every:
            flux += dr.select(x.label == it.label, x.phi, 0)
        h2 = dr.square(dr.gather(mi.Float, cells.h, chosen))
        nodes = []
        for x in every[: len(NODES)]:
            same = ~mixed | (x.label == it.label)
            moved = _moved(it, x)
            nodes.append(_select(same, x, moved))
        # Of mixed ones, and where a quadratic is far off, what is known is linear.
        linear = mixed | (dr.gather(mi.Float, cells.wrong, chosen) > tolerances.NO_QUADRATIC)
        for k in range(3):
            nodes[3 + k] = _select(linear, _middle(nodes[k], nodes[(k + 1) % 3]), nodes[3 + k])
        phi = [h2 * dr.select(linear, flux / len(LATTICE), x.phi) for x in nodes]
        more = [[x.more[START + 3 + k] for x in nodes] for k in range(self.spectrum)]
        if self.emission is not None:
            more += [[x.more[START + k] for x in nodes] for k in range(3)]
        P = [x.P + mi.Vector3f(shift) for x in nodes]
        return P, beams.pack(P, [x.omega for x in nodes], phi, [x.length for x in nodes], mi.Bool(True), more)


def _mixed(label, number):
    """A label (UInt32) with one more number."""
    return mi.sample_tea_32(label, number)[0]


def _select(mask, a, b):
    """A node for either case."""
    out = {name: dr.select(mask, x, getattr(b, name)) for name, x in vars(a).items() if name != "more"}
    return type(a)(**out, more=[dr.select(mask, x, y) for x, y in zip(a.more, b.more)])


def _moved(it, x):
    """The node ``it`` where the way of ``x`` began, its light parallel."""
    out = _select(mi.Bool(True), it, it)
    start = [a - b for a, b in zip(x.more[START : START + 3], it.more[START : START + 3])]
    out.P = it.P + mi.Vector3f(start)
    out.more[START : START + 3] = x.more[START : START + 3]
    return out


def _middle(a, b):
    """A node half-way between two."""
    out = {name: 0.5 * (x + getattr(b, name)) for name, x in vars(a).items() if name != "more"}
    return type(a)(**out, more=[0.5 * (x + y) for x, y in zip(a.more, b.more)])

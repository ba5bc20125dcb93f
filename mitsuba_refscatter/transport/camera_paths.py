"""From camera rays to the chain of segments inside bodies, with weights.

Each camera ray is followed through the boundaries and mirrors that it meets. A hit with a boundary splits it into
the reflected and the refracted leg, both deterministically; each part in a region that scatters is a segment
along which single scattering is collected. A leg goes on while it had at most ``internal_bounces`` internal
reflections and as many hits from outside (and of mirrors) after the first. Weights hold Fresnel factors, the
change of radiance by the index of refraction (1/eta^2 going in, eta^2 going out) and the attenuation in media.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..core import arrays
from ..core.arrays import NONE
from ..scene import Scene
from . import crossing
from .camera_refusals import refuse_other_medium, refuse_overlaps
from .segments import CameraSegments
from .transmittance import Transmittance


@dataclass
class Legs:
    """Rays on their way, world coordinates.

    o            Point3f
    d            Vector3f, unit
    weight       Spectrum, what a unit of radiance at the origin is worth to the camera sample
    sample       UInt32, the camera sample
    region       UInt32, the region around, or NONE
    reflections  UInt32, number of internal reflections so far
    entries      UInt32, number of hits from outside so far
    depth        UInt32, edges before this one, those through boundaries that do not refract not counted
    back         Vector3f, from the origin, rounded in world coordinates, to the point where the leg starts
    """

    o: mi.Point3f
    d: mi.Vector3f
    weight: mi.Spectrum
    sample: mi.UInt32
    region: mi.UInt32
    reflections: mi.UInt32
    entries: mi.UInt32
    depth: mi.UInt32
    back: mi.Vector3f

    def gather(self, index):
        """Those at ``index`` (UInt32)."""
        return arrays.gather_record(self, index)

    def __len__(self):
        return dr.width(self.sample)


@dataclass
class Paths:
    """What a set of camera rays meets.

    parts    per region a list of ``CameraSegments``, those of each step of the chains
    ends     list of ``Legs`` that reach a plain surface or escape; their weight includes the way there
    dropped  list of ``Legs`` that the chain does not follow, some of them: these stand for all
    hit      Bool per camera ray, whether it hits anything
    """

    parts: list
    ends: list
    dropped: list
    hit: mi.Bool

    def segments(self, region):
        """``CameraSegments`` in a ``Region``, or None where there are none."""
        parts = self.parts[region.index]
        return CameraSegments.concat(parts) if parts else None


@dataclass
class ChainLimits:
    """How far camera rays are followed.

    internal_bounces  number of internal reflections, and of hits from outside after the first
    surfaces          whether their ends at plain surfaces are wanted
    least_weight      legs of less are dropped
    seed              of the choice which dropped legs go on as sampled paths
    """

    internal_bounces: int
    surfaces: bool
    least_weight: float
    seed: int = 0


@dataclass
class _Walk:
    """One step of following camera rays: the ``scene``, the camera's ``ray``, the ``limits``, the ``paths`` found
    so far, whether legs that leave a body may bring something, if only by entering one ``again``, and its number
    among the steps."""

    scene: Scene
    ray: mi.Ray3f
    limits: ChainLimits
    paths: Paths
    again: bool
    step: int = 0

    @property
    def first(self):
        """Whether the camera's own rays are followed."""
        return self.step == 0

    def counted(self, counts):
        """1 where a hit counts towards the number of hits from outside, which the first one never does; else 0."""
        return mi.UInt32(0) if self.first else dr.select(counts, mi.UInt32(1), mi.UInt32(0))


def trace(scene, ray, active, start, limits):
    """``Paths`` of camera rays.

    scene   ``scene.Scene``
    ray     mi.Ray3f
    active  Bool, which of them are followed
    start   index of the region in which they start, or NONE
    limits  ``ChainLimits``
    """
    n = dr.width(ray)
    legs = Legs(
        mi.Point3f(ray.o) + dr.zeros(mi.Point3f, n), ray.d, mi.Spectrum(1) + dr.zeros(mi.Spectrum, n),
        dr.arange(mi.UInt32, n), dr.opaque(mi.UInt32, start, n), dr.zeros(mi.UInt32, n), dr.zeros(mi.UInt32, n),
        dr.zeros(mi.UInt32, n), dr.zeros(mi.Vector3f, n),
    )  # fmt: skip
    if not isinstance(active, bool) or not active:
        legs = legs.gather(dr.compress(mi.Bool(active) & dr.full(mi.Bool, True, n)))
    paths = Paths([[] for _ in scene.regions], [], [], dr.zeros(mi.Bool, n))
    if not scene.splits:
        paths.ends = [legs] if limits.surfaces and len(legs) > 0 else []
        return paths
    walk = _Walk(scene, ray, limits, paths, _may_enter_again(scene, limits))
    while len(legs) > 0:
        legs = _advance(walk, legs)
        walk.step += 1
    return paths


def _may_enter_again(scene, limits):
    """Whether legs that leave a body may still bring something, if only by entering one again."""
    alone = len(scene.bodies) == 1 and scene.bodies[0].convex and scene.mirrors is None
    around = any(body.outside != NONE and scene.regions[body.outside].scatters for body in scene.bodies)
    passing = any(body.eta == 1 for body in scene.bodies)  # such hits don't count
    return around or ((limits.internal_bounces > 0 or passing) and (limits.surfaces or not alone))


def _advance(walk, legs):
    """Takes all legs to their next hit; records segments and ends; returns the legs that go on."""
    scene, paths = walk.scene, walk.paths
    hit, elsewhere = _meet(scene, legs, walk.first)
    mirror = mi.Bool(False) if scene.mirrors is None else hit.valid & scene.is_mirror(hit.pi.shape)
    if walk.first:
        dr.scatter(paths.hit, hit.valid, legs.sample)
    refuse_overlaps(scene, legs, hit, elsewhere)
    if walk.first:
        refuse_other_medium(scene, legs, hit, elsewhere)
    after = _make_up(scene, legs, hit, elsewhere)
    length = dr.select(hit.valid, hit.pi.t, tolerances.ENDLESS)
    transmittance = Transmittance(scene, arrays.of(walk.ray.wavelengths, legs.sample))
    left = transmittance.along(legs.d, legs.region, length)
    arriving = replace(legs, weight=legs.weight * after * left)
    dr.eval(arriving, legs.weight, legs.region)

    _record(walk, legs, hit.valid, length)
    if walk.limits.surfaces:
        # Mirrors that the chain does not follow are surfaces like others.
        followed = hit.boundary | (mirror & (_entries_at_mirror(walk, arriving) <= walk.limits.internal_bounces))
        ends = dr.compress(dr.select(hit.valid, ~followed, dr.max(arriving.weight) > 0))
        if dr.width(ends) > 0:
            paths.ends.append(arriving.gather(ends))
    on = _split(walk, arriving, hit)
    if scene.mirrors is not None:
        on += _reflected(walk, arriving, hit.pi, mirror)
    return arrays.concat_records(on) if on else legs.gather(dr.zeros(mi.UInt32, 0))


def _meet(scene, legs, first):
    """``crossing.Hit`` of all legs, and which of them (Bool) meet a boundary from a region that it is not next
    to. Those, and those that meet nothing inside of a closed body, have slipped through an edge unseen, or bodies
    touch there: they are traced again slightly aside."""

    def elsewhere(hit):
        other = hit.boundary & (hit.near != legs.region)
        dr.eval(hit.pi, hit.target, hit.valid, hit.boundary, hit.leaving, hit.near, other)  # the rays are traced once
        return other

    hit = crossing.trace(scene, legs.o, legs.d, coherent=first)
    other = elsewhere(hit)
    slipped = dr.compress(other | (~hit.valid & scene.enclosed(legs.region)))
    if dr.width(slipped) == 0:
        return hit, other
    hit = crossing.retrace(scene, legs.o, legs.d, hit, slipped)
    return hit, elsewhere(hit)


def _make_up(scene, legs, hit, elsewhere):
    """Corrects the weight and region of legs that meet a boundary from another region (``elsewhere``) than that
    on its near side. What the crossing that was missed does to radiance is made up for: before this leg, or after
    it where its body touches the one that is met. Returns the factor for after it."""
    behind = scene.missed_behind(legs.region, hit.target, hit.leaving, elsewhere)
    factor = scene.squared_index(legs.region) / scene.squared_index(hit.near)
    legs.weight = dr.select(behind, legs.weight * factor, legs.weight)
    legs.region = dr.select(behind, hit.near, legs.region)
    return dr.select(elsewhere & ~behind, factor, 1)


def _record(walk, legs, valid, length):
    """Adds the parts of legs in regions that scatter to the segments."""
    for region in walk.scene.regions:
        if region.scatters:
            inside = dr.compress((legs.region == region.index) & (True if region.visible_range else valid))
            if dr.width(inside) > 0:
                s, t = legs.gather(inside), dr.gather(mi.Float, length, inside)
                t = dr.minimum(t, dr.opaque(mi.Float, region.visible_range)) if region.visible_range else t
                found = CameraSegments(
                    origin=s.o,
                    offset=s.back,
                    direction=s.d,
                    length=t,
                    region=region.index,
                    weight=s.weight,
                    sample=s.sample,
                    wavelengths=arrays.of(walk.ray.wavelengths, s.sample),
                    share=dr.full(mi.Float, 1, len(s)),
                )
                walk.paths.parts[region.index].append(found)


def _split(walk, legs, hit):
    """The reflected and the refracted legs behind a hit with a boundary, as a list of ``Legs``."""
    scene, limits = walk.scene, walk.limits
    at = crossing.cross(scene, legs.d, hit)
    wavelengths = arrays.of(walk.ray.wavelengths, legs.sample)
    # Where nothing is reflected the ray does not branch: such hits don't count.
    entries = legs.entries + walk.counted(~hit.leaving & (at.eta != 1))
    reflections = legs.reflections + dr.select(hit.leaving, mi.UInt32(1), mi.UInt32(0))
    active, out = hit.boundary & (entries <= limits.internal_bounces), []
    for d, factor, mirrored, what in (
        (at.reflected, at.F, True, "specular_reflectance"),
        (at.refracted, (1 - at.F) * at.shift, False, "specular_transmittance"),
    ):
        start = crossing.depart(scene, hit, d)
        weight = legs.weight * factor * hit.tint(scene.bodies, what, wavelengths)
        # Radiance inside is eta^2 smaller in these units; legs are compared as they would be outside.
        importance = dr.max(weight) * dr.select(start.goes_in, dr.square(at.eta), 1)
        goes_on = active & (importance > limits.least_weight)
        if mirrored:
            goes_on &= reflections <= limits.internal_bounces
        if not limits.surfaces:
            goes_on &= start.goes_in | mi.Bool(walk.again)
        passes = False if mirrored else scene.lets_pass(hit)
        on = Legs(
            o=start.origin, d=mi.Vector3f(d), weight=weight, sample=legs.sample, region=start.region,
            reflections=reflections if mirrored else legs.reflections, entries=entries,
            depth=legs.depth + dr.select(passes, mi.UInt32(0), 1), back=start.back,
        )  # fmt: skip
        if limits.surfaces:
            _drop(walk, on, importance, hit.boundary & ~goes_on, 2 * walk.step + mirrored)
        index = dr.compress(goes_on)
        if dr.width(index) > 0:
            out.append(on.gather(index))
    return out


def _drop(walk, legs, importance, dropped, number):
    """Keeps some of the legs that the chain does not follow, by Russian roulette: those that are left bring as much
    as all."""
    n = len(legs)
    q = dr.minimum(importance, 1)
    u = mi.sample_tea_float32(dr.arange(mi.UInt32, n), dr.opaque(mi.UInt32, walk.limits.seed + number))
    kept = dr.compress(dropped & (u < q))
    if dr.width(kept) > 0:
        some = replace(legs, weight=legs.weight / dr.maximum(q, 1e-30)).gather(kept)
        dr.eval(some)
        walk.paths.dropped.append(some)


def _entries_at_mirror(walk, legs):
    """Numbers of hits from outside (UInt32) of legs that meet a mirror, that one included."""
    return legs.entries + walk.counted(True)


def _reflected(walk, legs, pi, mirror):
    """The legs behind a hit with a mirror; a list of at most one ``Legs``."""
    entries = _entries_at_mirror(walk, legs)
    met = dr.compress(mirror & (entries <= walk.limits.internal_bounces))
    if dr.width(met) == 0:
        return []
    legs, entries, pi = legs.gather(met), arrays.gather(entries, met), dr.gather(type(pi), pi, met)
    ray = mi.Ray3f(legs.o, legs.d)
    ray.time = arrays.of(walk.ray.time, legs.sample)
    origin, d, value = crossing.mirrored(walk.scene, pi, ray, arrays.of(walk.ray.wavelengths, legs.sample))
    on = replace(
        legs,
        o=origin,
        d=d,
        weight=legs.weight * value,
        entries=entries,
        depth=legs.depth + mi.UInt32(1),
        back=dr.zeros(mi.Vector3f, dr.width(d)),
    )
    dr.eval(on)  # the mirrors are asked once
    brings = dr.max(on.weight)
    if walk.limits.surfaces:
        _drop(walk, on, brings, brings <= walk.limits.least_weight, 2 * walk.step)
    index = dr.compress(brings > walk.limits.least_weight)
    return [on.gather(index)] if dr.width(index) > 0 else []

"""From camera rays to the chain of segments inside bodies, with weights.

Each camera ray is followed through the boundaries and mirrors that it meets. A hit with a boundary splits it into the
reflected and the refracted leg, both deterministically; each part in a region that scatters is a segment along which single
scattering is collected. A leg goes on while it had at most ``internal_bounces`` internal reflections and
as many hits from outside (and of mirrors) after the first. Weights hold Fresnel factors, the change of radiance by the
index of refraction (1/eta^2 going in, eta^2 going out) and the attenuation in media.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from . import lanes, optics, tolerances
from .geometry import triangle
from .scene import NONE, holds, hole_refusal, refusal, side_refusal
from .transport.segments import CameraSegments


@dataclass
class Legs:
    """Rays on their way (world coordinates): origin, direction, weight, camera sample, region around (or
    NONE), numbers of internal reflections and of hits from outside so far; and the way
    ``back`` from the origin, rounded in world coordinates, to the point where the leg starts."""

    o: object
    d: object
    weight: object
    sample: object
    region: object
    reflections: object
    entries: object
    back: object

    def map(self, f):
        return Legs(*(f(x) for x in self.__dict__.values()))

    def gather(self, index):
        return self.map(lambda x: dr.gather(type(x), x, index))

    def __len__(self):
        return dr.width(self.sample)


@dataclass
class Paths:
    """What a set of camera rays meets.

    ``parts``: per region a list of ``CameraSegments``, those of each step of the chains;
    ``ends``: ``Legs`` that reach a plain surface or escape (their weight includes the way there);
    ``direct``: whether the first of these are the camera rays that meet no boundary or mirror; ``hit``: per camera ray, whether
    it hits anything.
    """

    parts: list
    ends: list
    direct: bool
    hit: object

    def segments(self, region):
        """``CameraSegments`` in a ``Region``, or None where there are none."""
        parts = self.parts[region.index]
        return CameraSegments.concat(parts) if parts else None


def trace(scene, ray, active, start, internal_bounces, surfaces, min_weight):
    """Follows the camera rays. ``scene``: ``scene.Scene``; ``ray``: mi.Ray3f; ``start``: index of the region in which they
    start, or NONE; legs whose weight falls below ``min_weight`` are dropped. ``surfaces``: whether ends are wanted.
    Returns ``Paths``."""
    n = dr.width(ray)
    legs = Legs(
        mi.Point3f(ray.o) + dr.zeros(mi.Point3f, n), ray.d, mi.Spectrum(1) + dr.zeros(mi.Spectrum, n),
        dr.arange(mi.UInt32, n), dr.opaque(mi.UInt32, start, n), dr.zeros(mi.UInt32, n), dr.zeros(mi.UInt32, n),
        dr.zeros(mi.Vector3f, n),
    )  # fmt: skip
    if not isinstance(active, bool) or not active:
        legs = legs.gather(dr.compress(mi.Bool(active) & dr.full(mi.Bool, True, n)))
    paths = Paths([[] for _ in scene.regions], [], False, dr.zeros(mi.Bool, n))
    # Legs that leave a body may still bring something, if only by entering one again.
    alone = len(scene.bodies) == 1 and scene.bodies[0].convex and scene.mirrors is None
    around = any(body.outside != NONE and scene.regions[body.outside].scatters for body in scene.bodies)
    passing = any(body.eta == 1 for body in scene.bodies)  # such hits don't count
    again = around or ((internal_bounces > 0 or passing) and (surfaces or not alone))
    first = True
    while len(legs) > 0:
        legs = _advance(scene, ray, legs, paths, first, internal_bounces, surfaces, again, min_weight)
        first = False
    return paths


def _advance(scene, ray, legs, paths, first, internal_bounces, surfaces, again, min_weight):
    """Takes all legs to their next hit; records segments and ends; returns the legs that go on."""
    met = _meet(scene, legs, first)
    pi, hit, target, boundary, leaving, here, other = (
        getattr(met, name) for name in ("pi", "hit", "target", "boundary", "leaving", "here", "other")
    )
    mirror = mi.Bool(False) if scene.mirrors is None else hit & scene.is_mirror(pi.shape)
    if first:
        dr.scatter(paths.hit, hit, legs.sample)
    _refuse_overlaps(scene, legs, pi.t, target, other)
    if first:
        _refuse_other_medium(scene, legs, met)
    after = _make_up(scene, legs, target, leaving, here, other)
    sigma_t, within = mi.Spectrum(0), legs.region != NONE
    wavelengths = lanes.of(ray.wavelengths, legs.sample)
    for region in scene.regions:
        if region.medium is not None:
            sigma_t = dr.select(legs.region == region.index, region.coefficients(wavelengths, legs.d)[1], sigma_t)
    length = dr.select(hit, pi.t, tolerances.ENDLESS)
    arriving = Legs(
        **{**legs.__dict__, "weight": legs.weight * after * dr.exp(-sigma_t * dr.select(within, length, 0))}
    )
    dr.eval(arriving, legs.weight, legs.region)

    _record(scene, legs, ray.wavelengths, hit, length, paths)
    if surfaces:
        kept = dr.compress(dr.select(hit, ~boundary & ~mirror, dr.max(arriving.weight) > 0))
        if dr.width(kept) > 0:
            paths.ends.append(arriving.gather(kept))
            paths.direct |= first
    split = _split(
        scene,
        arriving,
        wavelengths,
        pi,
        met.tri,
        target,
        boundary,
        leaving,
        internal_bounces,
        again,
        surfaces,
        first,
        min_weight,
    )
    if scene.mirrors is not None:
        split += _reflected(scene, arriving, ray, pi, mirror, internal_bounces, min_weight, first)
    if not split:
        return legs.gather(dr.zeros(mi.UInt32, 0))
    return Legs(*(lanes.concat(x) for x in zip(*(legs.__dict__.values() for legs in split))))


@dataclass
class Met:
    """What legs meet next: Mitsuba's preliminary intersection; whether there is one; the body (or NONE), and whether it is one; the triangle of it;
    whether it is met from its inside; the region ``here``, on its near side; and whether that is an ``other`` one than that of the leg."""

    pi: object
    hit: object
    target: object
    boundary: object
    tri: object
    leaving: object
    here: object
    other: object

    @staticmethod
    def of(scene, legs, pi):
        hit = pi.is_valid()
        target = scene.find(pi.shape)
        boundary = target != NONE
        index = dr.select(boundary, dr.gather(mi.UInt32, scene.first_record, target, boundary) + pi.prim_index, 0)
        tri = triangle.gather(scene.records, index, boundary)
        leaving = boundary & (dr.dot(legs.d, tri.Ng) > 0)
        here = scene.near(target, leaving, boundary)
        other = boundary & (here != legs.region)
        dr.eval(pi, target, hit, boundary, leaving, here, other)  # the rays are traced once
        return Met(pi, hit, target, boundary, tri, leaving, here, other)


def _meet(scene, legs, first):
    """``Met`` of all legs. Those that meet a boundary from a region that it is not next to, or nothing inside of a closed body, have
    slipped through an edge unseen, or bodies touch there: they are traced again slightly aside."""
    ray = mi.Ray3f(legs.o, legs.d)
    met = Met.of(scene, legs, scene.mi_scene.ray_intersect_preliminary(ray, coherent=first))
    slipped = dr.compress(met.other | (~met.hit & scene.enclosed(legs.region)))
    if dr.width(slipped) == 0:
        return met
    o, d = dr.gather(mi.Point3f, legs.o, slipped), dr.gather(mi.Vector3f, legs.d, slipped)
    frame = mi.Frame3f(d)
    aside = dr.normalize(d + tolerances.ASIDE * (frame.s + 0.618 * frame.t))
    again = scene.mi_scene.ray_intersect_preliminary(mi.Ray3f(o, aside))
    pi = met.pi
    for name in ("t", "prim_uv", "prim_index", "shape_index", "shape", "instance"):
        dr.scatter(getattr(pi, name), getattr(again, name), slipped)
    return Met.of(scene, legs, pi)


def _make_up(scene, legs, target, leaving, here, other):
    """Corrects the weight and region of legs that meet a boundary from another region (``other``) than that on its near
    side (``here``). What the crossing that was missed does to radiance is made up for: before this leg, or after it where
    its body touches the one that is met. Returns the factor for after it."""
    behind = scene.missed_behind(legs.region, target, leaving, other)
    factor = scene.squared_index(legs.region) / scene.squared_index(here)
    legs.weight = dr.select(behind, legs.weight * factor, legs.weight)
    legs.region = dr.select(behind, here, legs.region)
    return dr.select(other & ~behind, factor, 1)


def _record(scene, legs, wavelengths, hit, length, paths):
    """Adds the parts of legs in regions that scatter to the segments."""
    for region in scene.regions:
        if region.scatters:
            kept = dr.compress((legs.region == region.index) & (True if region.reach else hit))
            if dr.width(kept) > 0:
                s, t = legs.gather(kept), dr.gather(mi.Float, length, kept)
                t = dr.minimum(t, dr.opaque(mi.Float, region.reach)) if region.reach else t
                found = CameraSegments(
                    origin=s.o, offset=s.back, direction=s.d, length=t, region=region.index, weight=s.weight, sample=s.sample,
                    wavelengths=lanes.of(wavelengths, s.sample),
                )  # fmt: skip
                paths.parts[region.index].append(found)


def _split(
    scene, legs, wavelengths, pi, tri, target, active, leaving, internal_bounces, again, surfaces, first, min_weight
):
    """The reflected and the refracted legs behind a hit with a boundary, as a list of ``Legs``."""
    centre = dr.gather(mi.Point3f, scene.centre, target, active)
    extent = dr.gather(mi.Float, scene.extent, target, active)
    eta = dr.select(active, dr.gather(mi.Float, scene.eta, target, active), 1)
    inside, outside = (dr.gather(mi.UInt32, table, target, active) for table in (scene.inside, scene.outside))
    n = tri.normal(pi.prim_uv.x, pi.prim_uv.y)
    P = tri.position(pi.prim_uv.x, pi.prim_uv.y)
    # As in Mitsuba the shading normal says from which side light is refracted, the facet where the ray then is.
    from_outside = dr.dot(legs.d, n) < 0
    n = dr.select(from_outside, n, -n)
    eta_ti = dr.select(from_outside, eta, dr.rcp(eta))
    F, cos_t = optics.fresnel(-dr.dot(legs.d, n), eta_ti)
    through, shift = optics.refract(legs.d, n, cos_t, eta_ti), dr.rcp(dr.square(eta_ti))
    if scene.thin is not None:
        thin = active & dr.gather(mi.Bool, scene.thin, target, active)
        one_side = optics.fresnel(-dr.dot(legs.d, n), eta)[0]  # the same from both sides of the sheet
        F = dr.select(thin, optics.twice(one_side), F)
        through, shift = dr.select(thin, legs.d, through), dr.select(thin, 1, shift)
    # Where nothing is reflected the ray does not branch: such hits don't count.
    counts = ~leaving & (eta != 1) if not first else mi.Bool(False)
    entries = legs.entries + dr.select(counts, mi.UInt32(1), mi.UInt32(0))
    reflections = legs.reflections + dr.select(leaving, mi.UInt32(1), mi.UInt32(0))
    active &= entries <= internal_bounces
    out = []
    for d, factor, mirrored, what in (
        (optics.reflect(legs.d, n), F, True, "specular_reflectance"),
        (through, (1 - F) * shift, False, "specular_transmittance"),
    ):
        side = dr.dot(d, tri.Ng)
        goes_in = side < 0
        weight = legs.weight * factor * _tints(scene, target, what, wavelengths)
        # Radiance inside is eta^2 smaller in these units; legs are compared as they would be outside.
        importance = dr.max(weight) * dr.select(goes_in, dr.square(eta), 1)
        goes_on = active & (importance > min_weight)
        if mirrored:
            goes_on &= reflections <= internal_bounces
        if not surfaces:
            goes_on &= goes_in | mi.Bool(again)
        start = P + tri.Ng * dr.copysign(tolerances.CAMERA_OFFSET * extent, side)
        origin = centre + start
        legs_on = Legs(mi.Point3f(origin), mi.Vector3f(d), weight, legs.sample, dr.select(goes_in, inside, outside),
                       reflections if mirrored else legs.reflections, entries, mi.Vector3f(P - (origin - centre)))  # fmt: skip
        kept = dr.compress(goes_on)
        if dr.width(kept) > 0:
            out.append(legs_on.gather(kept))
    return out


def _tints(scene, target, what, wavelengths):
    """The colours of the boundaries that legs meet."""
    tint = mi.Spectrum(1)
    for body in scene.bodies:
        if what in body.tints:
            tint = dr.select(target == body.index, body.tint(what, wavelengths), tint)
    return tint


def _reflected(scene, legs, ray, pi, mirror, internal_bounces, min_weight, first):
    """The legs behind a hit with a mirror, as Mitsuba's BSDF reflects them; a list of at most one ``Legs``."""
    kept = dr.compress(mirror & (legs.entries + (0 if first else 1) <= internal_bounces))
    if dr.width(kept) == 0:
        return []
    legs, pi = legs.gather(kept), dr.gather(type(pi), pi, kept)
    leg = mi.RayDifferential3f(mi.Ray3f(legs.o, legs.d))
    leg.time, leg.wavelengths = lanes.of(ray.time, legs.sample), lanes.of(ray.wavelengths, legs.sample)
    si = pi.compute_surface_interaction(leg, mi.RayFlags.All)
    drawn, value = si.bsdf(leg).sample(mi.BSDFContext(), si, mi.Float(0.5), mi.Point2f(0.5))
    d = si.to_world(drawn.wo)
    legs.weight = legs.weight * value
    legs.entries = legs.entries + mi.UInt32(0 if first else 1)
    side = dr.copysign(scene.mirror_extent(pi.shape) * tolerances.CAMERA_OFFSET, dr.dot(d, si.n))
    legs.o, legs.d, legs.back = mi.Point3f(si.p + si.n * side), mi.Vector3f(d), dr.zeros(mi.Vector3f, dr.width(d))
    dr.eval(legs)  # the mirrors are asked once
    kept = dr.compress(dr.max(legs.weight) > min_weight)
    return [legs.gather(kept)] if dr.width(kept) > 0 else []


def _refuse_other_medium(scene, legs, met):
    """Camera rays that first meet a boundary from a side where another medium is than the sensor names.

    A few may have slipped through edges, or see an open surface from behind through its hole. They are made up for, as long as
    they are at most ``tolerances.FROM_ELSEWHERE`` of the rays in this wavefront that hit anything. None are where the sensor is
    in a medium without end and a body is met from outside.
    """
    found = dr.compress(scene.missed_behind(legs.region, met.target, met.leaving, met.other))
    if dr.width(found) == 0:
        return
    start = int(dr.gather(mi.UInt32, legs.region, found)[0])
    around = None if start == NONE else scene.regions[start]
    named = None if around is None else around.medium
    target, here, inside = (lanes.gather(x, found).numpy() for x in (met.target, met.here, met.leaving))
    differs = np.array([region.medium != named for region in scene.regions] + [named is not None])
    wrong, hits = differs[np.minimum(here, len(scene.regions))], int(dr.count(met.hit)[0])
    if wrong.sum() <= tolerances.FROM_ELSEWHERE * hits:
        wrong &= ~inside & (around is not None and around.body is None)
    if not wrong.any():
        return
    sides, first, counts = np.unique(2 * target[wrong] + inside[wrong], return_index=True, return_counts=True)
    most = np.argmax(counts)
    body, leaves = scene.bodies[sides[most] // 2], bool(sides[most] % 2)
    lane = dr.gather(mi.UInt32, found, mi.UInt32(int(np.flatnonzero(wrong)[first[most]])))
    if leaves and body.closed and not holds(body, dr.gather(mi.Point3f, legs.o, lane).numpy().ravel()):
        return  # it slipped through twice
    medium = None if (there := body.inside if leaves else body.outside) == NONE else scene.regions[there].medium
    share = f"{100 * counts[most] / hits:.3g} %"
    if leaves and not body.closed and medium is not None and bool(dr.any((met.target == body.index) & ~met.leaving)):
        raise hole_refusal(body, medium, share)
    where = f"is met from its {'inside' if leaves else 'outside'} by {share} of the camera rays that hit anything"
    raise side_refusal(body, leaves, medium, named, where)


def _refuse_overlaps(scene, legs, t, target, other):
    """Whether legs that meet a boundary from a region that it is not next to come from inside of two bodies."""
    found = dr.compress(other)
    if dr.width(found) == 0:
        return
    few = dr.gather(mi.UInt32, found, dr.arange(mi.UInt32, min(tolerances.OVERLAP_RAYS, dr.width(found))))
    middle = dr.gather(mi.Point3f, mi.Point3f(legs.o + 0.5 * t * legs.d), few).numpy().T
    named = [dr.gather(mi.UInt32, x, few).numpy() for x in (legs.region, target)]
    for point, here, hit in zip(middle, *named):
        a = None if here == NONE else scene.regions[here].body
        b = scene.bodies[hit]
        nested = a is not None and (scene.encloses(a, b) or scene.encloses(b, a))
        if a is not None and a is not b and not nested and b.closed and holds(a, point) and holds(b, point):
            raise refusal("overlap", b.name, other=a.name)

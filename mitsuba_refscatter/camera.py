"""From camera rays to the chain of segments inside bodies, with weights.

Each camera ray is followed through the boundaries that it meets. Every hit splits it into the reflected
and the refracted leg, both deterministically; each part inside a body is a segment along which single
scattering is collected. A leg goes on while it had at most ``internal_bounces`` internal reflections and
as many hits from outside after the first. Weights hold Fresnel factors, the change of radiance by the
index of refraction (1/eta^2 going in, eta^2 going out) and the attenuation inside bodies.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from . import lanes, optics, tolerances
from .geometry import mesh as mesh_facts
from .geometry import triangle
from .scene import NONE, SceneError


@dataclass
class Legs:
    """Rays on their way (world coordinates): origin, direction, weight, camera sample, body around (or
    NONE), and numbers of internal reflections and of hits from outside so far."""

    o: object
    d: object
    weight: object
    sample: object
    body: object
    reflections: object
    entries: object

    def map(self, f):
        return Legs(*(f(x) for x in self.__dict__.values()))

    def gather(self, index):
        return self.map(lambda x: dr.gather(type(x), x, index))

    def __len__(self):
        return dr.width(self.sample)


@dataclass
class Paths:
    """What a set of camera rays meets.

    ``segments``: a list, per body, of ``(o, d, t_max, weight, sample)`` in world coordinates;
    ``ends``: ``Legs`` that reach a plain surface or escape (their weight includes the way there);
    ``direct``: whether the first of these are the camera rays that meet no body; ``hit``: per camera ray, whether
    it hits anything.
    """

    segments: list
    ends: list
    direct: bool
    hit: object


def trace(scene, ray, active, internal_bounces, surfaces, min_weight):
    """Follows the camera rays. ``scene``: ``scene.Scene``; ``ray``: mi.Ray3f; legs whose weight falls below
    ``min_weight`` are dropped. ``surfaces``: whether ends are wanted. Returns ``Paths``."""
    n = dr.width(ray)
    legs = Legs(
        mi.Point3f(ray.o) + dr.zeros(mi.Point3f, n), ray.d, mi.Spectrum(1) + dr.zeros(mi.Spectrum, n),
        dr.arange(mi.UInt32, n), dr.full(mi.UInt32, NONE, n), dr.zeros(mi.UInt32, n), dr.zeros(mi.UInt32, n),
    )  # fmt: skip
    if not isinstance(active, bool) or not active:
        legs = legs.gather(dr.compress(mi.Bool(active) & dr.full(mi.Bool, True, n)))
    paths = Paths([[] for _ in scene.bodies], [], False, dr.zeros(mi.Bool, n))
    again = internal_bounces > 0 and (surfaces or len(scene.bodies) > 1 or not scene.bodies[0].convex)
    first = True
    while len(legs) > 0:
        legs = _advance(scene, ray, legs, paths, first, internal_bounces, surfaces, again, min_weight)
        first = False
    return paths


def _advance(scene, ray, legs, paths, first, internal_bounces, surfaces, again, min_weight):
    """Takes all legs to their next hit; records segments and ends; returns the legs that go on."""
    pi = scene.mi_scene.ray_intersect_preliminary(mi.Ray3f(legs.o, legs.d), coherent=first)
    hit = pi.is_valid()
    within = legs.body != NONE
    target = dr.select(hit, scene.find(dr.select(hit, pi.shape, scene.mi_scene.shapes()[0])), NONE)
    boundary = target != NONE
    if first:
        dr.scatter(paths.hit, hit, legs.sample)
    index = dr.select(boundary, dr.gather(mi.UInt32, scene.first_record, target, boundary) + pi.prim_index, 0)
    tri = triangle.gather(scene.records, index, boundary)
    leaving = dr.dot(legs.d, tri.Ng) > 0
    bad = boundary & (leaving != within)
    if first:
        _refuse_camera_inside(scene, legs, target, bad)
    _refuse_nested(scene, legs.body, target, within & boundary & (legs.body != target))

    sigma_t = mi.Spectrum(0)
    wavelengths = lanes.of(ray.wavelengths, legs.sample)
    for body in scene.bodies:
        if body.medium is not None:
            sigma_t = dr.select(legs.body == body.index, body.coefficients(wavelengths)[1], sigma_t)
    arriving = Legs(**{**legs.__dict__, "weight": legs.weight * dr.exp(-sigma_t * dr.select(within & hit, pi.t, 0))})
    dr.eval(arriving.weight, hit, within, boundary, bad)

    for body in scene.bodies:
        if body.scatters:
            kept = dr.compress((legs.body == body.index) & hit)
            if dr.width(kept) > 0:
                s = legs.gather(kept)
                paths.segments[body.index].append((s.o, s.d, dr.gather(mi.Float, pi.t, kept), s.weight, s.sample))
    if surfaces:
        kept = dr.compress(dr.select(hit, ~boundary, ~within))
        if dr.width(kept) > 0:
            paths.ends.append(arriving.gather(kept))
            paths.direct |= first
    return _split(
        scene, arriving, pi, tri, target, boundary & ~bad, internal_bounces, again, surfaces, first, min_weight
    )


def _split(scene, legs, pi, tri, target, active, internal_bounces, again, surfaces, first, min_weight):
    """The reflected and the refracted legs behind a hit with a boundary."""
    within = legs.body != NONE
    centre = dr.gather(mi.Point3f, scene.centre, target, active)
    extent = dr.gather(mi.Float, scene.extent, target, active)
    eta = dr.select(active, dr.gather(mi.Float, scene.eta, target, active), 1)
    n = tri.normal(pi.prim_uv.x, pi.prim_uv.y)
    P = tri.position(pi.prim_uv.x, pi.prim_uv.y) + centre
    # As in Mitsuba the shading normal says from which side light is refracted, the facet where the ray then is.
    outside = dr.dot(legs.d, n) < 0
    n = dr.select(outside, n, -n)
    cos_i = -dr.dot(legs.d, n)
    eta_ti = dr.select(outside, eta, dr.rcp(eta))
    F, cos_t = optics.fresnel(cos_i, eta_ti)
    entries = legs.entries + dr.select(within, mi.UInt32(0), mi.UInt32(0 if first else 1))
    reflections = legs.reflections + dr.select(within, mi.UInt32(1), mi.UInt32(0))
    active &= entries <= internal_bounces
    out = []
    for d, factor, mirrored in (
        (optics.reflect(legs.d, n), F, True),
        (optics.refract(legs.d, n, cos_t, eta_ti), (1 - F) / dr.square(eta_ti), False),
    ):
        side = dr.dot(d, tri.Ng)
        inside = side < 0
        weight = legs.weight * factor
        # Radiance inside is eta^2 smaller in these units; legs are compared as they would be outside.
        importance = dr.max(weight) * dr.select(inside, dr.square(eta), 1)
        goes_on = active & (importance > min_weight)
        if mirrored:
            goes_on &= reflections <= internal_bounces
        if not surfaces:
            goes_on &= inside | mi.Bool(again)
        origin = P + tri.Ng * dr.copysign(tolerances.CAMERA_OFFSET * extent, side)
        legs_on = Legs(origin, d, weight, legs.sample, dr.select(inside, target, NONE),
                       reflections if mirrored else legs.reflections, entries)  # fmt: skip
        kept = dr.compress(goes_on)
        if dr.width(kept) > 0:
            out.append(legs_on.gather(kept))
    if not out:
        return legs.gather(dr.zeros(mi.UInt32, 0))
    return Legs(*(lanes.concat(x) for x in zip(*(legs.__dict__.values() for legs in out))))


def _refuse_camera_inside(scene, legs, target, bad):
    """A first hit from behind: the camera is inside a body, or the ray slipped through an edge."""
    found = dr.compress(bad)
    if dr.width(found) == 0:
        return
    origin = dr.gather(mi.Point3f, legs.o, found).numpy()[:, 0]
    body = scene.bodies[int(dr.gather(mi.UInt32, target, found)[0])]
    if mesh_facts.encloses(body.corners, origin):
        raise SceneError(
            f"the camera is inside {body.name}: refscatter supports cameras outside of bodies only; move it out"
        )


def _refuse_nested(scene, around, target, nested):
    found = dr.compress(nested)
    if dr.width(found) > 0:
        a, b = (scene.bodies[int(dr.gather(mi.UInt32, x, found)[0])].name for x in (around, target))
        raise SceneError(
            f"{b} is inside or overlaps {a}: refscatter supports bodies apart from each other only; separate them"
        )

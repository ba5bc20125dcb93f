"""What happens to rays at what they meet next: which boundary it is and from which side, and the ways on behind it.

The same for rays from the camera and for light. Rays, hits and ways are arrays, lane by lane.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .. import optics, tolerances
from ..core.arrays import NONE
from ..geometry import triangle


@dataclass
class Hit:
    """What rays meet next.

    pi        Mitsuba's preliminary intersection
    valid     Bool, whether there is anything
    target    UInt32, the body whose boundary it is, or NONE
    boundary  Bool, whether it is one
    tri       its triangle, in coordinates of the body; nothing where it is none
    leaving   Bool, whether the boundary is met from its inside, by the geometric normal
    near      UInt32, the region before the boundary, or NONE
    behind    UInt32, the region behind it, or NONE
    """

    pi: mi.PreliminaryIntersection3f
    valid: mi.Bool
    target: mi.UInt32
    boundary: mi.Bool
    tri: triangle.Triangle
    leaving: mi.Bool
    near: mi.UInt32
    behind: mi.UInt32

    @classmethod
    def of(cls, scene, d, pi, active=True):
        """``Hit`` of rays along ``d`` (Vector3f, unit) that Mitsuba's intersection ``pi`` is of."""
        valid, target = pi.is_valid() & active, scene.find(pi.shape)
        boundary = (target != NONE) & active
        first = dr.gather(mi.UInt32, scene.first_record, target, boundary)
        tri = triangle.gather(scene.records, dr.select(boundary, first + pi.prim_index, 0), boundary)
        leaving = boundary & (dr.dot(d, tri.Ng) > 0)
        near, behind = (scene.near(target, side, boundary) for side in (leaving, ~leaving))
        return cls(pi, valid, target, boundary, tri, leaving, near, behind)

    @property
    def uv(self):
        """Place in the triangle."""
        return self.pi.prim_uv.x, self.pi.prim_uv.y

    def tint(self, bodies, what, wavelengths):
        """The colours (Spectrum) of those boundaries that are of ``bodies``; ``what``: ``specular_reflectance``
        or ``specular_transmittance``."""
        tint = mi.Spectrum(1)
        for body in bodies:
            if what in body.tints:
                tint = dr.select(self.target == body.index, body.tint(what, wavelengths), tint)
        return tint


@dataclass
class Crossing:
    """Both ways on of rays that meet a boundary.

    eta        Float, relative index of refraction of the boundary, inside over outside; 1 where there is none
    F          Float, reflectance by Fresnel; of a thin sheet with all reflections in it
    reflected  Vector3f, unit direction of the reflected way
    refracted  Vector3f, the same of the way through; meaningless where F is 1
    shift      Float, what refraction does to radiance along the ray: 1 over the square of the index behind over
               that before
    """

    eta: mi.Float
    F: mi.Float
    reflected: mi.Vector3f
    refracted: mi.Vector3f
    shift: mi.Float


def cross(scene, d, hit, n=None):
    """``Crossing`` of rays along ``d`` that a ``Hit`` is of. ``n``: normal (unit), or None for the shading normal.

    As in Mitsuba the shading normal says from which side a ray is refracted, the facet where it then is.
    """
    n = hit.tri.normal(*hit.uv) if n is None else n
    eta = dr.select(hit.boundary, dr.gather(mi.Float, scene.eta, hit.target, hit.boundary), 1)
    from_outside = dr.dot(d, n) < 0
    n = dr.select(from_outside, n, -n)
    eta_ti = dr.select(from_outside, eta, dr.rcp(eta))
    F, cos_t = optics.fresnel(-dr.dot(d, n), eta_ti)
    through, shift = optics.refract(d, n, cos_t, eta_ti), dr.rcp(dr.square(eta_ti))
    if scene.thin is not None:
        thin = hit.boundary & dr.gather(mi.Bool, scene.thin, hit.target, hit.boundary)
        F = dr.select(thin, sheet(-dr.dot(d, n), eta), F)
        through, shift = dr.select(thin, d, through), dr.select(thin, 1, shift)
    return Crossing(eta, F, optics.reflect(d, n), through, shift)


def sheet(cosine, eta):
    """Reflectance of a thin sheet, the same from both of its sides."""
    return optics.twice(optics.fresnel(cosine, eta)[0])


@dataclass
class Departure:
    """Where rays leave a boundary.

    origin   Point3f, world, just off it on the side to which they go
    back     Vector3f, from there to the place on the boundary, with what rounding in world coordinates took
    goes_in  Bool, whether that side is the inside, by the geometric normal
    region   UInt32, the region there
    """

    origin: mi.Point3f
    back: mi.Vector3f
    goes_in: mi.Bool
    region: mi.UInt32


def depart(scene, hit, d):
    """``Departure`` along ``d`` of rays from the place where they met a boundary."""
    centre = dr.gather(mi.Point3f, scene.centre, hit.target, hit.boundary)
    extent = dr.gather(mi.Float, scene.extent, hit.target, hit.boundary)
    P, side = hit.tri.position(*hit.uv), dr.dot(d, hit.tri.Ng)
    start = P + hit.tri.Ng * dr.copysign(tolerances.CAMERA_OFFSET * extent, side)
    origin, goes_in = mi.Point3f(centre + start), side < 0
    region = scene.near(hit.target, goes_in, hit.boundary)
    return Departure(origin, mi.Vector3f(P - (origin - centre)), goes_in, region)


def mirrored(scene, pi, ray, wavelengths):
    """Rays that meet a mirror with Mitsuba's intersection ``pi``, as its BSDF reflects them: origin (world), unit
    direction, and the factor of radiance (Spectrum). ``ray``: mi.Ray3f, whose time counts."""
    leg = mi.RayDifferential3f(ray)
    leg.wavelengths = wavelengths
    si = pi.compute_surface_interaction(leg, mi.RayFlags.All)
    drawn, value = si.bsdf(leg).sample(mi.BSDFContext(), si, mi.Float(0.5), mi.Point2f(0.5))
    d = si.to_world(drawn.wo)
    side = dr.copysign(scene.mirror_extent(pi.shape) * tolerances.CAMERA_OFFSET, dr.dot(d, si.n))
    return mi.Point3f(si.p + si.n * side), mi.Vector3f(d), value


def trace(scene, o, d, active=True, coherent=False):
    """``Hit`` of rays from ``o`` (world) along ``d``."""
    return Hit.of(
        scene, d, scene.mi_scene.ray_intersect_preliminary(mi.Ray3f(o, d), coherent=coherent, active=active), active
    )


def retrace(scene, o, d, hit, lanes):
    """``hit`` with what rays of some ``lanes`` (UInt32) meet slightly aside."""
    o, d_there = (dr.gather(type(x), x, lanes) for x in (o, d))
    frame = mi.Frame3f(d_there)
    aside = dr.normalize(d_there + tolerances.ASIDE * (frame.s + 0.618 * frame.t))
    again = scene.mi_scene.ray_intersect_preliminary(mi.Ray3f(o, aside))
    pi = hit.pi
    for name in ("t", "prim_uv", "prim_index", "shape_index", "shape", "instance"):
        dr.scatter(getattr(pi, name), getattr(again, name), lanes)
    return Hit.of(scene, d, pi)

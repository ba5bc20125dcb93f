"""EmittedPhotons that leave the lights, sent to bodies and everywhere."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..light import light_samples
from ..scene import NONE, holds, media
from .walk import meet


@dataclass
class EmittedPhotons:
    """EmittedPhotons where they start.

    o       Point3f, world
    d       Vector3f, unit
    region  UInt32, where they start
    weight  Spectrum, W, what each carries
    """

    o: mi.Point3f
    d: mi.Vector3f
    region: mi.UInt32
    weight: mi.Spectrum


def offset(p):
    """How far off a surface at p (world) rays start."""
    return tolerances.MISSING_OFFSET * dr.max(dr.abs(p))


def points(scene, random):
    """``LightSample`` of all emitters, or of some where they are many: one, or as many as ``random`` has lanes."""
    emitters = scene.emitters
    chosen = np.linspace(0, len(emitters) - 1, min(len(emitters), tolerances.MISSING_LIGHTS)).astype(int)
    for emitter in (emitters[i] for i in chosen):
        u = mi.Point2f(random.next_float32(), random.next_float32())
        yield light_samples.draw(emitter, u, 1.0) if emitter.drawn else light_samples.exact(emitter)


def photons(scene):
    """``EmittedPhotons`` of the lights."""
    each = tolerances.MISSING_PHOTONS // min(len(scene.emitters), tolerances.MISSING_LIGHTS)
    random, targets, found = mi.PCG32(size=each), _Targets(scene), []
    for point in points(scene, random):
        u = [random.next_float32() for _ in range(3)]
        weight, L = point.intensity(media.visible()), point.L + dr.zeros(type(point.L), each)
        if point.distant:
            o, d, density = targets.beside(L, u)
        else:
            d, density = targets.aim(L, u)
            o, emission = L + d * offset(L), point.emission(mi.Point3f(0), media.visible())
            weight = weight if emission is None else weight * emission(L + d, -d, mi.Float(1))
        weight = mi.Spectrum(weight / density) + dr.zeros(mi.Spectrum, each)
        sent = EmittedPhotons(o, d, _region(scene, o, d), dr.select(dr.isfinite(weight), weight, 0))
        dr.eval(sent)
        found.append(sent)
    return arrays.concat_records(found)


def _region(scene, o, d):
    """Index of the region in which the photons of a light start: the one in which most lines from there come to a
    boundary."""
    n = dr.width(o)
    met = meet(scene, o, d, True)
    found, counts = np.unique(np.array(met.near)[np.array(met.boundary)], return_counts=True)
    if len(found) > 0:
        return dr.opaque(mi.UInt32, int(found[np.argmax(counts)]), n)
    inside = [body.inside for body in scene.bodies if body.closed and holds(body, np.array(o).T[0])]
    endless = [region.index for region in scene.regions if region.body is None]
    return dr.opaque(mi.UInt32, [*inside, *endless, NONE][0], n)


class _Targets:
    """Spheres around the bodies and one around the scene, to which photons are sent, all as likely."""

    def __init__(self, scene):
        boxes = [body.box for body in scene.bodies] + [box for box in [scene.box()] if box is not None]
        spheres = [[*(0.5 * (low + high)), 0.5 * np.linalg.norm(high - low)] for low, high in boxes] or [[0, 0, 0, 1]]
        self.count, self.spheres = dr.opaque(mi.UInt32, len(spheres)), arrays.array(mi.Float, np.ravel(spheres))
        self.far = dr.opaque(mi.Float, 4 * float(np.abs(spheres).max()))

    def _sphere(self, i):
        x, y, z, radius = (dr.gather(mi.Float, self.spheres, 4 * i + k) for k in range(4))
        return mi.Point3f(x, y, z), radius

    def _chosen(self, u):
        return self._sphere(dr.minimum(mi.UInt32(u * self.count), self.count - 1))

    def _mean(self, density, n):
        """Mean of ``density(centre, radius)`` over the spheres, for n lanes."""
        state = dr.zeros(mi.UInt32, n), dr.zeros(mi.Float, n)
        total = dr.while_loop(
            state,
            lambda i, _: i < self.count,
            lambda i, total: (i + 1, total + density(*self._sphere(i))),
            label="targets",
            mode="symbolic",
        )[1]
        return total / self.count

    def aim(self, L, u):
        """Unit directions from ``L`` and their density, 1/sr. Half of them go anywhere."""
        centre, radius = self._chosen(dr.clip(2 * u[0] - 1, 0, 1))
        uv = mi.Point2f(u[1], u[2])
        cone = mi.warp.square_to_uniform_cone(uv, _cosine(L, centre, radius))
        towards = mi.Frame3f(_unit(centre - L)).to_world(cone)
        d = dr.normalize(dr.select(u[0] < 0.5, mi.warp.square_to_uniform_sphere(uv), towards))

        def density(centre, radius):
            cosine = _cosine(L, centre, radius)
            return dr.select(dr.dot(d, _unit(centre - L)) >= cosine, dr.inv_two_pi / (1 - cosine), 0)

        return d, 0.5 * dr.inv_four_pi + 0.5 * self._mean(density, dr.width(d))

    def beside(self, L, u):
        """Origins of light from the direction ``L``, its direction, and the density across it, 1/area."""
        centre, radius = self._chosen(u[0])
        frame, disk = mi.Frame3f(L), mi.warp.square_to_uniform_disk_concentric(mi.Point2f(u[1], u[2]))
        at = centre + radius * (frame.s * disk.x + frame.t * disk.y)

        def density(centre, radius):
            off = dr.squared_norm(dr.cross(at - centre, L))
            return dr.select(off <= dr.square(radius), dr.inv_pi / dr.square(radius), 0)

        return at + L * self.far, -L, self._mean(density, dr.width(at))


def _cosine(L, centre, radius):
    """Cosine of the half-angle under which a sphere is seen; -1 from its inside."""
    sine2 = dr.square(radius) / dr.maximum(dr.squared_norm(centre - L), 1e-30)
    return dr.select(sine2 < 1, dr.minimum(dr.safe_sqrt(1 - sine2), 1 - tolerances.MISSING_CONE), -1)


def _unit(v):
    return v * dr.rsqrt(dr.maximum(dr.squared_norm(v), 1e-30))

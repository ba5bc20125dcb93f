"""Light that goes straight: what is left of it behind media and boundaries that do not refract (null, thin dielectric).

Every other surface, a dielectric too, blocks it; but where all light is to go straight, it goes through one
refracting boundary.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..core import arrays
from ..scene import ONCE, Scene
from .crossing import Hit, sheet

BLOCKED = 0xFFFFFFFF
"""Number of boundaries crossed that means that something is in the way."""


@dataclass
class Transmittance:
    """Straight lines through the regions of a scene.

    scene        ``scene.Scene``
    wavelengths  one set, or one per line
    unbent       whether boundaries that refract are in the way also where the scene lets light go straight through them
    """

    scene: Scene
    wavelengths: mi.Spectrum
    unbent: bool = False

    def at(self, segment):
        """Those of the camera segments ``segment`` (indices)."""
        return replace(self, wavelengths=arrays.of(self.wavelengths, segment))

    def along(self, d, region, length):
        """What media leave (Spectrum) of light on lines that stay in a region.

        d       Vector3f, unit
        region  UInt32, or NONE
        length  Float, or ``tolerances.ENDLESS``
        """
        return dr.exp(-self.depth(d, region, length))

    def depth(self, d, region, length):
        """Optical depth (Spectrum) of the same."""
        return _of(self._extinctions(d), region) * length

    def _extinctions(self, d):
        """Indices of the regions with media, and the extinction (Spectrum, 1/length) along ``d`` in each."""
        filled = [one for one in self.scene.regions if one.medium is not None]
        return [(one.index, one.coefficients(self.wavelengths, d)[1]) for one in filled]

    def follow(self, start, direction, distance, region, active=True):
        """From points ``start`` (world) in ``region`` (an index) to what is ``distance`` away (or
        ``tolerances.ENDLESS``).

        Returns what is left of light on the way (Spectrum), and how many boundaries it crosses, or BLOCKED.
        """
        scene, n = self.scene, dr.width(direction)
        if scene.straight is None:  # then whatever is met is in the way
            ray = mi.Ray3f(start, direction)
            ray.maxt = distance
            free = ~scene.mi_scene.ray_test(ray, active)
            left = dr.select(free, self.along(direction, region, distance), 0)
            return left, dr.select(free, mi.UInt32(0), BLOCKED)
        extinctions = self._extinctions(direction)

        def step(o, left, region, value, crossed, active):
            ray = mi.Ray3f(o, direction)
            ray.maxt = left
            pi = scene.mi_scene.ray_intersect_preliminary(ray, active=active)
            hit = active & pi.is_valid()
            count, region, ahead, factor, behind = self._cross(direction, region, pi, hit, crossed)
            passes, sigma_t = count > 0, _of(extinctions, region)
            value = dr.select(active, value * dr.exp(-sigma_t * dr.select(hit, pi.t, left)), value)
            value = dr.select(hit, value * factor, value)
            crossed = dr.select(hit, dr.select(passes, crossed + count, BLOCKED), crossed)
            o, left = mi.Point3f(o + ahead * direction), dr.maximum(left - ahead, 0)
            return o, left, behind, value, crossed, hit & passes

        state = (
            mi.Point3f(start) + dr.zeros(mi.Point3f, n),
            distance + dr.zeros(mi.Float, n),
            dr.zeros(mi.UInt32, n) + region,
            dr.full(mi.Spectrum, 1, n),
            dr.zeros(mi.UInt32, n),
            dr.full(mi.Bool, True, n) & active,
        )
        end = dr.while_loop(state, lambda *x: x[-1], step, label="transmittance", mode="symbolic")
        return dr.select(end[4] == BLOCKED, mi.Spectrum(0), end[3]), end[4]

    def _cross(self, direction, region, pi, hit, crossed):
        """What a hit with a boundary that does not refract means: what it counts for (0 if it is none), the
        region before it, the distance to just behind it, the share of the light that passes, and the region
        there."""
        scene = self.scene
        met = Hit.of(scene, direction, pi, hit)
        count = dr.gather(mi.UInt32, scene.straight, met.target, met.boundary)
        passes = met.boundary & (count > 0) & (crossed + count < (ONCE if self.unbent else 2 * ONCE))
        cosine, factor = dr.dot(direction, met.tri.Ng), mi.Spectrum(1)
        if scene.thin is not None:
            eta = dr.select(passes, dr.gather(mi.Float, scene.eta, met.target, passes), 1)
            thin = dr.gather(mi.Bool, scene.thin, met.target, passes)
            factor *= dr.select(thin, 1 - sheet(dr.abs(cosine), eta), 1)
        factor *= met.tint(scene.passed, "specular_transmittance", self.wavelengths)
        missed = scene.missed_behind(region, met.target, met.leaving, passes & (met.near != region))
        offset = dr.gather(mi.Float, scene.extent, met.target, passes) * tolerances.SHADOW_OFFSET
        ahead = pi.t + offset / dr.maximum(dr.abs(cosine), tolerances.GRAZING)
        behind = dr.select(passes, met.behind, region)
        return (
            dr.select(passes, count, 0),
            dr.select(missed, met.near, region),
            ahead,
            dr.select(passes, factor, 0),
            behind,
        )


def _of(extinctions, region):
    """The extinction (Spectrum) in regions (UInt32)."""
    sigma_t = mi.Spectrum(0)
    for index, sigma in extinctions:
        sigma_t = dr.select(region == index, sigma, sigma_t)
    return sigma_t

"""One pass: a wavefront of camera rays, from the rays to the channels of the image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import film, options, tolerances
from ..estimators.wavefront import Counts
from ..scene import region_of_camera
from ..transport import camera_paths
from ..transport.surface_paths import SurfaceLimits
from . import messages
from .prepared import Prepared
from .single_scattering import Samples
from .surfaces import seed_from, shade


@dataclass
class RenderPass:
    """What all passes of a render share.

    prepared  the scene
    options   those of the plugin
    medium    that the sensor names, or None
    scatter   (prepared, paths, samples, counts, sampler) -> ``Sums``: how the plugin computes single scattering
    missing   (scene, light_bounces or None) -> sentences: what the plugin says of light that is not computed in media
    surfaces  how far sampled paths between surfaces go
    messages  where warnings go
    counts    where the work is counted
    refracts  whether the plugin solves for light that is refracted
    whole     whether it is for a whole image
    silent    whether missing light is not told
    """

    prepared: Prepared
    options: options.Common
    medium: mi.Medium | None
    scatter: Callable
    missing: Callable
    surfaces: SurfaceLimits
    messages: messages.Messages
    counts: Counts
    refracts: bool
    whole: bool
    silent: bool = False

    def __call__(self, sampler, ray, ray_weight, active, batch, progress):
        """Radiance (Spectrum), whether rays hit anything (Bool), and the extra channels, of one wavefront.

        sampler     Mitsuba's, for random numbers
        ray         mi.Ray3f or wider
        ray_weight  the sensor's; it goes into the channels that show radiance, not into the result
        active      Bool, which rays count
        batch       ``core.sobol.Batch``, which camera samples these are
        progress    (share done) or None
        """
        ray, wanted = mi.Ray3f(ray), options.aov_list(self.options)
        self._warn_of_missing_light(ray)
        paths = self._trace(sampler, ray, active)
        self._look_at_lights_at_the_camera(ray, paths)
        single = self._single_scattering(paths, sampler, ray, batch, progress)
        unresolved = single.unresolved > dr.opaque(mi.Float, self.options.tolerance) * dr.max(single.value)
        self.counts.saw(dr.width(ray), unresolved)
        surfaces, hit = self._surfaces(paths, sampler, ray)
        extra = {
            "single_scatter": lambda: film.to_rgb(ray_weight * single.value, ray.wavelengths),
            "surfaces": lambda: film.to_rgb(
                ray_weight * surfaces + dr.zeros(mi.Spectrum, dr.width(ray)), ray.wavelengths
            ),
            "candidates": lambda: [single.candidates],
            "contributions": lambda: [single.contributions],
            "unresolved": lambda: [dr.select(unresolved, mi.Float(1), 0)],
        }
        return single.value + surfaces, hit, [x for name in wanted for x in extra[name]()]

    def _tells(self, n):
        """Whether warnings are worth their time: of a few rays the estimate would cost more than they do."""
        return not self.silent and (self.whole or n >= tolerances.MISSING_PHOTONS)

    def _trace(self, sampler, ray, active):
        """The chain of segments of each ray, and its ends."""
        prepared, opt = self.prepared, self.options
        start = prepared.once(lambda: region_of_camera(prepared.scene, self.medium, _ends(ray)[0][0]), "start")
        seed = seed_from(sampler) if opt.surfaces else 0
        limits = camera_paths.ChainLimits(opt.internal_bounces, opt.surfaces, prepared.accuracy.weight, seed)
        return camera_paths.trace(prepared.scene, ray, active, start, limits)

    def _warn_of_missing_light(self, ray):
        """Says what will be missing in media."""
        prepared = self.prepared
        if self._tells(dr.width(ray)):
            bounces = prepared.light_bounces if self.refracts else None
            prepared.once(lambda: self.messages.warn(self.missing(prepared.scene, bounces)), "missing in media")

    def _look_at_lights_at_the_camera(self, ray, paths):
        """Says what will not be found, and takes triangles for lights next to it, where light that is refracted is
        solved for."""
        prepared, scene = self.prepared, self.prepared.scene
        met = any(region.boundaries and paths.parts[region.index] for region in scene.regions)
        if not (self.refracts and met) or prepared.estimator.finds_sent_back:
            return

        def look():
            ends = _ends(ray)
            self.messages.warn(messages.lights_at_the_camera(scene, ends))
            prepared.near = {emitter.index for emitter in scene.lights_at(*ends, tolerances.NEXT_TO_CAMERA)}

        prepared.once(look, "lights at the camera")

    def _single_scattering(self, paths, sampler, ray, batch, progress):
        """``Sums`` of the light that scatters once along the segments."""
        detail = bool({"candidates", "contributions"} & set(options.aov_list(self.options)))
        samples = Samples(ray, batch, detail=detail, progress=progress)
        return self.scatter(self.prepared, paths, samples, self.counts, sampler)

    def _surfaces(self, paths, sampler, ray):
        """Radiance that surfaces bring, and which rays hit anything."""
        if not self.options.surfaces:
            return mi.Spectrum(0), paths.hit
        return shade(self.prepared.scene, paths, ray, self.surfaces, seed_from(sampler))


def _ends(ray):
    """Origins and directions of the first and the last ray, (2, 3) each."""
    ends = mi.UInt32(0, dr.width(ray) - 1)
    return [np.array(dr.gather(mi.Vector3f, mi.Vector3f(x), ends)).T for x in (ray.o, ray.d)]

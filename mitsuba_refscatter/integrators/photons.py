"""The Mitsuba plugin ``refscatter_photons``. Reloaded by ``plugin.py`` for every variant."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import options, tolerances
from ..core import arrays
from ..estimators import photons, wavefront
from ..light import light_samples
from ..scene import media
from . import single_scattering
from .prepared import prepare
from .refscatter import RefscatterIntegrator
from .surfaces import seed_from


class PhotonIntegrator(RefscatterIntegrator):
    """Single scattering by photons: noise and blur instead of solving, to compare with.

    In each pass (of camera samples, at most 262,144) new photons are sent from the lights to the bodies'
    boundaries, all of them where they are lit, and refracted in. Light that comes without refraction is summed as
    by ``refscatter``. With the radius r of the first pass and Gamma-like products r_i those of the later ones,
    after Knaus and Zwicker (2011): r_i+1^2 / r_i^2 = (i + alpha) / (i + 1) for points, r_i+1 / r_i for beams
    (Jarosz et al. 2011, progressive photon beams). Not in spectral variants: photons and camera rays have no
    wavelengths in common.

    .. pluginparameters::

     * - mode
       - |string|
       - ``points``: photons are stored where they scatter, and their density is estimated along the camera ray
         (the beam radiance estimate, Jarosz et al. 2008). ``beams``: their whole paths in the medium are stored, and
         meet the camera rays (photon beams, Jarosz et al. 2011, one-dimensional blur). (Default: points)
     * - photons
       - |int|
       - Photons per pass. (Default: 50000)
     * - radius
       - |float|
       - Of the disks and beams, in the scene's unit of length, in the first pass; 0: a hundredth of the diagonal of the
         body's box. (Default: 0)
     * - alpha
       - |float|
       - 1: the radius stays; in (0, 1) it shrinks from pass to pass, so that bias and variance both vanish.
         (Default: 1)
     * - tolerance, internal_bounces, light_samples, surfaces, max_depth, aovs
       -
       - As of ``refscatter``; ``tolerance`` is that of light which comes without refraction.

    .. code-block:: python

        'type': 'refscatter_photons', 'mode': 'beams', 'photons': 20000, 'alpha': 0.7
    """

    known, refracts = options.PhotonOptions, False

    def __init__(self, props):
        super().__init__(props)
        if mi.is_spectral:
            raise options.OptionError(
                "refscatter_photons: photons have no wavelengths in common with camera rays: use an rgb or mono variant"
            )

    def prepare(self, scene, seed, changes=None):
        common = {name: getattr(self.options, name) for name in vars(options.Common())}
        return prepare(scene, options.Options(**common), self.cache, seed, changes=changes)

    def scatter(self, prepared, paths, samples, counts, sampler):
        batch, samples = samples.batch, replace(samples, progress=None)
        single = single_scattering.scatter(prepared, paths, samples, counts, refracted=False)
        rng = np.random.default_rng(seed_from(sampler))
        number = batch.first // batch.per_pixel  # of the pass
        for region in prepared.scene.regions:
            segments = paths.segments(region)
            if segments is None:
                continue
            sigma_s, sigma_t = region.coefficients(segments.wavelengths, segments.direction)
            for body in region.boundaries:
                cloud = self._cloud(prepared, region, body, number, rng)
                if cloud is not None:
                    local = segments.from_boundary(body.centre, sigma_t)
                    value = wavefront.gather(
                        local, cloud, region.phase, region.directed, prepared.pace(body.index, body.key)
                    )
                    dr.scatter_add(single.value, segments.weight * sigma_s * value, segments.sample)
                    single.eval()
        return single

    def _cloud(self, prepared, region, body, number, rng):
        """``photons.Cloud`` of all lights behind a boundary in pass ``number``; None if it is not lit."""
        opt, lights, shot = self.options, prepared.scene.emitters, []
        targets = [
            prepared.once(lambda: _target(prepared, region, body, light), "target", body.index, body.key, light.index)
            for light in lights
        ]
        total = sum(target.flux for target in targets if target is not None)
        for light, target in zip(lights, targets):
            count = 0 if target is None else max(1, round(opt.photons * target.flux / total))
            found = _shoot(prepared, region, body, light, (target, count, rng)) if count > 0 else None
            if found is not None:
                shot.append(found)
        if not shot:
            return None
        found, lengths = arrays.concat_records([x[0] for x in shot]), arrays.concat([x[1] for x in shot])
        sigma_t = region.coefficients(media.visible(), found.omega)[1]
        radius = photons.radius_of(opt.radius or tolerances.PHOTON_RADIUS * body.size, number, opt.alpha, opt.mode)
        blur = photons.Blur(opt.mode == "beams", radius)
        return photons.store(found, lengths, sigma_t, blur, body, _sampler(len(lengths), rng))


def _target(prepared, region, body, emitter):
    """``photons.Target`` that a boundary is to a light."""
    if emitter.drawn:
        rng = np.random.default_rng(0)
        numbers = [dr.opaque(mi.Point2f, list(rng.random(2))) for _ in range(tolerances.PHOTON_PILOTS)]
        points = [light_samples.draw(emitter, u, 1.0) for u in numbers]
    else:
        points = [light_samples.exact(emitter)]
    shadows = prepared.shadows(body, points[0])
    pilots = [
        (prepared.illumination(body, region, p, shadows, media.visible()), p.intensity(media.visible())) for p in points
    ]
    return photons.aim(body, prepared.scene.records, pilots, not emitter.drawn)


def _shoot(prepared, region, body, emitter, shot):
    """Photons of an emitter and how far they go in a body; None if none comes in. ``shot``: their
    ``photons.Target``, their number, and where random numbers come from."""
    target, count, rng = shot
    sampler = _sampler(count, rng)
    point = light_samples.draw(emitter, sampler.next_2d(), 1.0) if emitter.drawn else light_samples.exact(emitter)
    shadows = prepared.shadows(body, point)
    illumination = prepared.illumination(body, region, point, shadows, media.visible())
    tint = body.tint("specular_transmittance", media.visible())
    found = photons.shoot(target, count, illumination, point.intensity(media.visible()) * tint, sampler)
    return None if found is None else (found, shadows.reach(found.P, found.Ng, found.omega, region.visible_range))


def _sampler(count, rng):
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(int(rng.integers(1 << 31)), count)
    return sampler

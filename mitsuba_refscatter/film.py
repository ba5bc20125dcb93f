"""Camera samples into the film: passes, filter, alpha, extra channels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from . import tolerances
from .core.sobol import PLACE, Batch, Sequence


@dataclass
class Frame:
    """A picture to be taken.

    sensor    Mitsuba's
    seed      of random numbers
    spp       samples per pixel; 0: as the sensor's sampler says
    sequence  that the places in the pixels are taken from, or None for those of the sampler
    most      camera samples in one pass, at most; a pass has at least one per pixel
    aovs      names of the extra channels
    progress  (share done), or None
    watch     (samples per pixel, image so far) -> how many are next (0: no more), or None; then the first pass is
              of one sample per pixel
    """

    sensor: mi.Sensor
    seed: int
    spp: int
    sequence: Sequence | None
    most: int
    aovs: list
    progress: Callable | None
    watch: Callable | None


def render(sample, frame, develop, evaluate):
    """Renders a ``Frame`` in passes.

    ``sample(sampler, ray, ray weight, active, batch, progress) -> (radiance, valid, extra channels)``;
    ``develop``, ``evaluate``: as in Mitsuba's ``Integrator.render``.
    """
    sensor, seed, spp = frame.sensor, frame.seed, frame.spp
    aovs, progress, watch = frame.aovs, frame.progress, frame.watch
    film, sampler = sensor.film(), sensor.sampler().clone()
    if spp:
        sampler.set_sample_count(spp)
    spp = sampler.sample_count()
    if watch is not None:
        sampler = mi.load_dict({"type": "independent"})  # others do not take any number of samples
    border = film.rfilter().border_size() if film.sample_border() else 0
    size = film.crop_size() + 2 * border
    pixels = int(size[0]) * int(size[1])
    most = max(1, frame.most // pixels)
    film.prepare(aovs)
    block, done, per_pass, seeded = film.create_block(), 0, 1 if watch else _divisor(spp, most), 0
    coalesce = block.coalesce()
    while done < spp and per_pass > 0:
        if per_pass != seeded:
            if watch is not None:
                sampler.set_sample_count(per_pass)
            sampler.set_samples_per_wavefront(per_pass)
            sampler.seed(seed if done == 0 else sample_seed(seed, done), pixels * per_pass)
            block.set_coalesce(coalesce and per_pass >= tolerances.COALESCED)
            seeded = per_pass
        batch = Batch(done, per_pass)
        ray, weight, position = _rays(frame, sampler, border, batch)
        report = (
            None if progress is None else lambda x, batch=batch: progress((batch.first + x * batch.per_pixel) / spp)
        )
        value, valid, extra = sample(sampler, ray, weight, True, batch, report)
        _put(block, film, position, (value * weight, valid, extra), ray.wavelengths)
        sampler.advance()
        sampler.schedule_state()
        dr.eval(block.tensor())
        done += per_pass
        if watch is not None:
            per_pass = min(watch(done, _developed(film, block)), most)
    film.clear()
    film.put_block(block)
    if progress is not None:
        progress(1.0)
    if not develop:
        return mi.TensorXf()
    image = film.develop()
    dr.schedule(image)
    if evaluate:
        dr.eval()
        dr.sync_thread()
    return image


def sample_seed(seed, done):
    """A seed for samples from number ``done`` on."""
    return int(mi.sample_tea_32(mi.UInt32(seed), done)[0][0])


def _developed(film, block):
    film.clear()
    film.put_block(block)
    return film.develop()


def _divisor(spp, most):
    """The largest divisor of ``spp`` that is at most ``most``."""
    return max(k for k in range(1, min(spp, most) + 1) if spp % k == 0)


def _rays(frame, sampler, border, batch):
    """One wavefront of camera rays, their weights, and their places on the film. ``border``: pixels around it
    that are sampled, too."""
    sensor, sequence = frame.sensor, frame.sequence
    film = sensor.film()
    size = film.crop_size() + 2 * border
    width, n = dr.opaque(mi.UInt32, int(size[0])), int(size[0]) * int(size[1]) * batch.per_pixel
    pixel, _ = batch.split(n)
    corner = mi.Point2f(film.crop_offset()) - float(border)
    whole = mi.Point2f(mi.Float(pixel % width), mi.Float(pixel // width)) + corner
    position = whole + (sampler.next_2d() if sequence is None else sequence.own(PLACE, batch, n))
    scaled = (position - mi.Point2f(film.crop_offset())) / mi.Point2f(film.crop_size())
    aperture = sampler.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0.5)
    time = sensor.shutter_open()
    if sensor.shutter_open_time() > 0:
        time += sampler.next_1d() * sensor.shutter_open_time()
    wavelength = sampler.next_1d() if mi.is_spectral else mi.Float(0)
    ray, weight = sensor.sample_ray_differential(time, wavelength, scaled, aperture)
    ray = mi.Ray3f(ray)
    dr.eval(ray, weight, position)
    # With a box filter the offset inside the pixel must not matter, not even by rounding.
    return ray, weight, whole if film.rfilter().is_box_filter() else position


def _put(block, film, position, found, wavelengths):
    value, valid, extra = found
    alpha = dr.select(valid, mi.Float(1), mi.Float(0))
    if mi.has_flag(film.flags(), mi.FilmFlags.Special):
        block.put(
            position, film.prepare_sample(value, wavelengths, block.channel_count(), weight=mi.Float(1), alpha=alpha)
        )
        return
    channels = to_rgb(value, wavelengths)
    if mi.has_flag(film.flags(), mi.FilmFlags.Alpha):
        channels = channels + [alpha]
    block.put(position, channels + [mi.Float(1)] + extra)


def to_rgb(value, wavelengths):
    """A spectrum as three channels, as Mitsuba's films store it."""
    if mi.is_spectral:
        value = mi.spectrum_to_srgb(value, wavelengths)
    elif mi.is_monochromatic:
        value = mi.Color3f(value.x)
    return [value.x, value.y, value.z]

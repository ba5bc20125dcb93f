"""One camera ray looked at closely: where along it light is scattered, and which triangles refract it there."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import options, platform, tolerances
from ..core.cache import Cache
from ..core.sobol import Batch
from ..estimators import point, profile, wavefront
from ..integrators import messages, single_scattering
from ..integrators.prepared import prepare
from ..light import light_samples
from ..scene import refuse_gradients, region_of_camera
from ..transport import camera_paths
from .beams import light_beams
from .curves import curve_of, peaks
from .records import Boundary, Curve, Light, LightCells, PointSamples, Probe, Segment, Triangles


class ProbeError(ValueError):
    """A ray that cannot be probed: the reason and what to do."""


def probe(
    scene: mi.Scene,
    x: int,
    y: int,
    *,
    sensor: int = 0,
    segment: int = 0,
    parts: int = 512,
    samples: int = 64,
    tolerance: float = 1e-3,
    internal_bounces: int = 4,
    culling: str = "beams",
) -> Probe:
    """The radiance per unit length along the camera ray through the middle of a pixel.

    scene             loaded in the variant that is set (rgb or mono)
    x, y              pixel of the image, from its upper left corner
    sensor            its number in the scene
    segment           number of the ray's segment in regions that scatter, the one with the largest weight first
    parts             equal ones of the segment over which the total is averaged, >= 2
    samples           of the estimator ``point``, >= 1
    tolerance         as of the integrator, for the light beams that are shown; along the ray triangles are exact
    internal_bounces  as of the integrator
    culling           as of the integrator

    All lights that are one point or direction are summed. Others are left out, and named in the result.

    Raises ``ProbeError`` for a scene without such lights, a pixel outside of the image, and a ray without such a
    segment. It does so for too few parts or samples and for spectral variants, too.
    Raises ``scene.SceneError`` as the integrator does.
    """
    _check(scene, sensor, parts, samples)
    with dr.suspend_grad():
        prepared, left_out = _prepared(scene, tolerance, internal_bounces, culling)
        film_sensor = scene.sensors()[sensor]
        ray = _camera_ray(film_sensor, x, y)
        ends = [_numbers(x) for x in (ray.o, ray.d)]
        messages.Messages().warn(messages.lights_at_the_camera(prepared.scene, ends))
        start = region_of_camera(prepared.scene, film_sensor.get_medium(), ends[0][0])
        limits = camera_paths.ChainLimits(internal_bounces, False, prepared.accuracy.weight)
        paths = camera_paths.trace(prepared.scene, ray, True, start, limits)
        segments, places = _segments(prepared.scene, paths)
        if not segments:
            raise ProbeError(
                f"the ray through pixel ({x}, {y}) meets no body that scatters light: "
                "choose a pixel in which one is seen"
            )
        if not 0 <= segment < len(segments):
            raise ProbeError(
                f"the ray through pixel ({x}, {y}) has no segment number {segment}: "
                f"it has {len(segments)}, counted from 0"
            )
        one = _Along(prepared, places[segment], paths, ray, parts)
        found = _probe((x, y), segments, segment, one, samples, left_out)
        found.beams = light_beams(scene, tolerance) if tolerance > 0 and culling == "beams" else []
        return found


def _check(scene, sensor, parts, samples):
    """Refuse what can't be probed, whatever the ray."""
    platform.require_usable(mi.variant())
    if mi.is_spectral:
        raise ProbeError("a probe has no wavelengths of its own: set an rgb or mono variant")
    if not 0 <= sensor < len(scene.sensors()):
        raise ProbeError(f"the scene has no sensor number {sensor}: it has {len(scene.sensors())}, counted from 0")
    if parts < 2 or samples < 1:
        raise ProbeError(f"{parts} parts and {samples} samples are too few: take at least 2 and 1")
    refuse_gradients(scene)


def _prepared(scene, tolerance, internal_bounces, culling):
    """``Prepared`` for exact roots on the meshes themselves, and the names of the lights that are left out.

    It has those of the lights that are one point or direction.
    """
    changes = {"newton": tolerances.accuracy(0.0).newton, "samples_visibility": False, "cells": 0.0}
    chosen = options.Options(
        tolerance=float(tolerance), internal_bounces=internal_bounces, culling=culling, surfaces=False
    )
    prepared = prepare(scene, chosen, Cache(), lambda: 0, changes=changes)
    exact = [emitter for emitter in prepared.scene.emitters if not emitter.drawn]
    left_out = [emitter.name for emitter in prepared.scene.emitters if emitter.drawn]
    if not exact:
        raise ProbeError(
            f"{' and '.join(left_out)} is not one point or direction, of which alone light can be followed to a ray: "
            "add a point, spot, projector or directional light"
        )
    return replace(prepared, scene=replace(prepared.scene, emitters=exact), sequence=None), left_out


def _camera_ray(sensor, x, y):
    """The ray through the middle of pixel (x, y) of the image, as ``film.render`` makes it."""
    width, height = (int(n) for n in sensor.film().crop_size())
    if not (0 <= x < width and 0 <= y < height):
        raise ProbeError(
            f"pixel ({x}, {y}) is outside of the film, which has {width} x {height} pixels: "
            f"x must be from 0 to {width - 1}, y from 0 to {height - 1}"
        )
    place = dr.opaque(mi.Point2f, [(x + 0.5) / width, (y + 0.5) / height])
    ray, _ = sensor.sample_ray_differential(sensor.shutter_open(), 0.0, place, mi.Point2f(0.5))
    return mi.Ray3f(ray)


def _segments(scene, paths):
    """All segments in regions that scatter, the largest weight first, and of each the region and its number there."""
    found = []
    for region in scene.regions:
        along = paths.segments(region)
        if along is not None:
            numbers = [_numbers(x) for x in (along.start(), along.direction, along.length, along.weight)]
            found += [
                (Segment(o, d, float(t[0]), w, region.name), (region, i))
                for i, (o, d, t, w) in enumerate(zip(*numbers))
            ]
    found.sort(key=lambda entry: -entry[0].weight.mean())
    return [segment for segment, _ in found], [place for _, place in found]


def _first_leg(scene, ray):
    """Where a camera ray starts and where it first meets a surface (2, 3); the start twice if it meets none."""
    hit = scene.mi_scene.ray_intersect_preliminary(ray)
    return np.concatenate([_numbers(x) for x in (ray.o, ray.o + dr.select(hit.is_valid(), hit.t, 0) * ray.d)])


def _numbers(x):
    """A Dr.Jit array as float64 (lanes, components)."""
    return np.atleast_2d(x.numpy().astype(np.float64).T).reshape(dr.width(x), -1)


class _Along:
    """One segment of a camera ray: the light that comes to it.

    prepared          the scene
    region            that the segment is in
    ray               mi.Ray3f, the camera's
    parts             equal ones over which radiance is averaged
    segment           ``CameraSegments`` of one lane
    length            of it
    sigma_s, sigma_t  the region's coefficients (Spectrum)
    """

    def __init__(self, prepared, place, paths, ray, parts):
        region, number = place
        self.prepared, self.region, self.ray, self.parts = prepared, region, ray, parts
        self.segment = paths.segments(region).gather(dr.opaque(mi.UInt32, number, 1))
        self.segment.sample = dr.opaque(mi.UInt32, 0, 1)
        dr.eval(self.segment)  # Dr.Jit 1.5.0 widens an unevaluated x itself where it computes x + 0
        self.length = float(self.segment.length[0])
        self.sigma_s, self.sigma_t = region.coefficients(ray.wavelengths, self.segment.direction)

    def pieces(self, n):
        """``camera_paths.Paths`` of n equal parts of the segment, each a camera sample of its own."""
        i, one = dr.arange(mi.UInt32, n), self.segment
        step = dr.opaque(mi.Float, self.length / n)
        t = mi.Float(i) * step
        weight = one.weight * dr.exp(-self.sigma_t * t)
        # The origin moves, not the offset: light that is not refracted is summed from there on, off the boundary.
        pieces = replace(
            one, origin=one.origin + t * one.direction, offset=one.offset + 0 * t, length=step + 0 * t,
            direction=one.direction + mi.Vector3f(0 * t), weight=weight, sample=i,
        )  # fmt: skip
        paths = camera_paths.Paths([[] for _ in self.prepared.scene.regions], [], [], mi.Bool(True))
        paths.parts[self.region.index].append(pieces)
        dr.eval(pieces)
        return paths

    def estimate(self, n=1, refracted=True):
        """Radiance (n, C) that the estimator finds for each of n equal parts of the segment.

        refracted  whether of all light; else only of light that is not refracted
        """
        rays = dr.gather(mi.Ray3f, self.ray, dr.zeros(mi.UInt32, n))  # each part is a camera sample of its own
        samples = single_scattering.Samples(rays, Batch())
        found = single_scattering.scatter(self.prepared, self.pieces(n), samples, wavefront.Counts(), refracted)
        return _numbers(found.value)

    def lights(self):
        """For all lights and boundaries that refract their light: what their light is found with.

        Yields number of the light, number of the boundary, boundary, ``Illumination``, ``Culling``, and the factor
        (Spectrum) of what is found.
        """
        wavelengths = self.ray.wavelengths
        for i, emitter in enumerate(self.prepared.scene.emitters):
            sample = light_samples.exact(emitter)
            value = sample.intensity(wavelengths)
            for k, body in enumerate(self.region.boundaries):
                illumination, culling = self.prepared.illuminated(body, self.region, sample, emitter, wavelengths)
                if culling is not None:
                    tint = body.tint("specular_transmittance", wavelengths)
                    yield i, k, body, illumination, culling, self.segment.weight * self.sigma_s * value * tint

    def sweep(self, segments, culling, illumination, estimator):
        """``wavefront.sweep`` with the accuracy of the probe."""
        return wavefront.sweep(segments, culling, illumination, estimator, wavefront.Run(self.prepared.accuracy))[0]

    def samples(self, n):
        """``PointSamples`` of n points for each light."""
        found, estimate = {}, 0.0
        for i, _, body, illumination, culling, factor in self.lights():
            segments = self.segment.from_boundary(body.centre, self.sigma_t)
            index, points, weight = point.sample_points(segments, illumination, 0, n, n, 0)
            dr.eval(index, points.o, weight)
            value = self.sweep(points, culling, illumination.at(index), point.Point()).value * factor
            t = dr.dot(points.o - segments.o, segments.d)
            estimate = estimate + _numbers(weight * value).sum(axis=0)
            density = _numbers(value * dr.exp(-self.sigma_t * t))
            found[i] = _numbers(t)[:, 0], found[i][1] + density if i in found else density
        lights = np.repeat(list(found), n).astype(int)
        channels = len(mi.Spectrum(0))
        t, density = (
            (np.concatenate(x) for x in zip(*found.values())) if found else (np.zeros(0), np.zeros((0, channels)))
        )
        return PointSamples(lights, t, density, np.zeros(channels) + estimate)


def _probe(pixel, segments, number, one, samples, left_out):
    """``Probe`` of a segment.

    pixel     (x, y)
    segments  of the whole ray
    number    of the one that is probed
    one       the same as ``_Along``
    samples   of the estimator ``point``, for each light
    left_out  names of lights
    """
    n, length = one.parts, one.length
    refracted, found = np.zeros((n, len(mi.Spectrum(0)))), []
    for light, boundary, body, illumination, culling, factor in one.lights():
        collected = profile.Profile(tolerances.PROFILE_CELLS)
        one.sweep(one.segment.from_boundary(body.centre, one.sigma_t), culling, illumination, collected)
        for cells in collected.found:
            refracted += _numbers(profile.means(cells, length, n) * factor)
            found.append((light, boundary, body, cells, factor))
    straight = one.estimate(n, refracted=False) * (n / length)
    curve, triangles, unresolved = curve_of(found, length)
    total = refracted + straight
    distance = (np.arange(n) + 0.5) * (length / n)
    integral = total.mean(axis=0) * length
    scene = one.prepared.scene
    return Probe(
        pixel=pixel, camera=_first_leg(scene, one.ray), segments=segments, segment=number, distance=distance,
        radiance=total, straight=straight, integral=integral, estimated=one.estimate()[0],
        unresolved=unresolved / max(integral.sum(), 1e-30), peaks=peaks(distance, total), curve=curve,
        triangles=triangles, samples=one.samples(samples), left_out=left_out,
        lights=[Light(emitter.name, _numbers(emitter.place.L)[0], emitter.place.distant) for emitter in scene.emitters],
        boundaries=[Boundary(body.name, body.corners) for body in one.region.boundaries], beams=[],
    )  # fmt: skip


__all__ = ["Boundary", "Curve", "Light", "LightCells", "PointSamples", "Probe", "ProbeError", "Segment", "Triangles",
           "light_beams", "probe"]  # fmt: skip

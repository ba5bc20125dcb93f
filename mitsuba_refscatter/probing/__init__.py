"""One camera ray looked at closely: where along it light is scattered, by which triangles, and on which ways it comes."""

from dataclasses import dataclass, replace

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
from .curves import Curve, Triangles, curve_of, peaks


class ProbeError(ValueError):
    """A ray that cannot be probed: the reason and what to do."""


@dataclass
class Segment:
    """A part of the camera ray in one region: ``origin`` and unit ``direction`` (3,), world; ``length``; ``weight`` (C,), by which
    radiance at its origin counts at the camera: Fresnel factors, indices of refraction, attenuation on the way; ``region``: its name."""

    origin: np.ndarray
    direction: np.ndarray
    length: float
    weight: np.ndarray
    region: str


@dataclass
class Samples:
    """What the estimator ``point`` samples. ``light`` (M,): number of the light that a sample is of; ``distance`` (M,); ``radiance``
    (M, C): per unit length, that the estimator finds there of this light, refracted; ``estimate`` (C,): its result for all lights."""

    light: np.ndarray
    distance: np.ndarray
    radiance: np.ndarray
    estimate: np.ndarray


@dataclass
class Light:
    """``position`` (3,), world, or the unit direction to the light if it is ``distant``."""

    name: str
    position: np.ndarray
    distant: bool


@dataclass
class Boundary:
    """A refracting boundary of the region: ``corners`` (F, 3, 3) of its triangles, world."""

    name: str
    corners: np.ndarray


@dataclass
class Probe:
    """Single scattering along one segment of a camera ray.

    Radiance is that which arrives at the camera, without the sensor's own weight, in W/(m^2 sr) if lights are in W/sr and m is the
    scene's unit; per unit length in that unit. C: channels of the variant, 3 (linear rgb) or 1 (mono). Distances are along the segment, from 0 to
    its length.

    ``pixel``: (x, y); ``camera`` (2, 3): where the ray starts and where it first meets a surface, world; ``segments``: all of the ray in regions that scatter, by weight, the
    largest first, and ``segment``: the number of the one that the rest is about. ``distance`` (N,): middles of N equal parts of
    it; ``radiance`` (N, C): total per unit length, mean over each part, ``straight`` (N, C): how much of it is by light that is not refracted.
    ``integral`` (C,): over the segment, and ``estimated`` (C,): the same as the estimator ``curve`` finds it; ``unresolved``: share of the
    integral where the linear light beam stood in for the curve. ``peaks`` (K,): distances of maxima of the luminance that stand out by
    ``tolerances.PEAK`` of the largest. ``curve``, ``triangles``: the light paths; ``samples``: those of the estimator ``point``.
    ``lights``, ``boundaries``: what the numbers in these mean; ``left_out``: names of lights that are not one point or direction, and not summed.
    """

    pixel: tuple
    camera: np.ndarray
    segments: list
    segment: int
    distance: np.ndarray
    radiance: np.ndarray
    straight: np.ndarray
    integral: np.ndarray
    estimated: np.ndarray
    unresolved: float
    peaks: np.ndarray
    curve: Curve
    triangles: Triangles
    samples: Samples
    lights: list
    left_out: list
    boundaries: list


def probe(
    scene, x, y, *, sensor=0, segment=0, parts=512, samples=64, tolerance=1e-3, internal_bounces=4, culling="beams"
):
    """The radiance per unit length along the camera ray through the middle of a pixel (``Probe``).

    ``scene``: ``mi.Scene``, loaded in the variant that is set (rgb or mono); ``x``, ``y``: pixel of the image from its upper left corner; ``sensor``: its
    number in the scene; ``segment``: which of the ray's segments in regions that scatter, by weight from the largest on; ``parts`` (>= 2): of
    it, equal ones, over which the total is averaged; ``samples`` (>= 1): of the estimator ``point``; ``tolerance``, ``internal_bounces``, ``culling``: as
    of the integrator, but that no coarser mesh takes a body's place and roots are exact to float32.

    All lights that are one point or direction are summed; others are left out, and named in the result. Raises ``ProbeError`` where there are only
    others, for a pixel outside of the image, a ray without such a segment, too few parts or samples, and spectral variants; ``scene.SceneError`` as
    the integrator does.
    """
    platform.require_usable(mi.variant())
    if mi.is_spectral:
        raise ProbeError("a probe has no wavelengths of its own: set an rgb or mono variant")
    if not 0 <= sensor < len(scene.sensors()):
        raise ProbeError(f"the scene has no sensor number {sensor}: it has {len(scene.sensors())}, counted from 0")
    if parts < 2 or samples < 1:
        raise ProbeError(f"{parts} parts and {samples} samples are too few: take at least 2 and 1")
    refuse_gradients(scene)
    with dr.suspend_grad():
        prepared, left_out = _prepared(scene, tolerance, internal_bounces, culling)
        film_sensor = scene.sensors()[sensor]
        ray = _camera_ray(film_sensor, x, y)
        ends = [_numbers(x) for x in (ray.o, ray.d)]
        messages.Messages().warn(messages.lights_at_the_camera(prepared.scene, ends))
        start = region_of_camera(prepared.scene, film_sensor.get_medium(), ends[0][0])
        limits = camera_paths.Limits(internal_bounces, False, prepared.accuracy.weight)
        paths = camera_paths.trace(prepared.scene, ray, True, start, limits)
        found = _segments(prepared.scene, paths)
        if not found:
            raise ProbeError(
                f"the ray through pixel ({x}, {y}) meets no body that scatters light: choose a pixel in which one is seen"
            )
        if not 0 <= segment < len(found):
            raise ProbeError(
                f"the ray through pixel ({x}, {y}) has no segment number {segment}: it has {len(found)}, counted from 0"
            )
        segments, places = zip(*found)
        one = _Along(prepared, places[segment], paths, ray, parts)
        return _probe((x, y), ray, list(segments), segment, one, samples, left_out)


def _prepared(scene, tolerance, internal_bounces, culling):
    """``Prepared`` for exact roots on the meshes themselves, with those of the lights that are one point or direction, and the names of the others."""
    changes = {"newton": tolerances.accuracy(0.0).newton, "coarse": 0.0, "samples_visibility": False}
    chosen = options.Options(
        tolerance=float(tolerance), internal_bounces=internal_bounces, culling=culling, surfaces=False
    )
    prepared = prepare(scene, chosen, Cache(), lambda: 0, changes=changes)
    exact = [emitter for emitter in prepared.scene.emitters if not emitter.drawn]
    left_out = [emitter.name for emitter in prepared.scene.emitters if emitter.drawn]
    if not exact:
        raise ProbeError(f"{' and '.join(left_out)} is not one point or direction, of which alone light can be followed to a ray: add a point, "
                         "spot, projector or directional light")  # fmt: skip
    prepared.scene, prepared.sequence = replace(prepared.scene, emitters=exact), None
    return prepared, left_out


def _camera_ray(sensor, x, y):
    """The ray through the middle of pixel (x, y) of the image, as ``film.render`` makes it."""
    width, height = (int(n) for n in sensor.film().crop_size())
    if not (0 <= x < width and 0 <= y < height):
        raise ProbeError(f"pixel ({x}, {y}) is outside of the film, which has {width} x {height} pixels: x must be from 0 to {width - 1}, "
                         f"y from 0 to {height - 1}")  # fmt: skip
    place = dr.opaque(mi.Point2f, [(x + 0.5) / width, (y + 0.5) / height])
    ray, _ = sensor.sample_ray_differential(sensor.shutter_open(), 0.0, place, mi.Point2f(0.5))
    return mi.Ray3f(ray)


def _segments(scene, paths):
    """Of all segments in regions that scatter, the one with the largest weight first: ``(Segment, (region, number there))``."""
    found = []
    for region in scene.regions:
        along = paths.segments(region)
        if along is not None:
            numbers = [_numbers(x) for x in (along.start(), along.direction, along.length, along.weight)]
            found += [
                (Segment(o, d, float(t[0]), w, region.name), (region, i))
                for i, (o, d, t, w) in enumerate(zip(*numbers))
            ]
    return sorted(found, key=lambda entry: -entry[0].weight.mean())


def _first_leg(scene, ray):
    """Where a camera ray starts and where it first meets a surface (2, 3); the start twice if it meets none."""
    hit = scene.mi_scene.ray_intersect_preliminary(ray)
    return np.concatenate([_numbers(x) for x in (ray.o, ray.o + dr.select(hit.is_valid(), hit.t, 0) * ray.d)])


def _numbers(x):
    """A Dr.Jit array as float64 (lanes, components)."""
    return np.atleast_2d(x.numpy().astype(np.float64).T).reshape(dr.width(x), -1)


class _Along:
    """One segment of a camera ray: the light that comes to it."""

    def __init__(self, prepared, place, paths, ray, parts):
        region, number = place
        self.prepared, self.region, self.ray, self.parts = prepared, region, ray, parts
        self.segment = paths.segments(region).gather(dr.opaque(mi.UInt32, number, 1))
        self.segment.sample = dr.opaque(mi.UInt32, 0, 1)
        dr.eval(self.segment)  # Dr.Jit 1.5.0 widens an unevaluated x itself where it computes x + 0
        self.length = float(self.segment.length[0])
        self.sigma_s, self.sigma_t = region.coefficients(ray.wavelengths, self.segment.direction)

    def pieces(self, n):
        """``camera_paths.Paths`` of n equal parts of the segment, each a camera sample of its own, and the mean radiance per length of a sum over one."""
        i, one = dr.arange(mi.UInt32, n), self.segment
        step = dr.opaque(mi.Float, self.length / n)
        t = mi.Float(i) * step
        weight = one.weight * dr.exp(-self.sigma_t * t)
        # The origin moves, not the offset: light that is not refracted is summed from there on, off the boundary.
        pieces = replace(
            one, origin=one.origin + t * one.direction, offset=one.offset + 0 * t, direction=one.direction + mi.Vector3f(0 * t),
            length=step + 0 * t, weight=weight, sample=i,
        )  # fmt: skip
        paths = camera_paths.Paths([[] for _ in self.prepared.scene.regions], [], False, mi.Bool(True))
        paths.parts[self.region.index].append(pieces)
        dr.eval(pieces)
        return paths

    def estimate(self, n=1, refracted=True):
        """Radiance (n, C) that the estimator finds for each of n equal parts of the segment; without ``refracted`` only of light that is not."""
        samples = single_scattering.Samples(self.ray, Batch())
        found = single_scattering.scatter(self.prepared, self.pieces(n), samples, wavefront.Counts(), refracted)
        return _numbers(found.value)

    def lights(self):
        """For all lights and boundaries that refract their light: their numbers, the body, ``Illumination``, culling, and the factor of
        what is found."""
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
        """``Samples`` of n points for each light."""
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
        return Samples(lights, t, density, np.zeros(channels) + estimate)


def _probe(pixel, ray, segments, number, one, samples, left_out):
    """``Probe`` of a segment."""
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
        pixel=pixel, camera=_first_leg(scene, ray), segments=segments, segment=number, distance=distance, radiance=total, straight=straight,
        integral=integral, estimated=one.estimate()[0], unresolved=unresolved / max(integral.sum(), 1e-30), peaks=peaks(distance, total),
        curve=curve, triangles=triangles, samples=one.samples(samples),
        lights=[Light(emitter.name, _numbers(emitter.place.L)[0], emitter.place.distant) for emitter in scene.emitters],
        left_out=left_out, boundaries=[Boundary(body.name, body.corners) for body in one.region.boundaries],
    )  # fmt: skip


__all__ = ["Boundary", "Curve", "Light", "Probe", "ProbeError", "Samples", "Segment", "Triangles", "probe"]

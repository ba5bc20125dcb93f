"""Single scattering of all lights in all regions: which light points, through which boundaries, onto which segments."""

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import lanes, tolerances, visibility, wavefront
from ..air import Air, Arrival
from ..culling import beams as light_beams
from ..culling.clearance import Clearance, estimate
from ..culling.spindle import Spindle
from ..estimators import curve, interval, point, straight
from ..estimators.lighting import Lighting, Sums
from ..geometry import triangle
from ..kept import BeamsKey, ChoiceKey, LevelsKey, RecordsKey, TreeKey, digest
from ..scene import coarse, holds, parameters, read, region_of_camera
from ..scene import lights as light_points
from ..sequence import LIGHT, Sequence
from . import coarseness

ESTIMATORS = {"curve": curve, "interval": interval, "point": point}


class Prepared:
    """What one render needs to know of a scene, read once: records, accuracy, estimator, culling; and, where lights must be
    drawn, the numbers that ``seed()`` gives. ``straight``: whether light is never refracted; ``whole``: whether it is for a whole image."""

    def __init__(self, scene, opt, seed, kept, straight=False, changes=None):
        self.kept, self._given, self.whole = kept, scene, False
        kept.next_round()
        self.scene = read(scene, opt.tolerance, kept, straight)
        self.accuracy = replace(tolerances.accuracy(opt.tolerance), **(changes or {}))
        if opt.samples:
            self.accuracy = replace(
                self.accuracy, interval_samples=opt.samples, point_samples=opt.samples, adapts=False
            )
        self.estimator, self.culling, self.light_samples = ESTIMATORS[opt.estimator], opt.culling, opt.light_samples
        self.counts, self._made = wavefront.Counts(), {}
        drawn = any(light.exact is None for light in self.scene.lights)
        self.sequence = Sequence(seed()) if drawn else None

    def once(self, make, *key):
        """What ``make()`` makes in this render at the first use of ``key``, which need not name the scene, the camera or options."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]

    def start(self, medium, ray):
        """Index of the region in which camera rays start."""
        return self.once(lambda: region_of_camera(self.scene, medium, _ends_of(ray)[0][0]), "start")

    def warn_of_lights_at(self, ray):
        """Says once which lights are where camera rays come from, unless the estimator finds what these send straight back."""
        if self.estimator is not point:
            self.once(lambda: self._warn_of(self.scene.lights_at(*_ends_of(ray))), "lights at the camera")

    def _warn_of(self, names):
        for name in names:
            mi.Log(mi.LogLevel.Warn, f"refscatter: {name} is at the camera: of what it sends straight back most is not found. Move it aside "
                   f'by {2 * tolerances.AT_CAMERA:g} of its distance from the body, or set estimator to "point".')  # fmt: skip

    def angle_panels(self, region):
        """``straight.angle_panels`` of a region's phase function."""
        return self.once(lambda: straight.angle_panels(region.phase, self.accuracy), "panels", region.index)

    def pace(self, body):
        """``wavefront.Pace`` for a body."""
        return self.once(wavefront.Pace, "pace", body.index, body.key)

    def through_media(self, body):
        """Whether light comes to a boundary through a medium or straight through other boundaries."""
        outside = self.scene.regions[body.outside] if body.outside != lanes.NONE else None
        return self.scene.straight is not None or (outside is not None and outside.medium is not None)

    def records(self, body):
        """The packed triangles of a body, and maybe others."""
        if body.stands_for is None:
            return self.scene.records
        return self.kept.once(lambda: triangle.Patches(lanes.array(mi.Float, body.packed())), self._records_key(body))

    def _records_key(self, body):
        return self.scene.records_key if body.stands_for is None else RecordsKey((body.key,))

    def instead(self, body, region, light, light_point, segments, sigma_t):
        """The body, or one with a coarser mesh that refracts the light of a ``light`` as well as the tolerance asks for."""
        error = self.accuracy.coarse
        if error == 0 or self.culling != "beams" or self.estimator is not curve or light.exact is None:
            return body  # of a light of many points the error at one of them says little about the others
        turns = coarseness.turns(error)
        levels = self.kept.once(lambda: coarse.levels(body, *turns), LevelsKey(body.key, *turns))
        if len(levels) == 1:
            return body
        once = self.once if self.scene.geometry is None else self.kept.once

        def choose():
            some = coarseness.some(len(segments))
            part, extinction = segments.gather(some), lanes.of(sigma_t, some)

            def radiance(level):
                lit = self.lit(level.of(body, self.scene, once), region, light_point, part.wavelengths)
                local = part.from_boundary(body.centre, extinction)
                return coarseness.radiance(local, part.weight, *lit, self.accuracy, self.estimator)

            def measure(i, j):
                a, b = radiance(levels[i]), radiance(levels[j])
                return coarseness.relative(np.abs(a - b), b)

            measured_on = *vars(part).values(), extinction
            dr.eval(measured_on)
            place = body.key, region.index, light.index
            key = ChoiceKey(self._given, self._parameters(), digest(*measured_on), *place, self.accuracy)
            return self.kept.once(lambda: coarseness.suitable([x.turn for x in levels], error, measure), key)

        chosen = self.once(choose, "choice", body.index, body.key, region.index, light.index)
        return levels[chosen].of(body, self.scene, once)

    def _parameters(self):
        return self.once(lambda: parameters(self._given), "parameters")

    def shadows(self, body, light_point):
        """``visibility.Shadows`` of a light point."""
        source = light_point.source(dr.opaque(mi.Float, body.eta), dr.opaque(mi.Point3f, body.centre))
        dr.eval(source.L)
        return visibility.Shadows(
            self.scene,
            body,
            self.records(body),
            source,
            light_point.shape,
            self.through_media(body),
            self.accuracy.samples_visibility,
        )

    def lighting(self, body, region, light_point, shadows, wavelengths=None):
        """``Lighting`` of light points in the region inside a boundary. ``wavelengths``: of the camera segments."""
        centre = dr.opaque(mi.Point3f, body.centre)
        source = light_point.source(dr.opaque(mi.Float, body.eta), centre)
        emission = light_point.emission(centre, wavelengths)
        if self.through_media(body):
            emission = Arrival(emission, source, Air(self.scene, wavelengths), body)
        side = (body.eta > 1) - (body.eta < 1)
        return Lighting(
            source, side, region.phase, shadows.lit, shadows.inside, emission, region.directed, shadows.guests
        )

    def lit(self, body, region, light_point, wavelengths=None, key=None, drawn=False):
        """``(lighting, culling)`` of a light point in the region inside a boundary, made once per ``key`` if that is given; the
        culling is None if nothing is lit. ``drawn``: whether it is one of many, whose culling is not kept for other renders."""

        def make():
            shadows = self.shadows(body, light_point)
            return shadows, self._culling(body, shadows, drawn)

        shadows, culling = make() if key is None else self.once(make, "lit", body.index, body.key, key)
        return self.lighting(body, region, light_point, shadows, wavelengths), culling

    def _clearance(self, body):
        corners, key = body.corners - body.centre, TreeKey("clearance", self.scene.records_key, body.first_record)
        return self.kept.once(lambda: Clearance(self.scene.records, body.first_record, corners), key)

    def _culling(self, body, shadows, drawn):
        records, key, source = self.records(body), self._records_key(body), shadows.light
        if self.culling == "spindle":
            return self.kept.once(lambda: Spindle(body, records), TreeKey("spindle", key, body.first_record))
        if drawn or self.scene.geometry is None or dr.width(source.L) > 1:
            return self._beams(body, shadows)
        key = BeamsKey(
            body=body.key, records=key, first_record=body.first_record, geometry=self.scene.geometry,
            distant=source.distant, L=tuple(np.array(source.L).ravel().tolist()),
            lit=shadows.lit is not None, accuracy=self.accuracy,
        )  # fmt: skip
        return self.kept.once(lambda: self._beams(body, shadows), key)

    def _beams(self, body, shadows):
        clear = None
        if shadows.may_prove_inside and self.accuracy.samples_visibility:
            clear = estimate(lambda P, Ng, omega: shadows.reach(P, Ng, omega, None), shadows.light)
        elif shadows.may_prove_inside:
            clear = self._clearance(body.stands_for or body).clear
        key = TreeKey("order", self._records_key(body), body.first_record)
        order = self.kept.once(lambda: light_beams.order_of(body), key)
        return light_beams.build(
            body, self.records(body), order, shadows.light, self.accuracy.bend, shadows.seen, clear
        )


@dataclass
class Turn:
    """A light point and the camera samples that it is for.

    ``slot``: per camera sample the lane of ``point`` (and of ``value``, its intensities, where these are known), or
    NONE; None where the one point is for all of them.
    """

    light: object
    point: object
    slot: object = None
    value: object = None


def turns(prepared, n, wavelengths, batch):
    """The light points for ``n`` camera samples: the exact lights for all of them; of the others one for each sample, of a pool
    that all share (light beams are made for each of its points), or of its own."""
    lights = prepared.scene.lights
    out = [Turn(light, light.exact) for light in lights if light.exact is not None]
    if prepared.sequence is None:
        return out
    if prepared.culling == "beams":
        numbers, which = prepared.sequence.shared(prepared.light_samples, batch, n)
        dr.eval(which)
        for k, (u, v) in enumerate(numbers):
            light, one = light_points.at(lights, u, v)
            dr.eval(one.L, one.normal)
            out.append(Turn(light, one, dr.select(which == dr.opaque(mi.UInt32, k), mi.UInt32(0), lanes.NONE)))
        return out
    for light, samples, points in light_points.one_each(lights, prepared.sequence.own(LIGHT, batch, n)):
        slot = dr.full(mi.UInt32, lanes.NONE, n)
        dr.scatter(slot, dr.arange(mi.UInt32, dr.width(samples)), samples)
        value = points.intensity(lanes.of(wavelengths, samples))
        dr.eval(points.L, points.normal, value, slot)
        out.append(Turn(light, points, slot, value))
    return out


def lit_by(segments, turn):
    """The segments that a ``Turn`` is for, its light points, one or one for each, and their intensities; None if there are none."""
    if turn.slot is None:
        return segments, turn.point, turn.point.intensity(segments.wavelengths)
    slot = dr.gather(mi.UInt32, turn.slot, segments.sample)
    kept = dr.compress(slot != lanes.NONE)
    if dr.width(kept) == 0:
        return None
    segments, slot = segments.gather(kept), dr.gather(mi.UInt32, slot, kept)
    if turn.value is None:
        return segments, turn.point, turn.point.intensity(segments.wavelengths)
    return segments, turn.point.of(slot), lanes.of(turn.value, slot)


def _ends_of(ray):
    """Origins and directions of the first and the last ray, (2, 3)."""
    ends = mi.UInt32(0, dr.width(ray) - 1)
    return [np.array(dr.gather(mi.Vector3f, mi.Vector3f(x), ends)).T for x in (ray.o, ray.d)]


def scatter(prepared, paths, ray, n, batch, seed, detail, progress, refracted=True):
    """Single scattering of all lights along all segments of the camera paths: ``Sums`` per camera sample, with the
    radiance itself as ``value``. ``refracted``: whether light that comes through refracting boundaries is summed, too."""
    scene, single = prepared.scene, Sums.nothing(n, detail)
    along = [(region, paths.segments(region)) for region in scene.regions if paths.parts[region.index]]
    work = [(*x, turn) for turn in turns(prepared, n, ray.wavelengths, batch) for x in along] if along else []
    if refracted and any(region.boundaries for region, _ in along):
        prepared.warn_of_lights_at(ray)
    for i, (region, segments, turn) in enumerate(work):
        taken = lit_by(segments, turn)
        if taken is None:
            continue
        report = None if progress is None else lambda done, total, i=i: progress((i + done / total) / len(work))
        if refracted:
            _refracted(prepared, region, turn.light, *taken, single, seed + i, detail, report)
        if goes_straight(region, turn.light, taken[1]):
            _straight(prepared, region, *taken, single)
    return single.first(n)


def _refracted(prepared, region, light, segments, light_point, value, single, seed, detail, report):
    """Adds light that comes in through the region's refracting boundaries."""
    sigma_s, sigma_t = region.coefficients(segments.wavelengths, segments.direction)
    key = None if light.exact is None else light.index
    for body in region.boundaries:
        body = prepared.instead(body, region, light, light_point, segments, sigma_t)
        lighting, culling = prepared.lit(body, region, light_point, segments.wavelengths, key, light.exact is None)
        if culling is None:
            continue
        sums, counts = wavefront.scatter(
            segments.from_boundary(body.centre, sigma_t),
            culling,
            lighting,
            prepared.accuracy,
            prepared.estimator,
            seed,
            detail,
            report,
            prepared.pace(body),
        )
        prepared.counts.add(counts)
        tint = body.tint("specular_transmittance", segments.wavelengths)
        single.add_all(sums, segments.weight * sigma_s * value * tint, segments.sample)


def goes_straight(region, light, light_point):
    """Whether light may come to where it is scattered in a region without refraction."""
    if region.admits or light_point.distant:
        return region.admits
    if region.body is None:
        return True
    if dr.width(light_point.L) == 1:
        return holds(region.body, np.array(light_point.L).ravel())
    low, high = region.body.box
    return bool((light.box[0] <= high).all() and (light.box[1] >= low).all())


def _straight(prepared, region, segments, light_point, value, single):
    """Adds light that comes straight."""
    scene = prepared.scene
    sigma_s, sigma_t = region.coefficients(segments.wavelengths, segments.direction)
    at = region.body.centre if region.body is not None else [0.0, 0.0, 0.0]
    centre = dr.opaque(mi.Point3f, at)
    air, start = Air(scene, segments.wavelengths), dr.opaque(mi.UInt32, region.index)

    def way(V, direction, distance, active):
        length = distance if light_point.distant else distance * (1 - tolerances.SHADOW_END)
        return air.follow(mi.Point3f(V) + centre, direction, length, start, active)

    free = dr.width(light_point.L) == 1 and not region.admits and _nothing_between(scene, region)
    total = straight.scatter(
        segments.off_boundary(at, sigma_t), light_point.source(mi.Float(1), centre),
        light_point.emission(centre, segments.wavelengths), region.phase, region.directed, None if free else way, prepared.accuracy,
        0 if light_point.distant else prepared.angle_panels(region),
    )  # fmt: skip
    dr.scatter_add(single.value, segments.weight * sigma_s * value * total, segments.sample)
    single.eval()


def _nothing_between(scene, region):
    """Whether any two points of a region see each other."""
    if region.body is None:
        return not scene.bodies and not scene.others
    others = scene.others + [body.shape for body in scene.bodies if body is not region.body]
    return region.body.convex and not any(visibility.meets(region.body, shape) for shape in others)

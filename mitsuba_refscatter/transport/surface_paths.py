"""Sampled paths from where the camera's deterministic chain ends, through media that absorb them.

At plain surfaces light is gathered by emitter and BSDF sampling with multiple importance sampling (Veach and Guibas
1995, balance heuristic). Boundaries are sampled as what they are. On every leg, also those to lights, media leave
exp(-sigma_t length); what they scatter is not followed.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..core import arrays
from ..scene import Scene
from .camera_paths import Legs
from .crossing import Hit
from .transmittance import Transmittance


@dataclass
class SurfaceLimits:
    """How far paths go.

    max_depth      edges of the longest path from the camera, those through boundaries that do not refract not
                   counted; -1: any number
    hide_emitters  whether emitters that the camera sees directly are left out
    """

    max_depth: int
    hide_emitters: bool


@dataclass
class _Path:
    """The state of paths.

    o, d        Point3f and Vector3f: the ray, world
    region      UInt32, the region around it, or NONE
    throughput  Spectrum, relative to the leg that it started as
    radiance    Spectrum, found so far, the same
    depth       UInt32, edges before the ray
    arrived     Bool, whether the throughput holds already what media take on the ray
    delta       Bool, whether the last vertex has a direction of no width, so that no light was sampled there
    pdf         Float, of the direction at the last vertex, 1/sr
    last        Point3f, that vertex
    eta         Float, index of refraction around the ray relative to where it started
    random      where random numbers come from
    seen        Bool, whether the first ray meets anything that can be seen
    active      Bool
    """

    o: mi.Point3f
    d: mi.Vector3f
    region: mi.UInt32
    throughput: mi.Spectrum
    radiance: mi.Spectrum
    depth: mi.UInt32
    arrived: mi.Bool
    delta: mi.Bool
    pdf: mi.Float
    last: mi.Point3f
    eta: mi.Float
    random: mi.PCG32
    seen: mi.Bool
    active: mi.Bool


class SurfacePaths:
    """Paths that go on from legs in a scene. ``ray``: the camera's, whose times and wavelengths count."""

    def __init__(self, scene: Scene, ray, legs: Legs, limits: SurfaceLimits):
        self.scene, self.legs, self.limits = scene, legs, limits
        self.max_depth = dr.opaque(mi.UInt32, (1 << 30) if limits.max_depth < 0 else limits.max_depth)
        self.time, self.wavelengths = (arrays.of(x, legs.sample) for x in (ray.time, ray.wavelengths))
        self.transmittance = Transmittance(scene, self.wavelengths, unbent=True)

    def radiance(self, arrived, seed):
        """Radiance (Spectrum) that arrives along the legs, without their weights, and whether they meet anything that
        is seen (Bool).

        arrived  whether the weights hold already what media take on the way to what legs meet first
        seed     of random numbers
        """
        legs = self.legs
        n = len(legs)
        o = self._past_emitters() if self.limits.hide_emitters else legs.o
        path = _Path(
            o=mi.Point3f(o),
            d=mi.Vector3f(legs.d),
            region=mi.UInt32(legs.region),
            throughput=dr.full(mi.Spectrum, 1, n),
            radiance=dr.zeros(mi.Spectrum, n),
            depth=mi.UInt32(legs.depth),
            arrived=dr.full(mi.Bool, arrived, n),
            delta=dr.full(mi.Bool, True, n),
            pdf=dr.full(mi.Float, 1, n),
            last=mi.Point3f(o),
            eta=dr.full(mi.Float, 1, n),
            random=mi.PCG32(size=n, initstate=dr.opaque(mi.UInt64, seed)),
            seen=dr.full(mi.Bool, False, n),
            active=dr.full(mi.Bool, True, n),
        )
        (end,) = dr.while_loop(
            (path,), lambda path: path.active, lambda path: (self._vertex(path),), label="surfaces", mode="symbolic"
        )
        return end.radiance, end.seen

    def _vertex(self, path):
        """One leg of each path, and what its end brings and does."""
        scene, limits = self.scene.mi_scene, self.limits
        ray = self._ray(path.o, path.d)
        pi = scene.ray_intersect_preliminary(ray, coherent=False, active=path.active)
        si = pi.compute_surface_interaction(ray, mi.RayFlags.All, path.active)
        hit = self._hit(path, pi)
        region = path.region if hit is None else dr.select(hit.boundary, hit.near, path.region)
        length = dr.select(si.is_valid(), si.t, tolerances.ENDLESS)
        throughput = path.throughput * dr.select(path.arrived, 1, self.transmittance.along(path.d, region, length))

        emitter = si.emitter(scene, path.active)
        visible = path.active & (path.depth < self.max_depth) & (emitter != None)  # noqa: E711 - lane by lane
        if limits.hide_emitters:
            visible &= path.depth > 0
        found = emitter.eval(si, visible) * self._weight_of_met(path, si, visible)
        radiance = path.radiance + dr.select(visible, throughput * found, 0)

        goes_on = path.active & si.is_valid() & (path.depth + 1 < self.max_depth)
        bsdf = si.bsdf(ray)
        lit = goes_on & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        random = path.random
        u = mi.Point2f(random.next_float32(), random.next_float32())
        there, arriving = self._from_emitters(si, region, u, lit)
        w, u = random.next_float32(), mi.Point2f(random.next_float32(), random.next_float32())
        value, pdf, sample, weight = bsdf.eval_pdf_sample(mi.BSDFContext(), si, si.to_local(there.d), w, u, goes_on)
        share = dr.select(there.delta, 1, _balance(there.pdf, pdf))
        radiance += dr.select(lit & (there.pdf != 0), throughput * value * arriving * share, 0)

        d = si.to_world(sample.wo)
        throughput *= weight
        passes = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
        # Behind a boundary that does not refract the last vertex still sees the lights. Other surfaces block its view.
        unseen = passes if hit is None else passes & ~hit.boundary
        vertex = ~passes | unseen
        if hit is not None:
            through = dr.dot(path.d, si.n) * dr.dot(d, si.n) > 0
            region = dr.select(hit.boundary, dr.select(through, hit.behind, hit.near), region)
        eta = path.eta * sample.eta
        depth = path.depth + dr.select(passes, mi.UInt32(0), 1)
        throughput, survives = _roulette(throughput, eta, depth, random)
        return _Path(
            o=mi.Point3f(si.spawn_ray(d).o),
            d=mi.Vector3f(d),
            region=region,
            throughput=throughput,
            radiance=radiance,
            depth=depth,
            arrived=mi.Bool(False),
            delta=dr.select(vertex, unseen | mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta), path.delta),
            pdf=dr.select(vertex, sample.pdf, path.pdf),
            last=mi.Point3f(dr.select(vertex, si.p, path.last)),
            eta=eta,
            random=random,
            seen=path.seen | (path.arrived & path.active & self._is_seen(si)),
            active=goes_on & survives & (dr.max(throughput) > 0),
        )

    def _ray(self, o, d):
        ray = mi.Ray3f(o, d)
        ray.time, ray.wavelengths = self.time, self.wavelengths
        return ray

    def _hit(self, path, pi):
        """``Hit``, where regions matter."""
        return Hit.of(self.scene, path.d, pi, path.active) if self.scene.regions else None

    def _weight_of_met(self, path, si, active):
        """The balance heuristic for emitters that are met."""
        last = dr.zeros(mi.SurfaceInteraction3f, dr.width(path.last))
        last.p = path.last
        there = mi.DirectionSample3f(self.scene.mi_scene, si, last)
        other = self.scene.mi_scene.pdf_emitter_direction(last, there, active & ~path.delta)
        return dr.select(path.delta, 1, _balance(path.pdf, other))

    def _from_emitters(self, si, region, u, active):
        """A sample of emitters (DirectionSample3f), and what comes straight from there over its density (Spectrum)."""
        there, weight = self.scene.mi_scene.sample_emitter_direction(si, u, False, active)
        active &= there.pdf != 0
        ray = si.spawn_ray_to(there.p)  # from off the surface, which may be nearer by more than an emitter is thick
        distance = ray.maxt
        if any(region.visible_range is not None for region in self.scene.regions):  # media without end
            endless = mi.has_flag(there.emitter.flags(), mi.EmitterFlags.Infinite)
            distance = dr.select(endless, tolerances.ENDLESS, distance)
        return there, weight * self.transmittance.follow(ray.o, ray.d, distance, region, active)[0]

    def _is_seen(self, si):
        """Whether what rays meet first is there for the alpha channel."""
        sky = self.scene.mi_scene.environment() is not None and not self.limits.hide_emitters
        return si.is_valid() | mi.Bool(sky)

    def _past_emitters(self):
        """Origins of the legs beyond the emitters that the camera sees first."""
        scene, legs = self.scene.mi_scene, self.legs

        def step(o, active):
            ray = self._ray(o, legs.d)
            si = scene.ray_intersect(ray, mi.RayFlags.Minimal, False, active)
            active &= si.is_valid() & si.shape.is_emitter()
            return dr.select(active, si.spawn_ray(legs.d).o, o), active

        state = mi.Point3f(legs.o), mi.UInt32(legs.depth) == 0
        return dr.while_loop(state, lambda _, active: active, step, label="hidden emitters", mode="symbolic")[0]


def _roulette(throughput, eta, depth, random):
    """Throughput of paths that go on, and which do (Bool), by what is left without what refraction does to radiance."""
    q = dr.minimum(dr.max(throughput) * dr.square(eta), tolerances.ROULETTE_MOST)
    plays = depth >= tolerances.ROULETTE_DEPTH
    survives = ~plays | (random.next_float32() < q)
    return dr.select(plays, throughput / dr.maximum(q, 1e-30), throughput), survives


def _balance(a, b):
    """The balance heuristic for two densities, 1/sr."""
    return dr.select(a + b > 0, a / (a + b), 0)

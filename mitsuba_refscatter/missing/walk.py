"""The way of photons: through boundaries by Fresnel's choice, through media, off surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..scene import NONE, media
from ..transport import crossing
from ..transport.crossing import Hit

KINDS = range(6)
COMPUTED, REFRACTED, INSIDE, REFLECTED, SURFACES, FURTHER = KINDS
"""What happened to light before it scatters: what is followed; one refraction too many; a reflection too many inside a
body; one by a mirror, a thin sheet or the outside of a body; one by a surface; another scattering. The last two hide
the others."""


@dataclass
class Met(Hit):
    """What rays meet, plain surfaces too.

    shape  UInt32, its number, of an instance that of this
    Ng, n  geometric and shading normal (unit), of boundaries outward
    p      Point3f, where (world)
    """

    shape: mi.UInt32
    Ng: mi.Vector3f
    n: mi.Vector3f
    p: mi.Point3f


def meet(scene, o, d, active):
    """``Met`` of rays (world)."""
    hit, ray = crossing.trace(scene, o, d, active), mi.Ray3f(o, d)
    boundary = hit.boundary
    plain, at = mi.Normal3f(0), mi.Point3f(0)
    if scene.others:  # else kernels hold no shapes' code
        si = hit.pi.compute_surface_interaction(ray, mi.RayFlags.Minimal, hit.valid & ~boundary)
        plain, at = si.n, si.p
    normals = (dr.select(boundary, n, mi.Vector3f(plain)) for n in (hit.tri.Ng, hit.tri.normal(*hit.uv)))
    on = dr.gather(mi.Point3f, scene.centre, hit.target, boundary) + hit.tri.position(*hit.uv)
    number, instance = (dr.reinterpret_array(mi.UInt32, x) for x in (hit.pi.shape, hit.pi.instance))
    number = dr.select(instance != 0, instance, number)
    return Met(**vars(hit), shape=number, **dict(zip(("Ng", "n"), normals)), p=mi.Point3f(dr.select(boundary, on, at)))


class Tables:
    """Media, boundaries and surfaces as tables for kernels. The region of no medium comes last."""

    def __init__(self, scene):
        self.size = dr.size_v(mi.Spectrum)
        none = [np.zeros(self.size)] * 2
        every = [none if region.medium is None else _coefficients(region) for region in scene.regions] + [none]
        self.sigma_s, self.sigma_t = (arrays.array(mi.Float, np.concatenate(x)) for x in zip(*every))
        self.visible_range = arrays.array(
            mi.Float, [region.visible_range or tolerances.ENDLESS for region in scene.regions] + [tolerances.ENDLESS]
        )
        self.last = dr.opaque(mi.UInt32, len(scene.regions))
        kinds = [body.kind for body in scene.bodies] or [""]
        self.refracts = arrays.array(mi.UInt32, [kind == "refracts" for kind in kinds])
        self.mirror = scene.mirrors if scene.mirrors is not None else dr.zeros(mi.Float, dr.width(scene.body_of_shape))

    def of(self, region):
        """Index, sigma_s, sigma_t and visible_range of regions."""
        index = dr.minimum(region, self.last)
        s, t = (
            mi.Spectrum(*(dr.gather(mi.Float, x, index * self.size + k) for k in range(self.size)))
            for x in (self.sigma_s, self.sigma_t)
        )
        return index, s, t, dr.gather(mi.Float, self.visible_range, index)


def _coefficients(region):
    found = region.coefficients(media.visible(), mi.Vector3f(0, 0, 1))
    return [np.array([np.ravel(x)[0] for x in spectrum]) for spectrum in found]


@dataclass
class Walk:
    """The state of photons.

    o            Point3f, world
    d            Vector3f, unit
    region       UInt32, where they are
    weight       Spectrum, W
    kind         UInt32, of COMPUTED ...
    bends        UInt32, number of refractions and reflections but for a first that is a refraction
    first        UInt32, number of the shape of the first refraction
    begun        Bool, whether there was any
    culprit      UInt32, number of the shape that makes the light one that is not computed
    random       where random numbers come from
    legs         UInt32, how many they have gone
    active       Bool
    """

    o: mi.Point3f
    d: mi.Vector3f
    region: mi.UInt32
    weight: mi.Spectrum
    kind: mi.UInt32
    bends: mi.UInt32
    first: mi.UInt32
    begun: mi.Bool
    culprit: mi.UInt32
    random: mi.PCG32
    legs: mi.UInt32
    active: mi.Bool


def follow(scene, photons, bounces):
    """What photons leave in media: by kind and region (kinds, R + 1), and by kind, region and shape that is the
    reason (kinds, R + 1, S). ``bounces``: as of the option ``light_bounces``."""
    n, regions = dr.width(photons.d), len(scene.regions) + 1
    albedo, tables, most = scene.albedos(), Tables(scene), dr.opaque(mi.UInt32, bounces)
    shapes = dr.width(albedo)
    left = dr.zeros(mi.Float, arrays.room(len(KINDS) * regions * (shapes + 1)))
    size = dr.opaque(mi.UInt32, regions), dr.opaque(mi.UInt32, shapes + 1)

    def leave(state, index, value):
        culprit = dr.minimum(state.culprit, size[1] - 1)
        dr.scatter_add(left, value, (state.kind * size[0] + index) * size[1] + culprit, state.active & (value > 0))

    zero, none = dr.zeros(mi.UInt32, n), dr.full(mi.UInt32, NONE, n)
    state = Walk(
        mi.Point3f(photons.o),
        mi.Vector3f(photons.d),
        mi.UInt32(photons.region),
        mi.Spectrum(photons.weight),
        zero,
        mi.UInt32(zero),
        none,
        dr.zeros(mi.Bool, n),
        mi.UInt32(none),
        mi.PCG32(size=n, initstate=1),
        mi.UInt32(zero),
        dr.full(mi.Bool, True, n),
    )
    limits = albedo, most
    dr.while_loop((state,), lambda state: state.active, lambda state: (_leg(state, scene, tables, limits, leave),),
                  label="missing", mode="symbolic")  # fmt: skip
    dr.eval(left)
    found = np.array(left)[: len(KINDS) * regions * (shapes + 1)].reshape(len(KINDS), regions, shapes + 1)
    return found.sum(axis=2), found[..., :-1]


def _leg(state, scene, tables, limits, leave):
    """One leg of photons and what ends it: a scattering or a surface. ``limits``: surfaces' albedos, and as of
    ``follow``."""
    albedo, bounces = limits
    met = meet(scene, state.o, state.d, state.active)
    # Where faces touch, the one that is met tells the region better than the one that was left.
    here = dr.select(met.boundary, met.near, state.region)
    index, sigma_s, sigma_t, visible_range = tables.of(here)
    length = dr.minimum(dr.select(met.valid, met.pi.t, tolerances.ENDLESS), visible_range)
    left = dr.exp(-sigma_t * length)
    leave(state, index, dr.mean(state.weight * sigma_s / dr.maximum(sigma_t, 1e-30) * (1 - left)))

    mean = dr.maximum(dr.mean(sigma_t), 1e-30)
    stopped = 1 - dr.exp(-mean * length)
    least = dr.select(state.kind == FURTHER, mi.Float(0), tolerances.MISSING_SCATTERED)
    p = dr.select(dr.mean(sigma_s) > 0, dr.clip(stopped, least, 1 - tolerances.MISSING_SCATTERED), 0)
    scatters = state.active & (state.random.next_float32() < p)
    t = -dr.log(dr.maximum(1 - state.random.next_float32() * stopped, 1e-30)) / mean
    after = sigma_s * dr.exp(-sigma_t * t) * stopped / dr.maximum(mean * dr.exp(-mean * t) * p, 1e-30)

    event, through, d, factor = _event(state, scene, tables, albedo, met)
    event = dr.select(scatters, FURTHER, event)
    refracted = ~scatters & (event == REFRACTED)
    counts = ~scatters & ((event == REFRACTED) | (event == INSIDE) | (event == REFLECTED))
    bends = state.bends + dr.select(counts & (state.begun | ~refracted), mi.UInt32(1), 0)
    first = dr.select(refracted & (state.first == NONE), met.shape, state.first)
    event = dr.select(counts & (bends <= bounces), COMPUTED, event)
    worse = (event != COMPUTED) & ((state.kind == COMPUTED) | ((event >= SURFACES) & (event > state.kind)))
    at = met.p
    start = at + dr.copysign(tolerances.MISSING_OFFSET * dr.max(dr.abs(at)), dr.dot(d, met.Ng)) * met.Ng
    anywhere = mi.warp.square_to_uniform_sphere(mi.Point2f(state.random.next_float32(), state.random.next_float32()))
    return Walk(
        o=mi.Point3f(dr.select(scatters, state.o + state.d * t, start)),
        d=mi.Vector3f(dr.select(scatters, anywhere, d)),
        region=dr.select(
            scatters, here, dr.select(met.boundary, dr.select(through, met.behind, met.near), state.region)
        ),
        weight=state.weight * dr.select(scatters, after, left / (1 - p) * factor),
        kind=dr.select(worse, event, state.kind),
        bends=bends,
        first=first,
        begun=state.begun | counts,
        culprit=dr.select(worse, dr.select(event == REFRACTED, first, met.shape), state.culprit),
        random=state.random,
        legs=state.legs + 1,
        active=state.active & (scatters | (met.valid & (factor > 0))) & (state.legs < tolerances.MISSING_LEGS),
    )


def _event(state, scene, tables, albedo, met):
    """What happens to photons at what they meet: the event, whether they go through it, their direction, what is
    left of them."""
    refracts = dr.gather(mi.UInt32, tables.refracts, met.target, met.boundary) > 0
    at, n = crossing.cross(scene, state.d, met, met.n), dr.select(dr.dot(state.d, met.n) < 0, met.n, -met.n)
    reflects = met.boundary & (state.random.next_float32() < at.F)
    mirror = met.valid & (dr.gather(mi.Float, tables.mirror, met.shape, met.valid) > 0)
    d = dr.select(reflects | mirror, at.reflected, at.refracted)
    plain = met.valid & ~met.boundary & ~mirror
    cosine = mi.warp.square_to_cosine_hemisphere(mi.Point2f(state.random.next_float32(), state.random.next_float32()))
    d = dr.select(plain, mi.Frame3f(n).to_world(cosine), d)
    event = dr.select(refracts, mi.UInt32(REFRACTED), COMPUTED)
    event = dr.select(reflects | mirror, dr.select(refracts & met.leaving, mi.UInt32(INSIDE), REFLECTED), event)
    factor = dr.select(plain, dr.gather(mi.Float, albedo, met.shape, plain), 1)
    return dr.select(plain, SURFACES, event), met.boundary & ~reflects, d, factor

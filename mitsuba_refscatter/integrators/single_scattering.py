"""Single scattering of all lights in all regions: which light samples, through which boundaries, onto which
segments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..core.sobol import Batch
from ..culling import chains
from ..estimators import unrefracted, wavefront
from ..estimators.accumulator import Sums
from ..estimators.beam_curve import BeamCurve
from ..light import light_samples
from ..light.chains import ChainedLight, coloured
from ..scene import holds
from ..scene.boundaries import boxes_meet
from ..transport import visibility
from ..transport.transmittance import Transmittance


@dataclass
class Samples:
    """The camera samples of one wavefront.

    ray       mi.Ray3f
    batch     which samples these are
    seed      of random numbers, where the estimator has any
    detail    whether pairs are counted
    progress  (share done) or None
    """

    ray: mi.Ray3f
    batch: Batch
    seed: int = 0
    detail: bool = False
    progress: Callable | None = None


def scatter(prepared, paths, samples, counts, refracted=True):
    """Single scattering along all segments of the camera paths: ``Sums`` per camera sample, with the radiance
    itself as ``value``.

    prepared   ``Prepared``
    paths      ``camera_paths.Paths``
    samples    ``Samples``
    counts     ``wavefront.Counts`` that the work is added to
    refracted  whether light that comes through refracting boundaries is summed, too
    """
    scene, n = prepared.scene, dr.width(samples.ray)
    single = Sums.nothing(n, samples.detail)
    along = [(region, paths.segments(region)) for region in scene.regions if paths.parts[region.index]]
    along = _with_shares(along, n)
    shared = prepared.light_samples if prepared.culling.for_one_light else 0
    shares = light_samples.shares(
        scene.emitters, prepared.sequence, shared, samples.batch, n, samples.ray.wavelengths
    ) if along else []  # fmt: skip
    work = [(*x, share) for share in shares for x in along]
    chained = {}
    for i, (region, segments, share) in enumerate(work):
        taken = share.of(segments)
        if taken is None:
            continue
        if refracted and prepared.light_bounces and scene.bodies:
            if id(share) not in chained:
                chained = {id(share): prepared.chains(share.sample, share.emitter)}
            if region.index in chained[id(share)]:
                _chained(prepared, region, share.emitter, taken, (single, counts), chained[id(share)][region.index])
        if refracted:
            run = wavefront.Run(
                prepared.accuracy, seed=samples.seed + i, detail=samples.detail, progress=samples.progress
            )
            run = run.part(i / len(work), (i + 1) / len(work))
            _refracted(prepared, region, share.emitter, taken, single, counts, run=run)
        if goes_straight(region, share.emitter, taken[1]):
            counts.found(None, _straight(prepared, region, *taken, single), 0.0)
    return single.first(n)


def _with_shares(along, n):
    """Regions and ``CameraSegments`` with what each segment holds of its camera sample, as if all media were lit
    evenly. ``n``: number of camera samples."""
    brings, total = [], dr.zeros(mi.Float, arrays.room(n))
    for region, segments in along:
        sigma_s, sigma_t = region.coefficients(segments.wavelengths, segments.direction)
        lit = dr.max(segments.weight * sigma_s * segments.length / (1 + sigma_t * segments.length))  # as 1 - exp
        dr.scatter_add(total, lit, segments.sample)
        brings.append(lit)
    dr.eval(total, brings)
    return [
        (region, replace(segments, share=x / dr.maximum(dr.gather(mi.Float, total, segments.sample), 1e-30)))
        for (region, segments), x in zip(along, brings)
    ]


def _refracted(prepared, region, emitter, taken, single, counts, *, run):
    """Adds light that comes in through the region's refracting boundaries. ``taken``: segments, their light samples
    and the intensities of these. The work is added to ``counts``."""
    segments, sample, value = taken
    for body in region.boundaries:
        illumination, culling = prepared.illuminated(body, region, sample, emitter, segments.wavelengths)
        if culling is None:
            continue
        parts = _by_share(culling, segments)
        for k, (one, index) in enumerate(parts):
            some = replace(run.part(k / len(parts), (k + 1) / len(parts)), pace=prepared.pace(body.index, body.key, k))
            few, there = (segments, illumination) if index is None else (segments.gather(index), illumination.at(index))
            there = there.off(one.apart)
            sigma_s, sigma_t = region.coefficients(few.wavelengths, few.direction)
            local = few.from_boundary(body.centre, sigma_t)
            sums, more = wavefront.scatter(local, one, there, prepared.method(emitter, body)[0], some)
            counts.add(more)
            tint = body.tint("specular_transmittance", few.wavelengths)
            weight = few.weight * sigma_s * (value if index is None else arrays.of(value, index)) * tint
            found = float(dr.sum(dr.mean(weight * sums.value))[0]) if one.estimate > 0 else 0.0
            counts.found(None if emitter.drawn else (emitter.index, body.index), found, one.estimate)
            single.add_all(sums, weight, few.sample)


def _chained(prepared, region, emitter, taken, sums, culling):
    """Adds light that comes through chains, of which ``culling`` has the beams. ``taken``: as of ``_refracted``;
    ``sums``: those of the camera samples, and the counts."""
    (segments, sample, value), (single, counts) = taken, sums
    centre = chains.walls(prepared.scene, region).centre
    origin, colours = dr.opaque(mi.Point3f, centre), coloured(prepared.scene)
    for k, (one, index) in enumerate(_by_share(culling, segments)):
        few = segments if index is None else segments.gather(index)
        light = ChainedLight.of(region, sample, origin, few.wavelengths, colours)
        sigma_s, sigma_t = region.coefficients(few.wavelengths, few.direction)
        run = wavefront.Run(prepared.accuracy_of_chains, pace=prepared.pace("chains", region.index, k))
        found, more = wavefront.scatter(few.from_boundary(centre, sigma_t), one, light, BeamCurve(), run)
        counts.add(more)
        weight = few.weight * sigma_s * (value if index is None else arrays.of(value, index))
        brought = float(dr.sum(dr.mean(weight * found.value))[0])
        counts.found(None if emitter.drawn else (emitter.index, "chains", region.index), brought, one.estimate)
        single.add_all(found, weight, few.sample)


def _by_share(culling, segments):
    """A light's cullings, with the numbers (UInt32) of the segments that each is for; None for all of them."""
    parts, below = [], np.inf
    if bool(dr.all(segments.share >= tolerances.SHARES[0])[0]):
        return [(culling, None)]
    cullings = culling.by_share()
    if len(cullings) == 1:
        return [(culling, None)]
    for least, one in cullings:
        index = dr.compress(
            (segments.share >= dr.opaque(mi.Float, least)) & (segments.share < dr.opaque(mi.Float, below))
        )
        below = least
        if dr.width(index) > 0:
            parts.append((one, index))
    return parts


def goes_straight(region, emitter, sample):
    """Whether light may come to where it is scattered in a region without refraction."""
    if region.admits or sample.distant:
        return region.admits
    if region.body is None:
        return True
    if dr.width(sample.L) == 1:
        return holds(region.body, np.array(sample.L).ravel())
    return boxes_meet(emitter.box, region.body.box)


def _straight(prepared, region, segments, sample, value, single):
    """Adds light that comes straight. Returns the sum of it."""
    scene = prepared.scene
    sigma_s, sigma_t = region.coefficients(segments.wavelengths, segments.direction)
    at = region.body.centre if region.body is not None else [0.0, 0.0, 0.0]
    centre = dr.opaque(mi.Point3f, at)
    transmittance, start = Transmittance(scene, segments.wavelengths), dr.opaque(mi.UInt32, region.index)

    def way(V, direction, distance, active):
        length = distance if sample.distant else distance * (1 - tolerances.SHADOW_END)
        return transmittance.follow(mi.Point3f(V) + centre, direction, length, start, active)

    free = dr.width(sample.L) == 1 and not region.admits and _nothing_between(scene, region)
    light = unrefracted.Unrefracted(
        light=sample.local(centre), emission=sample.emission(centre, segments.wavelengths), phase=region.phase,
        directed=region.directed, way=None if free else way,
    )  # fmt: skip
    angles = 0 if sample.distant else prepared.angle_panels(region)
    total = unrefracted.scatter(segments.off_boundary(at, sigma_t), light, prepared.accuracy, angles)
    total *= segments.weight * sigma_s * value
    dr.scatter_add(single.value, total, segments.sample)
    found = dr.sum(dr.mean(total))
    single.eval(found)
    return float(found[0])


def _nothing_between(scene, region):
    """Whether any two points of a region see each other."""
    if region.body is None:
        return not scene.bodies and not scene.others
    others = scene.others + [body.shape for body in scene.bodies if body is not region.body]
    return region.body.convex and not any(visibility.meets(region.body, shape) for shape in others)

"""Which of the coarser meshes of a body (``light.simplification``) refracts light as well as the tolerance asks for.

The error of a coarse mesh is measured on some of the camera segments that are to be rendered, against one with
about four times as many triangles: it falls with the square of the turn of the normals along edges, so that what
is left of it there is known.
"""

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..core.cache import ChoiceKey, LevelsKey, digest
from ..estimators import wavefront
from ..light import simplification


def allowed_turns(error):
    """Least and largest turn of the normals along edges that a mesh of relative ``error`` may have."""
    return [float(np.sqrt(error / factor)) for factor in tolerances.TURN_ERROR[::-1]]


def suitable(turns, error, measure):
    """Number of the coarsest of meshes with these ``turns``, falling, that has at most the relative ``error``;
    the last one is exact. ``measure(i, j)``: relative difference that it makes to take mesh i in place of j."""
    at = int(np.argmin(np.abs(np.log(turns[:-1]) - 0.5 * np.log(error / np.sqrt(np.prod(tolerances.TURN_ERROR))))))
    for _ in range(tolerances.COARSE_TRIES):
        finer = min(at + simplification.QUARTER, len(turns) - 1)
        found = measure(at, finer) / (1 - (turns[finer] / turns[at]) ** 2)
        wanted = turns[at] * np.sqrt(error / max(found, tolerances.COARSE_LEAST))
        last, at = at, int(np.searchsorted(-np.array(turns[:-1]), -wanted))
        if at == len(turns) - 1 or abs(at - last) <= simplification.QUARTER // 2:
            break
    return at


def relative(difference, radiance):
    """The sum of differences relative to that of the radiance, of which both are a sample, and twice its standard
    error."""
    total = max(radiance.sum(), 1e-30)
    ratio = difference.sum() / total
    return float(ratio + 2 * np.sqrt(((difference - ratio * radiance) ** 2).sum()) / total)


def some(n):
    """Numbers of some of ``n`` segments."""
    count = min(n, tolerances.COARSE_SEGMENTS)
    return arrays.array(mi.UInt32, (np.arange(count) + 0.5) * n / count)


def choose(prepared, body, region, share, segments, sigma_t):
    """The boundary, or one with a coarser mesh that refracts light as well as the tolerance asks for.

    body      ``scene.Body``
    region    that behind it
    share     ``light_samples.LightShare``, whose light is refracted
    segments  ``CameraSegments`` that are to be rendered
    sigma_t   Spectrum, extinction along them
    """
    error, emitter = prepared.accuracy.coarse, share.emitter
    able = prepared.culling.takes_coarse_meshes and prepared.estimator.takes_coarse_meshes
    if error == 0 or not able or emitter.drawn:
        return body  # of a light of many points the error at one of them says little about the others
    turns, cache = allowed_turns(error), prepared.cache
    levels = cache.once(lambda: simplification.levels(body, *turns), LevelsKey(body.key, *turns))
    if len(levels) == 1:
        return body
    once = prepared.once if prepared.scene.geometry is None else cache.once

    def measured():
        index = some(len(segments))
        part, extinction = segments.gather(index), arrays.of(sigma_t, index)

        def radiance(level):
            coarse = level.of(body, prepared.scene, once)
            illumination, culling = prepared.illuminated(coarse, region, share.sample, emitter, part.wavelengths)
            if culling is None:
                return np.zeros(len(part))
            local = part.from_boundary(body.centre, extinction)
            run = wavefront.Run(prepared.accuracy)
            sums, _ = wavefront.scatter(local, culling, illumination, prepared.estimator, run)
            return np.array(dr.mean(part.weight * sums.value)).ravel()

        def measure(i, j):
            a, b = radiance(levels[i]), radiance(levels[j])
            return relative(np.abs(a - b), b)

        measured_on = *vars(part).values(), extinction
        dr.eval(measured_on)
        key = ChoiceKey(
            prepared.given,
            prepared.parameters(),
            digest(*measured_on),
            body.key,
            region.index,
            emitter.index,
            prepared.accuracy,
        )
        return cache.once(lambda: suitable([x.turn for x in levels], error, measure), key)

    chosen = prepared.once(measured, "choice", body.index, body.key, region.index, emitter.index)
    return levels[chosen].of(body, prepared.scene, once)

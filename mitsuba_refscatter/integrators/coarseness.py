"""Which of the coarser meshes of a body (``scene.coarse``) refracts light as well as the tolerance asks for.

The error of a coarse mesh is measured on some of the camera segments that are to be rendered, against one with about four times
as many triangles: it falls with the square of the turn of the normals along edges, so that what is left of it there is known.
"""

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import lanes, tolerances, wavefront
from ..scene import coarse


def turns(error):
    """Least and largest turn of the normals along edges that a mesh of relative ``error`` may have."""
    return [float(np.sqrt(error / factor)) for factor in tolerances.TURN_ERROR[::-1]]


def suitable(turns, error, measure):
    """Number of the coarsest of meshes with these ``turns``, falling, that has at most the relative ``error``; the last one is
    exact. ``measure(i, j)``: relative difference that it makes to take mesh i in place of j."""
    at = int(np.argmin(np.abs(np.log(turns[:-1]) - 0.5 * np.log(error / np.sqrt(np.prod(tolerances.TURN_ERROR))))))
    for _ in range(tolerances.COARSE_TRIES):
        finer = min(at + coarse.QUARTER, len(turns) - 1)
        found = measure(at, finer) / (1 - (turns[finer] / turns[at]) ** 2)
        wanted = turns[at] * np.sqrt(error / max(found, tolerances.COARSE_LEAST))
        last, at = at, int(np.searchsorted(-np.array(turns[:-1]), -wanted))
        if at == len(turns) - 1 or abs(at - last) <= coarse.QUARTER // 2:
            break
    return at


def relative(difference, radiance):
    """The sum of differences relative to that of the radiance, of which both are a sample, and twice its standard error."""
    total = max(radiance.sum(), 1e-30)
    ratio = difference.sum() / total
    return float(ratio + 2 * np.sqrt(((difference - ratio * radiance) ** 2).sum()) / total)


def some(n):
    """Numbers of some of ``n`` segments."""
    count = min(n, tolerances.COARSE_SEGMENTS)
    return lanes.array(mi.UInt32, (np.arange(count) + 0.5) * n / count)


def radiance(segments, weight, lighting, culling, accuracy, estimator):
    """What comes along segments, times their ``weight``, as NumPy array; zero without ``culling``."""
    if culling is None:
        return np.zeros(len(segments))
    sums, _ = wavefront.scatter(segments, culling, lighting, accuracy, estimator)
    return np.array(dr.mean(weight * sums.value)).ravel()

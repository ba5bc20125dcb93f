"""What a probe finds on the boundaries as records: the curve with its folds, and the triangles; peaks of a total."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from .. import tolerances
from ..image_io import luminance
from .records import Curve, Triangles


def curve_of(found: list[tuple], length: float) -> tuple[Curve, Triangles, float]:
    """``(Curve, Triangles, radiance that is unresolved)`` of a segment.

    found   (number of the light, number of the boundary, boundary, ``profile.Cells``, factor) of all that light it
    length  of the segment
    """
    channels, parts, unresolved = len(mi.Spectrum(0)), [], 0.0
    for light, boundary, body, cells, factor in found:
        n = len(cells.solved.numpy())
        t, slope = (np.stack([x.numpy() for x in several], axis=1).astype(float) for several in (cells.t, cells.slope))
        position = np.stack([x.numpy().T for x in cells.P], axis=1) + np.array(body.centre)
        density = np.stack([(x * factor).numpy().reshape(channels, n).T for x in cells.density], axis=1).astype(float)
        integral = (cells.total * factor).numpy().reshape(channels, n).T.astype(float)
        unresolved += integral[~cells.solved.numpy()].sum()
        fold = np.where(slope[:, 0] * slope[:, 2] < 0, _extremum(t), np.nan)
        triangle = cells.triangle.numpy().astype(int) - body.first_record
        numbers = np.full(n, light), np.full(n, boundary), triangle
        parts.append((*numbers, position, np.clip(t, 0, length), density, integral, fold))
    if not parts:
        shapes = [(0,)] * 3 + [(0, 3, 3), (0, 3), (0, 3, channels), (0, channels), (0,)]
        parts = [[np.zeros(shape, dtype=int if i < 3 else float) for i, shape in enumerate(shapes)]]
    curve = Curve(*(np.concatenate(x) for x in zip(*parts)))
    return curve, _triangles(curve), unresolved


def _extremum(t):
    """The extremum (n,) between 0 and 1 of the parabola through three distances t (n, 3), at 0, 1/2 and 1."""
    rise, bend = -3 * t[:, 0] + 4 * t[:, 1] - t[:, 2], 2 * (t[:, 0] - 2 * t[:, 1] + t[:, 2])
    at = np.clip(-rise / np.where(bend == 0, 1, 2 * bend), 0, 1)
    return t[:, 0] + at * (rise + at * bend)


def _triangles(curve):
    """``Triangles`` of a ``Curve``."""
    keys = np.stack([curve.light, curve.boundary, curve.triangle], axis=1)
    known, of = np.unique(keys, axis=0, return_inverse=True)
    of, m = of.ravel(), len(known)
    x_min, x_max, integral = np.full(m, np.inf), np.full(m, -np.inf), np.zeros((m, curve.integral.shape[1]))
    every = np.column_stack([curve.distance, curve.fold])
    np.minimum.at(x_min, of, np.fmin.reduce(every, axis=1))
    np.maximum.at(x_max, of, np.fmax.reduce(every, axis=1))
    np.add.at(integral, of, curve.integral)
    return Triangles(*known.T, x_min, x_max, integral, of)


def peaks(distance: np.ndarray, radiance: np.ndarray) -> np.ndarray:
    """Distances (K,) at which the luminance has a maximum that stands out by ``tolerances.PEAK`` of the largest.

    distance  (N,)
    radiance  (N, C)

    The luminance falls by so much on both sides of the maximum before it rises above it.
    """
    y = luminance(radiance)
    padded = np.concatenate([[0], y, [0]])
    at = np.flatnonzero((padded[1:-1] > padded[:-2]) & (padded[1:-1] >= padded[2:]))
    if len(at) == 0:
        return distance[at]
    i = np.arange(len(y))
    higher = y[None] > y[at, None]
    left = np.where(higher & (i < at[:, None]), i, -1).max(axis=1)
    right = np.where(higher & (i > at[:, None]), i, len(y)).min(axis=1)
    near = np.where((i > left[:, None]) & (i < right[:, None]), y[None], np.inf)
    falls = []
    for end, side in ((left < 0, i <= at[:, None]), (right >= len(y), i >= at[:, None])):
        low = np.where(side, near, np.inf).min(axis=1)
        falls.append(np.where(end, 0, low))
    return distance[at[y[at] - np.maximum(*falls) >= tolerances.PEAK * y.max()]]

"""The points that send light onto a segment as NumPy arrays, by triangles, with the folds; peaks of a total. Float64."""

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from .. import tolerances

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass
class Curve:
    """The curve on the boundaries that light is refracted from onto the segment, in n cells, each inside one triangle.

    ``light``, ``boundary``, ``triangle`` (n,): numbers; the last in its boundary. For the two ends of a cell and, between them, its middle:
    ``position`` (n, 3, 3), world, ``distance`` (n, 3) along the segment, and ``radiance`` (n, 3, C) there per unit length, inf at a fold.
    ``integral`` (n, C): radiance that the cell brings; ``fold`` (n,): the distance at which the curve turns back in the cell, where two
    branches of one triangle meet and its radiance per unit length has a pole; NaN where it doesn't.
    """

    light: np.ndarray
    boundary: np.ndarray
    triangle: np.ndarray
    position: np.ndarray
    distance: np.ndarray
    radiance: np.ndarray
    integral: np.ndarray
    fold: np.ndarray


@dataclass
class Triangles:
    """The M triangles that send light onto the segment, by light and boundary: ``light``, ``boundary``, ``triangle`` (M,); ``x_min``,
    ``x_max`` (M,): the interval of distances that each lights (Holzschuch 2015); ``integral`` (M, C): radiance that it brings; ``of`` (n,): the
    number among these of the triangle of each cell of the ``Curve``."""

    light: np.ndarray
    boundary: np.ndarray
    triangle: np.ndarray
    x_min: np.ndarray
    x_max: np.ndarray
    integral: np.ndarray
    of: np.ndarray


def curve_of(found, length):
    """``(Curve, Triangles, radiance that is unresolved)`` of a list of ``(light, boundary, body, Cells, factor)``, for a segment of that
    ``length``."""
    channels, parts, unresolved = len(mi.Spectrum(0)), [], 0.0
    for light, boundary, body, cells, factor in found:
        n = len(cells.solved.numpy())
        t, slope = (np.stack([x.numpy() for x in several], axis=1).astype(float) for several in (cells.t, cells.slope))
        position = np.stack([x.numpy().T for x in cells.P], axis=1) + np.array(body.centre)
        density = np.stack([(x * factor).numpy().reshape(channels, n).T for x in cells.density], axis=1).astype(float)
        integral = (cells.total * factor).numpy().reshape(channels, n).T.astype(float)
        unresolved += integral[~cells.solved.numpy()].sum()
        parts.append((np.full(n, light), np.full(n, boundary), cells.triangle.numpy().astype(int) - body.first_record, position,
                      np.clip(t, 0, length), density, integral, np.where(slope[:, 0] * slope[:, 2] < 0, _turn(t), np.nan)))  # fmt: skip
    if not parts:
        shapes = [(0,)] * 3 + [(0, 3, 3), (0, 3), (0, 3, channels), (0, channels), (0,)]
        parts = [[np.zeros(shape, dtype=int if i < 3 else float) for i, shape in enumerate(shapes)]]
    curve = Curve(*(np.concatenate(x) for x in zip(*parts)))
    return curve, _triangles(curve), unresolved


def _turn(t):
    """Where the parabola through three distances t (n, 3), at 0, 1/2 and 1, turns back."""
    rise, bend = -3 * t[:, 0] + 4 * t[:, 1] - t[:, 2], 2 * (t[:, 0] - 2 * t[:, 1] + t[:, 2])
    at = np.clip(-rise / np.where(bend == 0, 1, 2 * bend), 0, 1)
    return t[:, 0] + at * (rise + at * bend)


def _triangles(curve):
    keys = np.stack([curve.light, curve.boundary, curve.triangle], axis=1)
    known, of = np.unique(keys, axis=0, return_inverse=True)
    of, m = of.ravel(), len(known)
    x_min, x_max, integral = np.full(m, np.inf), np.full(m, -np.inf), np.zeros((m, curve.integral.shape[1]))
    every = np.column_stack([curve.distance, curve.fold])
    np.minimum.at(x_min, of, np.fmin.reduce(every, axis=1))
    np.maximum.at(x_max, of, np.fmax.reduce(every, axis=1))
    np.add.at(integral, of, curve.integral)
    return Triangles(*known.T, x_min, x_max, integral, of)


def luminance(radiance):
    """Luminance of linear rgb (..., 3); the value itself of one channel (..., 1)."""
    return radiance @ LUMINANCE if radiance.shape[-1] == 3 else radiance[..., 0]


def peaks(distance, radiance):
    """Distances at which the luminance of ``radiance`` (N, C) has a maximum that stands out by ``tolerances.PEAK`` of the largest: so much
    it falls on both sides before it rises above it."""
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

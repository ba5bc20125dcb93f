"""The surface of a lake: a grid with waves, fine in the middle and flat at the far rim."""

from __future__ import annotations

import numpy as np

from .bodies import Mesh

WAVES = 14
AMPLITUDE = 0.075  # in scene units, root of the summed squared wave heights
WAVELENGTHS = (0.9, 3.0)
WIND = (0.8, 0.6)  # direction (x, z) that waves favour
SEED = 2
CALM = 9.0  # distance from the middle at which waves have fallen to 1/e
RIM = 60.0  # half of the edge
MIDDLE = 9.0  # half of the edge of the part where the grid is nearly even


def _height(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Height of the surface above its mean."""
    rng = np.random.RandomState(SEED)  # the same numbers on every machine
    angle = np.arctan2(*WIND[::-1]) + rng.normal(scale=0.7, size=WAVES)
    k = 2 * np.pi / rng.uniform(*WAVELENGTHS, size=WAVES)
    phase = rng.uniform(0, 2 * np.pi, size=WAVES)
    sharp = 1 / (k / k.min())  # long waves are higher
    height = AMPLITUDE * sharp / np.sqrt((sharp**2).sum())
    travel = np.multiply.outer(x, k * np.cos(angle)) + np.multiply.outer(z, k * np.sin(angle))
    return (np.sin(travel + phase) * height).sum(axis=-1) * np.exp(-(((x**2 + z**2) / CALM**2) ** 2))


def water(triangles: int) -> Mesh:
    """Square grid of 2 n² triangles about y = 0, open at its rim: ``(vertices, faces, normals)``.

    It is wound counter-clockwise seen from above, and has the normals of the smooth surface.
    """
    n = max(2, round((triangles / 2) ** 0.5))
    s = np.linspace(-1, 1, n + 1)
    x, z = np.meshgrid(MIDDLE * s + (RIM - MIDDLE) * s**9, MIDDLE * s + (RIM - MIDDLE) * s**9, indexing="ij")
    step = 1e-5
    slope = [(_height(x + step * a, z + step * b) - _height(x - step * a, z - step * b)) / (2 * step)
             for a, b in ((1, 0), (0, 1))]  # fmt: skip
    normals = np.stack([-slope[0], np.ones_like(x), -slope[1]], axis=-1).reshape(-1, 3)
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (i.ravel() for i in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    vertices = np.stack([x, _height(x, z), z], axis=-1).reshape(-1, 3)
    return vertices, faces, normals / np.linalg.norm(normals, axis=1, keepdims=True)

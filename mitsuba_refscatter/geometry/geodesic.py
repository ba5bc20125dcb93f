"""The geodesic sphere: an icosahedron whose faces are cut into f × f triangles."""

from __future__ import annotations

import numpy as np

_GOLDEN = (1.0 + 5.0**0.5) / 2.0

_CORNERS = np.array(
    [
        (-1, _GOLDEN, 0), (1, _GOLDEN, 0), (-1, -_GOLDEN, 0), (1, -_GOLDEN, 0),
        (0, -1, _GOLDEN), (0, 1, _GOLDEN), (0, -1, -_GOLDEN), (0, 1, -_GOLDEN),
        (_GOLDEN, 0, -1), (_GOLDEN, 0, 1), (-_GOLDEN, 0, -1), (-_GOLDEN, 0, 1),
    ]
)  # fmt: skip

_FACES = np.array(
    [
        (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11),
        (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8),
        (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9),
        (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1),
    ]
)  # fmt: skip


def nearest_frequency(triangles: int) -> int:
    """Return the frequency f ≥ 1 for which 20 f² comes nearest to ``triangles``.

    >>> nearest_frequency(1280), nearest_frequency(100)
    (8, 2)
    """
    f = max(1, int((triangles / 20.0) ** 0.5))
    return f if abs(20 * f * f - triangles) <= abs(20 * (f + 1) ** 2 - triangles) else f + 1


def _lattice(f: int) -> tuple[np.ndarray, np.ndarray]:
    """Cut one triangle: integer barycentric weights (sum f) and counter-clockwise faces."""
    index = np.full((f + 2, f + 2), -1)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(f + 1), np.arange(f + 1), indexing="ij"))
    i, j = i[i + j <= f], j[i + j <= f]
    index[i, j] = np.arange(len(i))
    weights = np.stack([f - i - j, i, j], axis=1)
    up = i + j < f
    down = i + j < f - 1
    faces = np.concatenate(
        [
            np.stack([index[i, j], index[i + 1, j], index[i, j + 1]], axis=1)[up],
            np.stack([index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]], axis=1)[down],
        ]
    )
    return weights, faces


def geodesic_sphere(f: int) -> tuple[np.ndarray, np.ndarray]:
    """Return unit vertices (10 f² + 2, 3) and outward-wound faces (20 f², 3)."""
    weights, faces = _lattice(f)
    # A vertex is named by its (corner, weight) pairs, so that neighbouring
    # faces agree on shared vertices without comparing rounded positions.
    names = np.where(weights > 0, _FACES[:, None, :] * (f + 1) + weights, 0).reshape(-1, 3)
    names, inverse = np.unique(np.sort(names, axis=1), axis=0, return_inverse=True)
    corner, weight = np.divmod(names, f + 1)
    points = (_CORNERS[corner] * weight[..., None]).sum(axis=1)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    per_face = inverse.reshape(20, -1)
    return points, per_face[:, faces].reshape(-1, 3)

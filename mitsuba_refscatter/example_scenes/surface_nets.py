"""Closed triangle meshes of implicit surfaces (naive surface nets, Gibson 1998).

``field(x)`` takes points (n, 3) and returns values (n,), negative inside, and gradients (n, 3). It should be near a
signed distance.
"""

from __future__ import annotations

from typing import Callable

import numpy as np

Field = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def project(field: Field, x: np.ndarray, steps: int = 6) -> np.ndarray:
    """Move points (n, 3) along the gradient onto the zero surface."""
    for _ in range(steps):
        value, gradient = field(x)
        x = x - gradient * (value / (gradient**2).sum(axis=1))[:, None]
    return x


def _samples(field: Field, low: np.ndarray, shape: tuple[int, ...], h: float) -> np.ndarray:
    """Field values on the grid, one slice at a time to keep memory small."""
    j, k = np.meshgrid(np.arange(shape[1]), np.arange(shape[2]), indexing="ij")
    values = np.empty(shape)
    for i in range(shape[0]):
        grid = np.stack([np.full_like(j, i), j, k], axis=-1).reshape(-1, 3)
        values[i] = field(low + h * grid)[0].reshape(shape[1:])
    return values


def _quads(inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cells (n, 3) around every grid edge that crosses the surface, as outward quads."""
    shape = np.array(inside.shape)
    found = []
    for axis in range(3):
        u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
        first = np.take(inside, np.arange(shape[axis] - 1), axis=axis)
        second = np.take(inside, np.arange(1, shape[axis]), axis=axis)
        for crossing, outward in ((first & ~second, True), (~first & second, False)):
            edge = np.argwhere(crossing)
            around = [edge - u - v, edge - v, edge, edge - u]
            found.append(np.stack(around if outward else around[::-1], axis=1))
    cells = np.ravel_multi_index(tuple(np.moveaxis(np.concatenate(found), -1, 0)), tuple(shape))
    used, quads = np.unique(cells, return_inverse=True)
    return np.stack(np.unravel_index(used, tuple(shape)), axis=1), quads.reshape(-1, 4)


def _relax(x: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Halfway to the mean of the neighbours: evens out the triangles."""
    total, count = np.zeros_like(x), np.zeros(len(x))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        np.add.at(total, faces[:, a], x[faces[:, b]])
        np.add.at(count, faces[:, a], 1.0)
    return 0.5 * x + 0.5 * total / count[:, None]


def is_closed(faces: np.ndarray) -> bool:
    """Whether every directed edge occurs once and its reverse once."""
    count = int(faces.max()) + 1
    start, end = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    edges, repeats = np.unique(start * count + end, return_counts=True)
    return bool((repeats == 1).all() and np.array_equal(edges, np.unique(end * count + start)))


def _split(x: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Cut quads into triangles along their shorter diagonals."""
    corner = x[quads]
    first = np.linalg.norm(corner[:, 0] - corner[:, 2], axis=1)
    second = np.linalg.norm(corner[:, 1] - corner[:, 3], axis=1)
    choice = (first <= second)[:, None]
    split = np.where(choice, quads[:, [0, 1, 2, 0, 2, 3]], quads[:, [0, 1, 3, 1, 2, 3]])
    return split.reshape(-1, 3)


def surface_net(field: Field, low: np.ndarray, high: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Mesh the zero surface; return vertices (V, 3) and outward faces (F, 3).

    field  whose zero surface it is
    low    corner (3,) of a box in which the surface lies
    high   the opposite corner
    h      spacing of the grid, over which the surface must bend little

    A saddle of the surface that happens to lie on a grid plane can leave two sheets in one cell. Then an edge has four
    triangles, and the grid is shifted.
    """
    shape = tuple(int(n) for n in np.ceil((high - low) / h + 4.0))
    for attempt in range(40):
        shift = (np.array([0.62, 0.75, 0.57]) * attempt) % 1.0
        corner = low - h * (1.0 + shift)
        cells, quads = _quads(_samples(field, corner, shape, h) < 0.0)
        x = project(field, corner + h * (cells + 0.5))
        faces = _split(x, quads)
        if is_closed(faces):
            break
    else:
        raise ValueError(f"no closed mesh at a grid spacing of {h:.3g}: ask for more triangles")
    for _ in range(6):
        x = project(field, _relax(x, faces), steps=2)
    return project(field, x), faces


def subdivide(field: Field, x: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut every triangle in four and move the new vertices onto the surface; return vertices and faces."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, inverse = np.unique(edges, axis=0, return_inverse=True)
    middle = project(field, 0.5 * (x[edges[:, 0]] + x[edges[:, 1]]))
    ab, bc, ca = (len(x) + inverse.reshape(-1, 3)).T
    a, b, c = faces.T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    fine = np.concatenate([np.stack(part, axis=1) for part in parts])
    return np.concatenate([x, middle]), fine

"""Facts about a triangle mesh that decide whether and how it can be rendered. NumPy float64 only.

``vertices`` (V, 3) are positions, ``faces`` (F, 3) indices of vertices, ``corners`` (F, 3, 3) positions of the faces'
corners.
"""

from __future__ import annotations

import numpy as np

from .. import tolerances


def weld(vertices, faces):
    """Faces with vertices at the same position made one: (F, 3) indices of unique positions.

    >>> weld(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]]), np.array([[0, 1, 2], [0, 2, 3]])).tolist()
    [[0, 2, 1], [0, 1, 2]]
    """
    _, inverse = np.unique(vertices, axis=0, return_inverse=True)
    return inverse.reshape(-1)[faces]


def twins(faces):
    """Pairs each directed edge with its reverse.

    Edge ``3 f + k`` runs from corner k of face f to corner k + 1. Returns the twin (3 F,) of each edge, -1 where it has
    none (a hole), itself where its face has one vertex twice. Returns None if an edge has several, or if faces are of
    inconsistent orientation.

    >>> twins(np.array([[0, 1, 2], [1, 0, 3]])).tolist()
    [3, -1, -1, 0, -1, -1]
    >>> twins(np.array([[0, 1, 2], [0, 1, 3]])) is None
    True
    """
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    counts = np.flatnonzero(np.repeat((tail != head).reshape(-1, 3).all(axis=1), 3))
    tail, head, n = tail[counts].astype(np.int64), head[counts].astype(np.int64), int(faces.max()) + 1
    forward, backward = tail * n + head, head * n + tail
    i, j = np.argsort(forward), np.argsort(backward)
    keys = forward[i]
    if (keys[1:] == keys[:-1]).any():
        return None
    twin = np.arange(faces.size)
    if len(keys) > 0:
        place = np.minimum(np.searchsorted(backward[j], keys), len(keys) - 1)
        twin[counts[i]] = np.where(backward[j][place] == keys, counts[j[place]], -1)
    return twin


def faults(faces):
    """Why ``twins`` is None: ``(repeated, crowded, triangles, inconsistent)``, int arrays, indices from the lowest on.

    repeated      triangles with the corners of an earlier one
    crowded       edges (the first directed one of each) that three or more triangles share
    triangles     how many share each of them
    inconsistent  edges of two triangles that run along them in the same direction

    >>> [x.tolist() for x in faults(np.array([[0, 1, 2], [0, 1, 3]]))]
    [[], [], [], [0]]
    >>> [x.tolist() for x in faults(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4], [2, 1, 0]]))]
    [[3], [0], [4], []]
    """
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    repeated = np.setdiff1d(np.arange(len(faces)), first)
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    counts = np.flatnonzero(np.repeat((tail != head).reshape(-1, 3).all(axis=1), 3))
    keys = edge_keys(tail[counts], head[counts], int(faces.max()) + 1)
    _, first, edge, number = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    upwards = np.bincount(edge.reshape(-1), tail[counts] < head[counts])
    crowded, inconsistent = (np.flatnonzero(x) for x in (number > 2, (number == 2) & (upwards != 1)))
    crowded = crowded[np.argsort(first[crowded])]
    return repeated, counts[first[crowded]], number[crowded], np.sort(counts[first[inconsistent]])


def edge_keys(a, b, count):
    """A number for each edge between vertices ``a`` and ``b`` of ``count``, the same in both directions.

    It is lower x ``count`` + upper.

    >>> edge_keys(np.array([1, 2]), np.array([2, 1]), 10).tolist()
    [12, 12]
    """
    return np.minimum(a, b).astype(np.int64) * count + np.maximum(a, b)


def volume(corners):
    """Signed volume enclosed by closed corners (F, 3, 3): positive if the triangles wind outwards."""
    centred = corners - corners.reshape(-1, 3).mean(axis=0)
    return float(np.einsum("fi,fi->", centred[:, 0], np.cross(centred[:, 1], centred[:, 2])) / 6)


def components(faces):
    """Number of the connected component of each face (F,), by common vertices.

    >>> components(np.array([[0, 1, 2], [3, 4, 5], [2, 1, 6]])).tolist()
    [0, 1, 0]
    """
    a, b = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    root = np.arange(int(faces.max()) + 1)
    while (root[a] != root[b]).any():
        low, high = np.minimum(root[a], root[b]), np.maximum(root[a], root[b])
        np.minimum.at(root, high, low)
        while (root[root] != root).any():
            root = root[root]
    return np.unique(root[faces[:, 0]], return_inverse=True)[1].reshape(-1)


def touches(corners, point):
    """Whether the ``point`` (3,) lies on a triangle, to float32.

    It then sees the triangle under half the sphere, or an edge from between its ends.
    """
    a, b, c = (corners[:, k] - point for k in range(3))
    size = np.ptp(corners.reshape(-1, 3), axis=0).max()
    angle, lengths = _solid_angles(a, b, c)
    if np.min(lengths) < tolerances.AT_CORNER * size or (np.abs(angle) > 2 * np.pi - tolerances.AT_FACE).any():
        return True
    for x, y, lx, ly in ((a, b, 0, 1), (b, c, 1, 2), (c, a, 2, 0)):
        together = lengths[lx] * lengths[ly]
        if (together + np.einsum("fi,fi->f", x, y) < tolerances.AT_EDGE * together).any():
            return True
    return False


def _solid_angles(a, b, c):
    """Signed solid angles of triangles with corners a, b, c seen from 0, and the corners' distances (3, F)."""
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    triple = np.einsum("fi,fi->f", a, np.cross(b, c))
    dots = np.einsum("fi,fi->f", a, b) * lc + np.einsum("fi,fi->f", b, c) * la + np.einsum("fi,fi->f", c, a) * lb
    return 2 * np.arctan2(triple, la * lb * lc + dots), np.stack([la, lb, lc])


def is_convex(corners, normals, faces, twin):
    """Whether a closed mesh bounds one convex body: locally convex across every edge, one component, no handles.

    corners  (F, 3, 3)
    normals  (F, 3), unit, geometric, outward
    faces    (F, 3)
    twin     (3 F,), of each directed edge (``twins``)
    """
    size = np.ptp(corners.reshape(-1, 3), axis=0).max()
    face, opposite = np.arange(3 * len(faces)) // 3, np.roll(corners, -2, axis=1).reshape(-1, 3)
    over = opposite[twin] - corners.reshape(-1, 3)
    height = np.einsum("ei,ei->e", normals[face], over)
    locally = (height < tolerances.CONVEX * size).all() and (np.linalg.norm(normals, axis=1) > 0.5).all()
    return bool(locally and len(np.unique(faces)) - len(twin) // 2 + len(faces) == 2)


def encloses(corners, point):
    """Whether the closed mesh encloses the ``point`` (3,): its solid angle is 4 pi, not 0."""
    a, b, c = (corners[:, k] - point for k in range(3))
    return bool(abs(_solid_angles(a, b, c)[0].sum()) > 2 * np.pi)

"""Facts about a triangle mesh that decide whether and how it can be rendered. NumPy float64 only."""

import numpy as np


def weld(vertices, faces):
    """Faces with vertices at the same position made one: (F, 3) indices of unique positions."""
    _, inverse = np.unique(vertices, axis=0, return_inverse=True)
    return inverse.reshape(-1)[faces]


def twins(faces):
    """Pairs each directed edge with its reverse.

    Edge ``3 f + k`` runs from corner k of face f to corner k + 1. Returns the twin of each edge, or None if
    an edge has none or several: the mesh then has a hole, or faces of inconsistent orientation.
    """
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    n = int(faces.max()) + 1
    forward, backward = tail.astype(np.int64) * n + head, head.astype(np.int64) * n + tail
    i, j = np.argsort(forward), np.argsort(backward)
    keys = forward[i]
    if (keys[1:] == keys[:-1]).any() or (keys != backward[j]).any():
        return None
    twin = np.empty(len(keys), dtype=np.int64)
    twin[i] = j
    return twin


def volume(corners):
    """Signed volume enclosed by closed corners (F, 3, 3): positive if the triangles wind outwards."""
    centred = corners - corners.reshape(-1, 3).mean(axis=0)
    return float(np.einsum("fi,fi->", centred[:, 0], np.cross(centred[:, 1], centred[:, 2])) / 6)


def is_convex(corners, normals, faces, twin):
    """Whether a closed mesh with outward unit face ``normals`` bounds one convex body.

    Locally convex across every edge, one component, no handles.
    """
    size = np.ptp(corners.reshape(-1, 3), axis=0).max()
    face, opposite = np.arange(3 * len(faces)) // 3, np.roll(corners, -2, axis=1).reshape(-1, 3)
    over = opposite[twin] - corners.reshape(-1, 3)
    height = np.einsum("ei,ei->e", normals[face], over)
    # float32 positions are good to 6e-8 of the size.
    locally = (height < 1e-6 * size).all() and (np.linalg.norm(normals, axis=1) > 0.5).all()
    return bool(locally and len(np.unique(faces)) - len(twin) // 2 + len(faces) == 2)


def encloses(corners, point):
    """Whether the closed mesh with corners (F, 3, 3) encloses the point: its solid angle is 4 pi, not 0."""
    a, b, c = (corners[:, k] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    triple = np.einsum("fi,fi->f", a, np.cross(b, c))
    dots = np.einsum("fi,fi->f", a, b) * lc + np.einsum("fi,fi->f", b, c) * la + np.einsum("fi,fi->f", c, a) * lb
    angle = 2 * np.arctan2(triple, la * lb * lc + dots)
    return bool(abs(angle.sum()) > 2 * np.pi)

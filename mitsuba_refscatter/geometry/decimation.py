"""A coarse mesh through some of the vertices of a fine one: vertices are taken away while the surface stays smooth.

Half-edge collapses (a vertex is moved onto one of its neighbours) in rounds, each of many at once that do not touch.
What lies on creases and holes stays: there, faces have vertices of their own. NumPy float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import tolerances
from . import mesh


@dataclass(frozen=True)
class _Vertices:
    """Those of the fine mesh.

    positions  float32 (V, 3)
    normals    float32 (V, 3), unit
    """

    positions: np.ndarray
    normals: np.ndarray

    def __len__(self):
        return len(self.positions)


@dataclass(frozen=True)
class _Allowed:
    """What the faces and edges that are made must be.

    longest  length of edges, at most
    cosine   between the normals at the ends of edges, at least
    shape    height of faces relative to their longest edge, at least
    """

    longest: float
    cosine: float
    shape: float


def coarser(vertices, normals, faces, twin, turns, longest):
    """Ever coarser meshes over the same vertices: yields faces (K, 3) for each of the ``turns``.

    vertices  (V, 3)
    normals   (V, 3), unit, on the side to which the faces wind
    faces     (F, 3), of the fine mesh
    twin      (3 F,), of each directed edge (``mesh.twins``)
    turns     largest differences between the unit normals at the ends of edges that are made, rising
    longest   length of these edges, at most
    """
    fixed = np.zeros(len(vertices), dtype=bool)
    fixed[faces.ravel()[twin < 0]] = fixed[np.roll(faces, -1, axis=1).ravel()[twin < 0]] = True
    vertices = _Vertices(vertices.astype(np.float32), normals.astype(np.float32))
    random = np.random.default_rng(0)
    shape = tolerances.FIRST_SHAPE
    for least in (1 - 0.5 * turn**2 for turn in turns):
        done = len(faces)
        while done > tolerances.ROUND_WORTH * len(faces):
            faces, done = _round(vertices, faces, fixed, _Allowed(longest, least, shape), random)
            if shape < tolerances.LEAST_SHAPE:
                faces, _ = _flips(vertices, faces, least, random)
            shape = tolerances.LEAST_SHAPE
        done = len(faces)
        while done > tolerances.ROUND_WORTH * len(faces):
            faces, done = _flips(vertices, faces, least, random)
        yield faces


def _flips(vertices, faces, cosine, random):
    """Flips some edges between two faces where the angles opposite to them are more than 180 degrees together.

    ``cosine``: the smallest between the normals at the ends of the new edge. Returns the faces and how many edges were
    flipped.
    """
    twin = mesh.twins(faces)
    assert twin is not None, "collapses and flips keep edges between two faces"
    edge = np.flatnonzero(np.arange(len(twin)) < twin)
    other = twin[edge]
    corner = faces.ravel()
    a, b, c, d = corner[edge], corner[_next(edge)], corner[_next(_next(edge))], corner[_next(_next(other))]
    cosine_c, sine_c = _angle(vertices.positions, c, a, b)
    cosine_d, sine_d = _angle(vertices.positions, d, a, b)
    bad = sine_c * cosine_d + cosine_c * sine_d < -tolerances.FLIP
    bad &= np.einsum("ij,ij->i", vertices.normals[c], vertices.normals[d]) >= cosine
    edge, other, a, b, c, d = (x[bad] for x in (edge, other, a, b, c, d))
    good = _lies_well(vertices, a, d, c) & _lies_well(vertices, d, b, c)
    edge, other, a, b, c, d = (x[good] for x in (edge, other, a, b, c, d))
    rank = random.permutation(len(edge))
    least = np.full(len(faces), len(edge))
    for face in (edge // 3, other // 3):
        np.minimum.at(least, face, rank)
    chosen = (least[edge // 3] == rank) & (least[other // 3] == rank)
    tail, head = corner, np.roll(faces, -1, axis=1).ravel()
    edge, other, a, b, c, d = (x[chosen] for x in (edge, other, a, b, c, d))
    good = ~_clash(c, d, tail, head, len(vertices))
    edge, other, a, b, c, d = (x[good] for x in (edge, other, a, b, c, d))
    faces = faces.copy()
    faces[edge // 3], faces[other // 3] = np.stack([a, d, c], axis=1), np.stack([d, b, c], axis=1)
    return faces, len(edge)


def _next(edge):
    """The edge that follows in a face."""
    return edge - edge % 3 + (edge + 1) % 3


def _angle(positions, at, a, b):
    """Cosine and sine of angles."""
    x, y = positions[a] - positions[at], positions[b] - positions[at]
    cosine, sine = np.einsum("ij,ij->i", x, y), np.linalg.norm(np.cross(x, y), axis=1)
    length = np.sqrt(cosine**2 + sine**2)
    return cosine / length, sine / length


def _lies_well(vertices, a, b, c):
    """Whether faces (a, b, c) lie well below the normals at their corners."""
    positions = vertices.positions
    m = np.cross(positions[b] - positions[a], positions[c] - positions[a])
    least = tolerances.LEAN * np.linalg.norm(m, axis=1)
    return np.all([np.einsum("ij,ij->i", m, vertices.normals[i]) > least for i in (a, b, c)], axis=0)


def _round(vertices, faces, fixed, allowed, random):
    """Collapses some vertices that are not ``fixed``, no two of them neighbours.

    Returns the faces left and how many vertices went.
    """
    count = len(vertices)
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    rank = np.full(count, np.inf, dtype=np.float32)
    used = np.zeros(count, dtype=bool)
    used[tail] = True
    free = np.flatnonzero(used & ~fixed)
    if len(free) == 0:
        return faces, 0
    rank[free] = random.permutation(len(free))
    least = rank.copy()
    np.minimum.at(least, tail, rank[head])
    chosen = (least == rank) & np.isfinite(rank)
    # The fans: faces (u, p, q) around each chosen u. No face is in two of them.
    face, k = np.nonzero(chosen[faces])
    u, p, q = (faces[face, (k + i) % 3] for i in range(3))
    order = np.argsort(u, kind="stable")
    u, p, q = u[order], p[order], q[order]
    v = _best(vertices, u, p, q, allowed)
    target = np.full(count, -1, dtype=np.int64)
    target[u] = v
    second = np.zeros(count, dtype=np.int64)
    second[u[p == v]] = q[p == v]
    made = (v >= 0) & (p != v) & (q != v) & (p != second[u])
    refused = np.zeros(count, dtype=bool)
    refused[u[made][_clash(v[made], p[made], tail, head, count)]] = True
    gone = np.flatnonzero((target >= 0) & ~refused)
    to = np.arange(count)
    to[gone] = target[gone]
    faces = to[faces]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return faces[whole], len(gone)


def _best(vertices, u, p, q, allowed):
    """The neighbour of u that it may be moved onto such that the worst of the faces is best shaped.

    ``u``, ``p``, ``q``: corners of the faces of each fan, sorted by u. The neighbour is -1 where there is none.
    """
    first = np.flatnonzero(np.r_[True, u[1:] != u[:-1]])
    degree = np.diff(np.r_[first, len(u)])
    # Every face of a fan with every neighbour in it.
    of = np.repeat(first, degree), np.repeat(degree, degree)
    face = np.repeat(np.arange(len(u)), of[1])
    start = np.cumsum(of[1]) - of[1]
    neighbour = np.repeat(of[0], of[1]) + np.arange(len(face)) - np.repeat(start, of[1])
    v = p[neighbour]
    shape = _shape(vertices, v, p, q, face, allowed)
    worst = np.full(len(u), np.inf)
    np.minimum.at(worst, neighbour, np.where((p[face] == v) | (q[face] == v), np.inf, shape))
    best = np.maximum.reduceat(worst, first)
    best = np.repeat(best, degree)
    chosen = np.flatnonzero((worst == best) & (best >= allowed.shape))
    group = np.repeat(np.arange(len(first)), degree)
    of_group = np.full(len(first), -1, dtype=np.int64)
    of_group[group[chosen]] = p[chosen]
    return of_group[group]


def _shape(vertices, v, p, q, face, allowed):
    """Height relative to the longest edge of faces (v, p, q), where ``face`` says which (p, q).

    It is -1 where they do not lie well below their normals or an edge (v, p) is not allowed.
    """
    at_p, at_q, n_p = vertices.positions[p], vertices.positions[q], vertices.normals[p]
    opposite = np.square(at_p - at_q).sum(axis=1)
    at, n = vertices.positions[v], vertices.normals[v]
    a, b = at_p[face] - at, at_q[face] - at
    m = np.cross(a, b)
    area, edge2 = np.sqrt(np.einsum("ij,ij->i", m, m)), np.einsum("ij,ij->i", a, a)
    good = (edge2 <= allowed.longest**2) & (np.einsum("ij,ij->i", n, n_p[face]) >= allowed.cosine)
    good &= np.einsum("ij,ij->i", m, n) >= tolerances.LEAN * area
    edge2 = np.maximum(np.maximum(edge2, np.einsum("ij,ij->i", b, b)), opposite[face])
    return np.where(good, area / edge2, -1)


def _clash(v, p, tail, head, count):
    """Which of the edges (v, p) that collapses make exist already or are made by another one, too."""
    key = mesh.edge_keys(v, p, count)
    near = np.zeros(count, dtype=bool)
    near[v] = True
    known = near[tail] | near[head]
    tail, head = tail[known], head[known]
    there = np.isin(key, mesh.edge_keys(tail, head, count))
    _, first = np.unique(key, return_index=True)
    again = np.ones(len(key), dtype=bool)
    again[first] = False
    return there | again

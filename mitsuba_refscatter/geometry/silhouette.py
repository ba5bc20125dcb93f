"""Which triangles are lit uniformly: no silhouette seen from the light lies in front of them.

A light is given as ``light`` (3 numbers) and ``distant``: a point, or the unit direction to one that is infinitely far.

A silhouette edge lies between a facet that faces the light and one that does not, or is the edge of a hole. Along a
triangle the number of surfaces between it and a light changes only where the line of sight passes such an edge.
Triangles with no silhouette edge in front of them in the light's view are therefore all lit or all in shadow. That
holds for meshes that do not cut through each other or themselves. A raster of the light's view (NumPy float64) settles
most triangles, an exact test of all edges (Dr.Jit) the others.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from .interval import positive_part


def silhouette_edges(corners, normals, twin, light, distant):
    """Edges (E, 2, 3) between facets that face the light and facets that do not, and those of holes.

    corners  (F, 3, 3)
    normals  (F, 3), unit, geometric, outward
    twin     (3 F,), of each directed edge (``mesh.twins``)
    light    (3,), in the coordinates of the corners
    distant  whether it is a direction
    """
    to_light = np.broadcast_to(light, normals.shape) if distant else light - corners[:, 0]
    facing = np.einsum("fi,fi->f", normals, to_light) > 0
    edge = np.arange(len(twin))
    first = np.flatnonzero((twin < 0) | ((facing[edge // 3] != facing[twin // 3]) & (edge < twin)))
    return np.stack([corners.reshape(-1, 3)[first], np.roll(corners, -1, axis=1).reshape(-1, 3)[first]], axis=1)


def uniform(corners, edges, light, distant):
    """For each triangle (F,): True if no edge is in front of it as seen from the light.

    corners  (F, 3, 3)
    edges    (E, 2, 3), in the same coordinates
    light    (3,), the same
    distant  whether it is a direction

    Conservative on a raster of the light's view. False throughout where the view is too wide or the edges are too long.
    """
    view, none = _view(corners, light, distant), np.zeros(len(corners), dtype=bool)
    if view is None:
        return none
    origin = 0 if distant else light
    edge_points, edge_depth = _project(edges.reshape(-1, 3) - origin, view, distant)
    if not distant and (edge_depth <= 0).any():  # an edge beside or behind the light may cross the view anywhere
        return none
    points, depth = _project(corners.reshape(-1, 3) - origin, view, distant)
    points = points.reshape(-1, 3, 2)
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    levels = np.ceil(np.log2(tolerances.RASTER_CELLS * np.sqrt(len(corners))))
    levels = int(np.clip(levels, *tolerances.RASTER_LEVELS))
    scale = ((1 << levels) - 4) / np.maximum(high - low, 1e-30)
    nearest = _raster(
        (edge_points.reshape(-1, 2, 2) - low) * scale + 2, edge_depth.reshape(-1, 2).min(axis=1), 1 << levels
    )
    if nearest is None:
        return none
    first = np.floor((points.min(axis=1) - low) * scale).astype(int) + 1
    last = np.floor((points.max(axis=1) - low) * scale).astype(int) + 3
    return _least(nearest, first, last) > depth.reshape(-1, 3).max(axis=1)


def _view(corners, light, distant):
    """Axes (3, 3) of the light's view, the last towards the triangles; None where they fill too wide a field."""
    to = -light[None] if distant else corners.reshape(-1, 3) - light
    to = to / np.linalg.norm(to, axis=1, keepdims=True)
    axis = to.mean(axis=0)
    length = np.linalg.norm(axis)
    if length < tolerances.WIDEST_VIEW or (to @ (axis / length)).min() < tolerances.WIDEST_VIEW:
        return None
    axis /= length
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(axis, side), axis])


def _project(to, view, distant):
    """Projection (n, 2), perspective but for distant lights, and depth along the axis (n,)."""
    x = to @ view.T
    return (x[:, :2], x[:, 2]) if distant else (x[:, :2] / np.where(x[:, 2] > 0, x[:, 2], 1)[:, None], x[:, 2])


def _raster(edges, depth, cells):
    """Smallest depth of the edges (E, 2, 2; in cell units) that pass each cell, infinite where none does; None
    if that takes too many steps. Exact to one cell."""
    steps = np.ceil(2 * np.abs(edges[:, 1] - edges[:, 0]).max(axis=1, initial=0)) + 2
    if steps.sum() > tolerances.RASTER_STEPS:
        return None
    steps = steps.astype(int)
    edge = np.repeat(np.arange(len(edges)), steps)
    k = (np.arange(len(edge)) - np.repeat(np.cumsum(steps) - steps, steps)) / np.repeat(steps - 1, steps)
    cell = np.floor(edges[edge, 0] + k[:, None] * (edges[edge, 1] - edges[edge, 0])).astype(int)
    inside = ((cell >= 0) & (cell < cells)).all(axis=1)
    nearest = np.full((cells, cells), np.inf, dtype=np.float32)
    depth = depth - tolerances.RASTER_ROUNDING * np.abs(depth)
    np.minimum.at(nearest, tuple(cell[inside].T), depth[edge[inside]].astype(np.float32))
    return nearest


def _least(raster, first, last):
    """At most the smallest value in each rectangle of cells, corners ``first`` to ``last`` (n, 2) inclusive."""
    level = np.ceil(np.log2((last - first + 1).max(axis=1))).astype(int)
    out = np.empty(len(first), dtype=raster.dtype)
    for k in range(level.max(initial=0) + 1):
        at = level == k
        (i0, j0), (i1, j1) = (np.minimum(x[at] >> k, len(raster) - 1).T for x in (first, last))
        out[at] = np.minimum(np.minimum(raster[i0, j0], raster[i1, j0]), np.minimum(raster[i0, j1], raster[i1, j1]))
        if len(raster) > 1:
            raster = raster.reshape(len(raster) // 2, 2, len(raster) // 2, 2).min(axis=(1, 3))
    return out


def covered(corners, normal, edges, skin, direction):
    """Whether any edge is in front of triangles, lane by lane (Bool). Positions are relative to the light.

    corners    three Vector3f
    normal     Vector3f, unit, of the facet
    edges      (E, 2, 3)
    skin       float; edges within that distance of a triangle's plane do not count
    direction  Vector3f, of a distant light, or None; positions are then relative to any place
    """
    flat, count = arrays.array(mi.Float, np.ravel(edges)), dr.opaque(mi.UInt32, len(edges))
    skin = dr.opaque(mi.Float, skin)
    sides = []
    for k in range(3):
        if direction is None:
            n, base = dr.normalize(dr.cross(corners[k], corners[(k + 1) % 3])), mi.Vector3f(0)
        else:
            n, base = dr.normalize(dr.cross(corners[(k + 1) % 3] - corners[k], direction)), corners[k]
        n *= dr.sign(dr.dot(n, corners[(k + 2) % 3] - base))
        sides.append((n, dr.dot(n, base)))

    def test(j, found):
        a, b = (dr.gather(mi.Vector3f, flat, 2 * j + k) for k in range(2))
        slack = tolerances.SILHOUETTE_SLACK * dr.maximum(dr.norm(a), dr.norm(b))
        ends = [(dr.dot(n, a) - at + slack, dr.dot(n, b) - at + slack) for n, at in sides]
        ends.append((dr.dot(normal, a - corners[0]) - skin, dr.dot(normal, b - corners[0]) - skin))
        low, high = positive_part(ends)
        return j + 1, found | (low <= high)

    n = dr.width(normal)
    state = (dr.zeros(mi.UInt32, n), dr.zeros(mi.Bool, n))
    return dr.while_loop(state, lambda j, found: (j < count) & ~found, test, label="silhouette", mode="symbolic")[1]

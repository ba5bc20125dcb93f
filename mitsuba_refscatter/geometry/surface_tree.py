"""A tree over the triangles of a surface, whose nodes bound positions and normals."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..core import arrays
from . import bvh, triangle


class SurfaceTree:
    """The tree over the triangles of a body, whose centres decide their order.

    records       the packed triangles of the body, and maybe others
    first_record  int, index of the body's first triangle
    corners       float64 (F, 3, 3), body coordinates
    normals       ``Triangle`` -> list of the normals (Vector3f) to bound
    pack          (low, high, n_low, n_high) -> list of the numbers of a node, from its boxes of positions and normals
    width         int, how many these are
    """

    def __init__(self, records, first_record, corners, normals, pack, width):
        order = bvh.median_order(corners.mean(axis=1)) + first_record
        self.records, self.count = records, len(order)
        self.order = arrays.array(mi.UInt32, order)
        depth = bvh.depth_for(self.count)
        self.tree = bvh.fold(self._leaves(depth, normals), depth, _merge, pack, width)

    def member(self, leaf, j, active=True):
        """Index (UInt32) and ``Triangle`` of the ``j``-th in leaves (UInt32).

        Places behind the end repeat the last one.
        """
        return self.at(leaf * bvh.LEAF + j, active)

    def at(self, place, active=True):
        """Index (UInt32) and ``Triangle`` at places (UInt32) of the tree's order."""
        place = dr.minimum(place, dr.opaque(mi.UInt32, self.count - 1))
        index = dr.gather(mi.UInt32, self.order, place, active)
        return index, triangle.gather(self.records, index, active)

    def _leaves(self, depth, normals):
        leaf = dr.arange(mi.UInt32, 1 << depth)
        bounds = None
        for j in range(bvh.LEAF):
            _, tri = self.member(leaf, j)
            item = (*bvh.box(tri.corners()), *bvh.box(normals(tri)))
            bounds = item if bounds is None else _merge(bounds, item)
        return tuple(bounds)


def _merge(a, b):
    return tuple(dr.minimum(x, y) if i % 2 == 0 else dr.maximum(x, y) for i, (x, y) in enumerate(zip(a, b)))

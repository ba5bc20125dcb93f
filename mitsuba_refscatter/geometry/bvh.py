"""A perfect binary tree over items: built level by level, traversed without a stack.

Nodes are in heap order: the root is 1, the children of ``i`` are ``2 i`` and ``2 i + 1``. With ``depth`` levels below
the root the leaves are ``2^depth .. 2^(depth+1) - 1``. A leaf holds ``LEAF`` consecutive items. Node bounds belong to
the caller, who gives a ``merge`` and a ``hit`` function.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from .triangle import gather_numbers, scatter_numbers

LEAF = 4
"""Items in a leaf. Fixed, so that no kernel depends on the number of items."""


@dataclass
class Tree:
    """A perfect binary tree.

    nodes   Float, flat records of the nodes' bounds for 2^(depth+1) heap slots (slot 0 is not used)
    record  numbers per node
    depth   levels below the root
    """

    nodes: mi.Float
    record: int
    depth: int


def depth_for(n_items):
    """Levels below the root such that the leaves hold ``n_items`` (int).

    >>> depth_for(LEAF), depth_for(LEAF + 1), depth_for(8 * LEAF)
    (0, 1, 3)
    """
    leaves = max(1, -(-n_items // LEAF))
    return int(np.ceil(np.log2(leaves)))


def median_order(points):
    """Order of items for the tree, by recursive median splits along the widest axis: (N, 3) -> (N,) indices.

    Vectorised over the nodes of a level; the empty places at the end are sorted behind everything.
    """
    n = len(points)
    depth = depth_for(n)
    size = LEAF << depth
    padded = np.full((size, 3), np.inf, dtype=np.float32)
    padded[:n] = points
    order = np.arange(size)
    for level in range(depth):
        rows = order.reshape(1 << level, -1)
        p = padded[rows]
        low = p.min(axis=1)
        high = np.where(np.isfinite(p), p, -np.inf).max(axis=1)
        with np.errstate(invalid="ignore"):
            extent = high - low
        key = np.take_along_axis(p, np.nan_to_num(extent).argmax(axis=1)[:, None, None], axis=2)[:, :, 0]
        split = np.argpartition(key, rows.shape[1] // 2, axis=1)
        order = np.take_along_axis(rows, split, axis=1).ravel()
    return order[order < n]


def morton_order(points):
    """The same order along a Morton curve: quicker to find, for trees that are walked once, and leaves are larger."""
    low = points.min(axis=0)
    scale = (2.0**21 - 1) / max(float((points.max(axis=0) - low).max()), 1e-30)
    code = np.zeros(len(points), dtype=np.uint64)
    for axis in range(3):
        x = ((points[:, axis] - low[axis]) * scale).astype(np.uint64)
        for shift, mask in (
            (32, 0x1F00000000FFFF),
            (16, 0x1F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):
            x = (x | (x << np.uint64(shift))) & np.uint64(mask)
        code |= x << np.uint64(axis)
    return np.argsort(code)


def finite_inverse(d):
    """1 / d of directions (Vector3f), finite also where d is 0, for box tests."""
    least = tolerances.LEAST_DIRECTION
    return mi.Vector3f(*(dr.rcp(dr.select(dr.abs(x) < least, dr.mulsign(least, x), x)) for x in d))


def box(points):
    """Smallest and largest coordinates of a list of points (Point3f or Vector3f)."""
    low = high = points[0]
    for p in points[1:]:
        low, high = dr.minimum(low, p), dr.maximum(high, p)
    return low, high


def fold(leaf_bounds, depth, merge, pack, record):
    """Builds the ``Tree`` from the bounds of its leaves. All levels run the same kernel.

    leaf_bounds  tuple of Dr.Jit arrays of width 2^depth
    depth        int, levels below the root
    merge        (bounds, bounds) -> bounds of both
    pack         bounds -> list of the numbers of a node, Float each
    record       int, how many these are, a multiple of 4
    """
    nodes = dr.empty(mi.Float, record << (depth + 1))
    bounds = leaf_bounds
    for level in range(depth, -1, -1):
        first = dr.opaque(mi.UInt32, 1 << level)
        i = dr.arange(mi.UInt32, 1 << level)
        scatter_numbers(nodes, pack(bounds), first + i)
        dr.eval(nodes)
        if level > 0:
            i = dr.arange(mi.UInt32, 1 << (level - 1))
            left = tuple(dr.gather(type(b), b, 2 * i) for b in bounds)
            right = tuple(dr.gather(type(b), b, 2 * i + 1) for b in bounds)
            bounds = merge(left, right)
            dr.eval(bounds)
    return Tree(nodes, record, depth)


def walk(tree, width, visit, state):
    """Takes lanes through the tree depth first, without a stack. Returns the final state.

    tree   ``Tree``
    width  int, number of lanes
    visit  (numbers, leaf, at_leaf, active, state) -> (enter, state)
    state  of a lane at the beginning, a Dr.Jit type or a tuple of them

    ``visit`` gets a node's numbers and, where ``at_leaf`` (Bool), the leaf's index (UInt32). It says whether to go on
    below the node.
    """
    first_leaf = dr.opaque(mi.UInt32, 1 << tree.depth)

    def step(node, active, state):
        at_leaf = node >= first_leaf
        numbers = gather_numbers(tree.nodes, node, tree.record, active)
        enter, state = visit(numbers, node - first_leaf, at_leaf, active, state)
        # Next in depth-first order: down to the left child, or on to the nearest unvisited right one.
        right = node + 1
        right >>= dr.tzcnt(right)
        node = dr.select(active & enter & ~at_leaf, 2 * node, right)
        return node, active & (node != 1), state

    begin = (dr.full(mi.UInt32, 1, width), dr.full(mi.Bool, True, width), state)
    return dr.while_loop(begin, lambda node, active, state: active, step, label="walk", mode="symbolic")[2]


def traverse(tree, lanes, hit, capacity):
    """All (lane, leaf) pairs that a test does not exclude: ``(lane, leaf, count)``.

    tree      ``Tree``
    lanes     UInt32, indices of the queries
    hit       (numbers of a node) -> Bool, conservative
    capacity  int, places for pairs

    ``lane`` and ``leaf`` are UInt32 arrays of ``capacity`` places, ``count`` is the number of pairs found. Where it is
    larger than ``capacity`` the rest was counted but not stored: ask again for fewer lanes.
    """
    out_lane, out_leaf = dr.empty(mi.UInt32, capacity), dr.empty(mi.UInt32, capacity)
    counter = dr.zeros(mi.UInt32)
    limit = dr.opaque(mi.UInt32, capacity)

    def visit(numbers, leaf, at_leaf, active, state):
        inside = active & hit(numbers)
        slot = dr.scatter_inc(counter, mi.UInt32(0), inside & at_leaf)
        store = inside & at_leaf & (slot < limit)
        dr.scatter(out_lane, lanes, slot, store)
        dr.scatter(out_leaf, leaf, slot, store)
        return inside, state

    walk(tree, dr.width(lanes), visit, ())
    dr.eval(out_lane, out_leaf, counter)
    return out_lane, out_leaf, int(counter[0])

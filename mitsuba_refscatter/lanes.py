"""Picking and joining lanes of arrays."""

import drjit as dr
import mitsuba as mi


def concat(parts):
    """Concatenates Dr.Jit arrays along their lanes, vectors component by component."""
    parts = list(parts)
    if len(parts) == 1:
        return parts[0]
    if dr.depth_v(parts[0]) == 1:
        return dr.concat(parts)
    return type(parts[0])(*(dr.concat([p[k] for p in parts]) for k in range(len(parts[0]))))


def chosen(*masks):
    """Indices of the lanes in each of the masks, found in the one kernel that computes these.

    Nearly in order, not exactly. Cheaper than ``dr.compress``, which reads the masks again.
    """
    n = dr.width(masks)
    i, found = dr.arange(mi.UInt32, n), []
    for mask in masks:
        counter, out = dr.zeros(mi.UInt32), dr.empty(mi.UInt32, n)
        dr.scatter(out, i, dr.scatter_inc(counter, mi.UInt32(0), mask), mask)
        found.append((counter, out))
    dr.eval(found)
    return [gather(out, dr.arange(mi.UInt32, int(counter[0]))) for counter, out in found]


def gather(x, index):
    """The lanes ``index`` of ``x``; no lanes for an empty index, which Dr.Jit does not take."""
    return type(x)() if dr.width(index) == 0 else dr.gather(type(x), x, index)


def of(x, index):
    """``x`` for the lanes ``index``: itself where it is the same for all lanes, or empty."""
    return x if dr.width(x) <= 1 else gather(x, index)

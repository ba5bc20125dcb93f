"""Picking and joining lanes of arrays."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

NONE = 0xFFFFFFFF
"""An index that means none."""

ALIGNMENT = 64
"""Bytes to which Dr.Jit aligns arrays of its own."""


def array(kind, values):
    """Numbers (a list or NumPy array) as a Dr.Jit array of type ``kind`` with memory of its own.

    ``kind(values)`` may share NumPy's, at any alignment, and takes a single number for a constant: in both cases other
    values mean other kernels. So the copy is made from an aligned one of the right type.
    """
    values = np.asarray(values).astype(kind().numpy().dtype)
    if values.size == 0:
        return kind()
    if values.size == 1:
        return dr.opaque(kind, values.item())
    room = np.empty(values.nbytes + ALIGNMENT, dtype=np.uint8)
    start = -room.ctypes.data % ALIGNMENT
    aligned = room[start : start + values.nbytes].view(values.dtype)
    aligned[:] = values
    out = dr.empty(kind, len(values))
    dr.scatter(out, kind(aligned), dr.arange(mi.UInt32, len(values)))
    dr.eval(out)
    return out


def concat(parts):
    """Concatenates Dr.Jit arrays along their lanes. Not ``dr.concat``, whose kernels hold the numbers of lanes."""
    parts = list(parts)
    if len(parts) == 1:
        return parts[0]
    kind, widths = type(parts[0]), [dr.width(part) for part in parts]
    out, start = dr.empty(kind, sum(widths)), 0
    for part, width in zip(parts, widths):
        if width > 0:
            dr.scatter(out, part, dr.opaque(mi.UInt32, start) + dr.arange(mi.UInt32, width))
            start += width
    return out


def gather_record(record, index):
    """A record of arrays at the lanes ``index`` (UInt32)."""
    return type(record)(*(gather(x, index) for x in vars(record).values()))


def concat_records(parts):
    """All lanes of a list of records of arrays, as one record."""
    return type(parts[0])(*(concat(x) for x in zip(*(vars(part).values() for part in parts))))


def chosen(*masks):
    """For each of several tuples of masks (Bool) the indices (UInt32) of what is in them, all found in one kernel.

    The masks of a tuple mean each lane's first, second, ... thing. Things are counted lane by lane. The indices are
    nearly in order, not exactly. Cheaper than ``dr.compress``, which reads the masks again.
    """
    n, found = dr.width(masks), []
    i = dr.arange(mi.UInt32, n)
    for several in masks:
        parts = []
        for j, mask in enumerate(several):
            counter, out = dr.zeros(mi.UInt32), dr.empty(mi.UInt32, n)
            dr.scatter(out, i * len(several) + j, dr.scatter_inc(counter, mi.UInt32(0), mask), mask)
            parts.append((counter, out))
        found.append(parts)
    dr.eval(found)
    return [concat(gather(out, dr.arange(mi.UInt32, int(counter[0]))) for counter, out in parts) for parts in found]


def repeat(counts):
    """For counts (NumPy, integers) of things that parents have: per thing its parent and its number there (UInt32).

    >>> repeat(np.array([2, 0, 3]))
    ([0, 0, 2, 2, 2], [0, 1, 0, 1, 2])
    """
    parent = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(len(parent)) - np.repeat(np.cumsum(counts) - counts, counts)
    return array(mi.UInt32, parent), array(mi.UInt32, number)


def gather(x, index):
    """The lanes ``index`` of ``x``; no lanes for an empty index, which Dr.Jit does not take."""
    return type(x)() if dr.width(index) == 0 else dr.gather(type(x), x, index)


def of(x, index):
    """``x`` for the lanes ``index``: itself where it is the same for all lanes, or empty.

    >>> index = mi.UInt32(2, 0)
    >>> of(mi.Float(1, 2, 3), index), of(mi.Float(7), index)
    ([3, 1], [7])
    """
    return x if dr.width(x) <= 1 else gather(x, index)


def room(n):
    """The next power of two: a width for sums over ``n`` lanes.

    Dr.Jit puts the width of what it scatters to into its kernels, which would be new ones for each ``n``.

    >>> [room(n) for n in (1, 2, 3, 1000)]
    [1, 2, 4, 1024]
    """
    return 1 << max(0, n - 1).bit_length()

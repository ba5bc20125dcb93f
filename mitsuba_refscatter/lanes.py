"""Picking and joining lanes of arrays."""

import drjit as dr


def concat(parts):
    """Concatenates Dr.Jit arrays along their lanes, vectors component by component."""
    parts = list(parts)
    if len(parts) == 1:
        return parts[0]
    if dr.depth_v(parts[0]) == 1:
        return dr.concat(parts)
    return type(parts[0])(*(dr.concat([p[k] for p in parts]) for k in range(len(parts[0]))))


def gather(x, index):
    """The lanes ``index`` of ``x``; no lanes for an empty index, which Dr.Jit does not take."""
    return type(x)() if dr.width(index) == 0 else dr.gather(type(x), x, index)

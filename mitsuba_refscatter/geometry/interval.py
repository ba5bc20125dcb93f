"""The interval [0, 1]: where linear functions are positive, and quadrature."""

from __future__ import annotations

import functools

import drjit as dr
import mitsuba as mi
import numpy as np


def positive_part(ends):
    """``(start, end)`` (Float) of the part of [0, 1] on which all linear functions are positive.

    ``ends``: for each function its values (Float) at 0 and at 1. start > end where there is no such part.

    >>> positive_part([(mi.Float(-1), mi.Float(1)), (mi.Float(3), mi.Float(-1))])
    ([0.5], [0.75])
    """
    start, end = mi.Float(0), mi.Float(1)
    for at_0, at_1 in ends:
        zero = at_0 / dr.select(at_0 == at_1, 1, at_0 - at_1)
        start = dr.select(at_0 < 0, dr.select(at_1 < 0, 2, dr.maximum(start, zero)), start)
        end = dr.select((at_1 < 0) & (at_0 >= 0), dr.minimum(end, zero), end)
    return start, end


@functools.cache
def gauss_legendre(points):
    """Gauss-Legendre nodes and weights on [0, 1], as many as ``points``, as lists of Python floats."""
    x, w = np.polynomial.legendre.leggauss(points)
    return [float(v) for v in 0.5 * (x + 1)], [float(v) for v in 0.5 * w]

"""A triangle with interpolated normals: ``P(u, v)``, ``n(u, v)`` and their derivatives; and a curved one, a patch.

The record of a triangle in a flat float array has ``RECORD`` numbers: ``P0, P_u, P_v, n0, n_u, n_v`` (3 numbers each)
and the unit geometric normal ``Ng``, padded. That of a patch has ``PATCH`` numbers: the same, and how far P and n are
from linear in the middles of the edges 01, 12, 20.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

RECORD, PATCH = 24, 40


@dataclass
class Triangle:
    """Triangles, lane by lane, body coordinates; u and v are the weights of the second and third corner.

    P0        Vector3f, first corner
    P_u, P_v  Vector3f, from there to the second and third
    n0        Vector3f, unit normal at the first corner, outward
    n_u, n_v  Vector3f, differences of the normals at the second and third to that
    Ng        Vector3f, unit geometric normal, outward
    """

    P0: mi.Vector3f
    P_u: mi.Vector3f
    P_v: mi.Vector3f
    n0: mi.Vector3f
    n_u: mi.Vector3f
    n_v: mi.Vector3f
    Ng: mi.Vector3f

    curved = False

    def position(self, u, v):
        """Point of the triangle at (u, v)."""
        return dr.fma(self.P_v, v, dr.fma(self.P_u, u, self.P0))

    def tangents(self, _u, _v):
        """Derivatives of the position in u and v."""
        return self.P_u, self.P_v

    def normal_before(self, u, v):
        """Interpolated normal at (u, v), of any length."""
        return dr.fma(self.n_v, v, dr.fma(self.n_u, u, self.n0))

    def normal_slopes(self, _u, _v):
        """Derivatives of ``normal_before`` in u and v."""
        return self.n_u, self.n_v

    def controls(self):
        """Bezier control points of positions, and of normals, two lists: both are inside their hulls."""
        return self.corners(), self.corner_normals()

    def corners(self):
        """Positions of the corners, three Vector3f."""
        return [self.P0, self.P0 + self.P_u, self.P0 + self.P_v]

    def ball(self):
        """Centre (Vector3f) and radius (Float) of a sphere around the plane triangle."""
        centre = self.P0 + (self.P_u + self.P_v) / 3
        a, b, c = (dr.norm(p - centre) for p in self.corners())
        return centre, dr.maximum(a, dr.maximum(b, c))

    def corner_normals(self):
        """Unit normals at the corners, three Vector3f."""
        return [self.n0, self.n0 + self.n_u, self.n0 + self.n_v]

    def normal(self, u, v):
        """Unit interpolated normal at (u, v)."""
        return dr.normalize(self.normal_before(u, v))

    def normal_derivative(self, u, v, a, b):
        """Unit interpolated normal at (u, v) and its derivative in the direction (a, b) of the (u, v) plane."""
        m = self.normal_before(u, v)
        r = dr.rsqrt(dr.squared_norm(m))
        n = m * r
        m_u, m_v = self.normal_slopes(u, v)
        d_m = m_u * a + m_v * b
        return n, (d_m - n * dr.dot(n, d_m)) * r


@dataclass
class Patch(Triangle):
    """Triangles whose positions and normals are quadratic in (u, v), lane by lane, body coordinates.

    They go through values at the corners and at the middles of the edges 01, 12, 20. The fields of ``Triangle`` are
    those of the plane triangle through the corners.

    P2  three Vector3f, what is to be added to linear positions in the middles of the edges
    n2  three Vector3f, the same for normals
    """

    P2: list[mi.Vector3f]
    n2: list[mi.Vector3f]
    curved = True

    def position(self, u, v):
        return _add_quadratic(super().position(u, v), self.P2, u, v)

    def tangents(self, u, v):
        return _add_slopes(super().tangents(u, v), self.P2, u, v)

    def normal_before(self, u, v):
        return _add_quadratic(super().normal_before(u, v), self.n2, u, v)

    def normal_slopes(self, u, v):
        return _add_slopes(super().normal_slopes(u, v), self.n2, u, v)

    def controls(self):
        return [
            [*x, *(0.5 * (x[i] + x[(i + 1) % 3]) + 2 * more[i] for i in range(3))]
            for x, more in ((self.corners(), self.P2), (self.corner_normals(), self.n2))
        ]


def _add_quadratic(linear, middles, u, v):
    w = 1 - u - v
    return linear + 4 * (middles[0] * (u * w) + middles[1] * (u * v) + middles[2] * (v * w))


def _add_slopes(linear, middles, u, v):
    a, b, c = middles
    by_u, by_v = a * (1 - 2 * u - v) + (b - c) * v, (b - a) * u + c * (1 - u - 2 * v)
    return linear[0] + 4 * by_u, linear[1] + 4 * by_v


@dataclass
class Patches:
    """Records of patches, in the place of records of triangles.

    numbers  Float, flat, ``PATCH`` numbers per patch
    """

    numbers: mi.Float


def geometric_normal(corners):
    """Unit geometric normals (F, 3) of float64 corners (F, 3, 3); zero for a triangle without area."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    return np.divide(cross, length, out=np.zeros_like(cross), where=length > 0)


def pack(corners, normals, Ng):
    """Triangle records (flat float32, ``RECORD`` numbers each).

    corners  (F, 3, 3), body coordinates
    normals  (F, 3, 3), unit, outward, at the corners
    Ng       (F, 3), unit, geometric, outward
    """
    return _records(corners, normals, Ng, RECORD).ravel()


def pack_patches(corners, normals, Ng, P2, n2):
    """Records of patches (flat float32, ``PATCH`` numbers each).

    corners  as of ``pack``
    normals  as of ``pack``
    Ng       as of ``pack``
    P2       (F, 3, 3), what is to be added to linear positions in the middles of the edges
    n2       (F, 3, 3), the same for normals
    """
    record = _records(corners, normals, Ng, PATCH)
    record[:, 21:39] = np.concatenate([P2, n2], axis=1).reshape(len(corners), 18)
    return record.ravel()


def _records(corners, normals, Ng, size):
    P0, P1, P2 = corners[:, 0], corners[:, 1], corners[:, 2]
    n0, n1, n2 = normals[:, 0], normals[:, 1], normals[:, 2]
    record = np.zeros((len(corners), size), dtype=np.float32)
    parts = [P0, P1 - P0, P2 - P0, n0, n1 - n0, n2 - n0, Ng]
    record[:, :21] = np.concatenate(parts, axis=1)
    return record


def gather(records, index, active=True):
    """The ``Triangle`` at ``index`` (UInt32) of packed ``records`` (Float), or the ``Patch`` of ``Patches``."""
    patches = isinstance(records, Patches)
    x = gather_numbers(records.numbers if patches else records, index, PATCH if patches else RECORD, active)
    fields = [mi.Vector3f(x[i : i + 3]) for i in range(0, 39 if patches else 21, 3)]
    return Patch(*fields[:7], fields[7:10], fields[10:]) if patches else Triangle(*fields)


def gather_numbers(records, index, count, active=True):
    """The numbers of records as a list of Float; packets of 4 are single loads.

    records  Float, flat
    index    UInt32, of the records
    count    int, numbers per record, a multiple of 4
    active   Bool, those that are asked for
    """
    out = []
    for k in range(count // 4):
        out.extend(dr.gather(mi.Vector4f, records, index * (count // 4) + k, active))
    return out


def scatter_numbers(records, values, index):
    """Writes one record per lane.

    records  Float, flat
    values   list of Float, numbers of a record, a multiple of 4
    index    UInt32, of the records
    """
    n = len(values) // 4
    for k in range(n):
        dr.scatter(records, mi.Vector4f(*values[4 * k : 4 * k + 4]), index * n + k)

"""A triangle with interpolated normals: ``P(u, v)``, ``n(u, v)`` and their derivatives.

The record of a triangle in a flat float array has ``RECORD`` numbers: ``P0, P_u, P_v, n0, n_u, n_v`` (3 numbers each)
and the unit geometric normal ``Ng``, padded.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

RECORD = 24


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

    def position(self, u, v):
        """Point of the triangle at (u, v)."""
        return dr.fma(self.P_v, v, dr.fma(self.P_u, u, self.P0))

    def normal_before(self, u, v):
        """Interpolated normal at (u, v), of any length."""
        return dr.fma(self.n_v, v, dr.fma(self.n_u, u, self.n0))

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
        d_m = self.n_u * a + self.n_v * b
        return n, (d_m - n * dr.dot(n, d_m)) * r


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
    P0, P1, P2 = corners[:, 0], corners[:, 1], corners[:, 2]
    n0, n1, n2 = normals[:, 0], normals[:, 1], normals[:, 2]
    record = np.zeros((len(corners), RECORD), dtype=np.float32)
    record[:, :21] = np.concatenate([P0, P1 - P0, P2 - P0, n0, n1 - n0, n2 - n0, Ng], axis=1)
    return record.ravel()


def gather(records, index, active=True):
    """The ``Triangle`` at ``index`` (UInt32) of packed ``records`` (Float)."""
    x = gather_numbers(records, index, RECORD, active)
    return Triangle(*(mi.Vector3f(x[i : i + 3]) for i in range(0, 21, 3)))


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

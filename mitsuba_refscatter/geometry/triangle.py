"""A triangle with interpolated normals: ``P(u, v)``, ``n(u, v)`` and their derivatives.

Record of a triangle in a flat float array, ``RECORD`` numbers each:
``P0, P_u, P_v, n0, n_u, n_v`` (3 numbers each) and the unit geometric normal ``Ng``, padded.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

RECORD = 24


@dataclass
class Triangle:
    """Triangles gathered for some lanes; ``u`` and ``v`` are the weights of the second and third corner."""

    P0: object
    P_u: object
    P_v: object
    n0: object
    n_u: object
    n_v: object
    Ng: object

    def position(self, u, v):
        return dr.fma(self.P_v, v, dr.fma(self.P_u, u, self.P0))

    def corners(self):
        """Positions of the corners."""
        return [self.P0, self.P0 + self.P_u, self.P0 + self.P_v]

    def ball(self):
        """Centre and radius of a sphere around the triangle."""
        centre = self.P0 + (self.P_u + self.P_v) / 3
        a, b, c = (dr.norm(p - centre) for p in self.corners())
        return centre, dr.maximum(a, dr.maximum(b, c))

    def corner_normals(self):
        """Unit normals at the corners."""
        return [self.n0, self.n0 + self.n_u, self.n0 + self.n_v]

    def normal(self, u, v):
        """Unit interpolated normal."""
        return dr.normalize(dr.fma(self.n_v, v, dr.fma(self.n_u, u, self.n0)))

    def normal_derivative(self, u, v, a, b):
        """Unit interpolated normal and its derivative in the direction ``(a, b)`` of the (u, v) plane."""
        m = dr.fma(self.n_v, v, dr.fma(self.n_u, u, self.n0))
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
    """Triangle records (flat float32) from corner positions and outward unit corner normals (F, 3, 3), and
    the outward unit geometric normals (F, 3)."""
    P0, P1, P2 = corners[:, 0], corners[:, 1], corners[:, 2]
    n0, n1, n2 = normals[:, 0], normals[:, 1], normals[:, 2]
    record = np.zeros((len(corners), RECORD), dtype=np.float32)
    parts = [P0, P1 - P0, P2 - P0, n0, n1 - n0, n2 - n0, Ng]
    record[:, :21] = np.concatenate(parts, axis=1)
    return record.ravel()


def gather(records, index, active=True):
    """The triangles at ``index`` of the packed ``records``."""
    x = gather_numbers(records, index, RECORD, active)
    return Triangle(*(mi.Vector3f(x[i : i + 3]) for i in range(0, 21, 3)))


def gather_numbers(records, index, count, active=True):
    """``count`` numbers per record, a multiple of 4, as a list; packets of 4 are single loads."""
    out = []
    for k in range(count // 4):
        out.extend(dr.gather(mi.Vector4f, records, index * (count // 4) + k, active))
    return out


def scatter_numbers(records, values, index, active=True):
    """Writes one record of ``len(values)`` numbers, a multiple of 4, per lane."""
    n = len(values) // 4
    for k in range(n):
        dr.scatter(records, mi.Vector4f(*values[4 * k : 4 * k + 4]), index * n + k, active)

"""Culling by the spindle test: which triangles can refract light onto which camera segment, without precomputation
for the light, so that each segment may have a light point of its own.

Walter et al. 2009 (section 4) and Holzschuch 2015 (section 4.2): refraction at P turns the ray from the light L by at
most acos(min(eta, 1 / eta)), so P lies in a spindle around L and V; and the normal at P is parallel to
q = omega_L + eta omega_V. Both are tested with bounds of all P and normals of a node: a sphere and a cone. Here V
is not a point but a whole camera segment, as in the latter.
"""

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..geometry.surface import Surface
from . import beam as light_beam
from .pairs import Taken

NODE = 8
"""Numbers per node: centre and radius of the sphere, axis of the cone of normals and sine of its half-angle (1 or more:
all directions)."""


class Spindle:
    """The tree over the triangles of a body, and its tests. Independent of the light."""

    for_one_light = False

    def __init__(self, body, records):
        self.surface = Surface(
            records, body.first_record, body.corners - body.centre, lambda tri: tri.corner_normals(), _pack, NODE
        )
        self.tree, self.eta_above_1 = self.surface.tree, body.eta >= 1

    def node_test(self, segments, light):
        """The conservative test of camera segments against a node of the tree, for ``bvh.traverse``."""

        def hit(x):
            ball, cone = (mi.Vector3f(x[0:3]), x[3]), (mi.Vector3f(x[4:7]), x[7])
            return _may_refract(ball, cone, segments, light, self.eta_above_1)

        return hit

    def plausible(self, pairs, segment, light):
        """The test for single triangles, which must face the light, too."""
        if pairs.code is not None:
            return mi.Bool(True)
        exists = pairs.beam < dr.opaque(mi.UInt32, self.surface.count)
        _, tri = self.surface.at(pairs.beam, exists)
        centre = tri.position(1 / 3, 1 / 3)
        radius = light_beam.fold(dr.maximum, [dr.norm(p - centre) for p in tri.corners()])
        normals = tri.corner_normals()
        middle = (normals[0] + normals[1] + normals[2]) / 3
        wide = light_beam.fold(dr.maximum, [dr.norm(n - middle) for n in normals])
        facing = dr.dot(tri.Ng, light[0] - tri.P0) > 0
        possible = _may_refract((centre, radius), _cone(middle, wide), segment, light, self.eta_above_1)
        return exists & facing & possible

    def triangle_of(self, pairs):
        """Indices of the pairs' triangles among the scene's records."""
        return self.surface.at(pairs.beam)[0]

    def take(self, pairs, light, active=True):
        """``Taken``: triangles and light beams for pairs; nothing is proven."""
        _, tri = self.surface.at(pairs.beam, active)
        if pairs.code is None:
            place = mi.Float(0), mi.Float(0), mi.Float(1)
        else:
            place = light_beam.sub_triangle(pairs.code, pairs.level)
        return Taken(tri, light_beam.refract(tri, light, *place), mi.Float(0), mi.Bool(False))


def _pack(bounds):
    low, high, n_low, n_high = bounds
    c = 0.5 * (low + high)
    axis, sine = _cone(0.5 * (n_low + n_high), 0.5 * dr.norm(n_high - n_low))
    return [c.x, c.y, c.z, 0.5 * dr.norm(high - low), axis.x, axis.y, axis.z, sine]


def _cone(middle, radius):
    """Axis and sine of the cone around the vectors within ``radius`` of ``middle``."""
    length = dr.maximum(dr.norm(middle), 1e-30)
    return middle / length, dr.minimum(radius / length, 2)


def _may_refract(ball, cone, segment, light, eta_above_1):
    """False only if no point in the ball (centre, radius) with a normal in the cone (axis, sine of the half-angle) can
    refract light onto the segment."""
    (c, r), (axis, sin_n) = ball, cone
    L, eta = light
    to_L, a = L - c, segment.o - c
    b = a + segment.t_max * segment.d
    near = dr.norm(a + dr.clip(-dr.dot(a, segment.d), 0, segment.t_max) * segment.d)
    d_L = dr.norm(to_L)
    close = r >= 0.999 * dr.minimum(d_L, near)
    omega_L = to_L / dr.maximum(d_L, 1e-30)
    sin_L, sin_V = r / dr.maximum(d_L, 1e-30), r / dr.maximum(near, 1e-30)
    cos_L, cos_V = dr.safe_sqrt(1 - dr.square(sin_L)), dr.safe_sqrt(1 - dr.square(sin_V))

    def largest(w):
        """Largest cosine between w and the directions from c to the segment."""
        p, q, A, B = dr.dot(w, a), dr.dot(w, segment.d), dr.squared_norm(a), dr.dot(a, segment.d)
        slope = p - q * B
        t = dr.clip((q * A - p * B) / dr.select(slope == 0, 1, slope), 0, segment.t_max)
        ends = dr.maximum(p * dr.rsqrt(A), dr.dot(w, b) * dr.rsqrt(dr.squared_norm(b)))
        return dr.maximum(ends, (p + t * q) * dr.rsqrt(A + 2 * B * t + dr.square(t))), t

    # The largest turn acos(k), widened by what P may move both directions.
    k = dr.minimum(eta, dr.rcp(eta))
    cosine, sine = k, dr.safe_sqrt(1 - dr.square(k))
    cosine, sine = cosine * cos_L - sine * sin_L, sine * cos_L + cosine * sin_L
    cosine, sine = cosine * cos_V - sine * sin_V, sine * cos_V + cosine * sin_V
    straight, t = largest(-omega_L)
    possible = (sine <= 0) | (straight >= cosine - tolerances.COSINE)

    # Some normal looks to the light.
    cos_n = dr.safe_sqrt(1 - dr.square(sin_n))
    narrow = sin_n < 0.999
    sine, cosine = sin_n * cos_L + cos_n * sin_L, cos_n * cos_L - sin_n * sin_L
    possible &= ~narrow | (cosine <= 0) | (dr.dot(axis, omega_L) >= -sine - tolerances.COSINE)

    # Some normal is parallel to -q (eta > 1) or q. A plane through 0 that the cone of normals lies behind: is all of
    # -q, on the arc that omega_V takes and within rho of it, in front?
    sign = 1 if eta_above_1 else -1
    rho = sin_L * dr.sqrt(2 / (1 + cos_L)) + eta * sin_V * dr.sqrt(2 / (1 + cos_V))
    for _ in range(2):
        omega_V = dr.normalize(a + t * segment.d)
        x = -sign * (omega_L + eta * omega_V)
        side = x - axis * dr.dot(axis, x)
        length = dr.norm(side)
        m = side * (cos_n / dr.maximum(length, 1e-30)) - axis * sin_n
        most, t = largest(sign * m)
        possible &= ~narrow | (length < 1e-6) | (-sign * dr.dot(omega_L, m) - eta * most <= rho + tolerances.COSINE)
    return possible | close

"""The constraint that a refracted light path L -> P -> V fulfils, with its derivatives.

With unit directions omega_L from P to the light and omega_V from P to V = o + t d let q = omega_L + eta omega_V. Light
from L is refracted at P to V where q is parallel to the normal n, and both directions are on their sides of the
surface. The residual of this is q x n for every eta, given together with its 3 x 3 Jacobian by (t, u, v). At eta = 1,
where q itself is 0 and normals play no part, q is another residual, better at grazing incidence.

The published residual is sign(eta - 1) q / |q| + n (Walter et al. 2009; Holzschuch 2015). It loses digits as eta goes
to 1, where |q| goes to |eta - 1|.

In all omega_V points into the body on the line through P and V. So a root may also have V behind P (s < 0): callers
test ``s``.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dataclass
class Residual:
    """A residual and the columns of its Jacobian, lane by lane, in single or double precision.

    value  Vector3f
    by_t   Vector3f, derivative by t
    by_u   Vector3f, derivative by u
    by_v   Vector3f, derivative by v
    """

    value: mi.Vector3f
    by_t: mi.Vector3f
    by_u: mi.Vector3f
    by_v: mi.Vector3f

    def times(self, f, f_t, f_u, f_v):
        """The residual times a function ``f`` (Float), given with its derivatives by t, u and v."""
        parts = ((self.by_t, f_t), (self.by_u, f_u), (self.by_v, f_v))
        return Residual(self.value * f, *(by * f + self.value * f_x for by, f_x in parts))

    def tangent(self):
        """A vector (Vector3f) along the curve residual = 0 in (t, u, v), of any length and sign.

        The cross product of two rows of the Jacobian, which has rank 2 there; those two that make it largest.
        """
        rows = [type(self.value)(self.by_t[k], self.by_u[k], self.by_v[k]) for k in range(3)]
        best, length2 = None, None
        for i in range(3):
            normal = dr.cross(rows[i], rows[(i + 1) % 3])
            size2 = dr.squared_norm(normal)
            if best is None:
                best, length2 = normal, size2
            else:
                best, length2 = dr.select(size2 > length2, normal, best), dr.maximum(size2, length2)
        return best


@dataclass
class Connection:
    """The path from the light over P to V, body coordinates, lane by lane, in single or double precision.

    P              Point3f, on the triangle
    n              Vector3f, unit interpolated normal
    omega_L        Vector3f, unit direction from P to the light
    d_L            Float, distance of the light (1 if it is distant)
    omega_V        Vector3f, unit direction from P into the body on the line to V
    s              Float, distance of V, negative where it is on the light's side
    q              Vector3f, omega_L + eta omega_V
    q_t, q_u, q_v  Vector3f, derivatives of q by t, u and v
    n_u, n_v       Vector3f, derivatives of n by u and v
    s_t, s_u, s_v  Float, derivatives of s by t, u and v
    """

    P: mi.Point3f
    n: mi.Vector3f
    omega_L: mi.Vector3f
    d_L: mi.Float
    omega_V: mi.Vector3f
    s: mi.Float
    q: mi.Vector3f
    q_t: mi.Vector3f
    q_u: mi.Vector3f
    q_v: mi.Vector3f
    n_u: mi.Vector3f
    n_v: mi.Vector3f
    s_t: mi.Float
    s_u: mi.Float
    s_v: mi.Float

    def cross(self):
        """``Residual`` q x n."""
        return Residual(
            dr.cross(self.q, self.n),
            dr.cross(self.q_t, self.n),
            dr.cross(self.q_u, self.n) + dr.cross(self.q, self.n_u),
            dr.cross(self.q_v, self.n) + dr.cross(self.q, self.n_v),
        )

    def residual(self, straight, length=None):
        """``Residual`` for Newton's method.

        straight  whether eta is 1: it is then q, else q x n
        length    Float; where it is given the residual is multiplied by s / ``length``

        The product is continuous where P passes V, so that V may lie next to the surface.
        """
        c = Residual(self.q, self.q_t, self.q_u, self.q_v) if straight else self.cross()
        if length is None:
            return c
        return c.times(*(x / length for x in (self.s, self.s_t, self.s_u, self.s_v)))

    def distance_correction(self, tri):
        """D (Float): light refracted at P spreads at V as from a source at distance sqrt(D) (Walter et al. 2009).

        Here in one form for interpolated and for facet normals of a triangle ``tri``:

            D = s^2 d_L^2 |J| / (|omega_L . n| |omega_V . Ng| |P_u x P_v|),
            J = n . [(q_u - mu n_u) x (q_v - mu n_v)],   mu = q . n
        """
        mu = dr.dot(self.q, self.n)
        J = dr.dot(self.n, dr.cross(self.q_u - mu * self.n_u, self.q_v - mu * self.n_v))
        area2 = dr.norm(dr.cross(tri.P_u, tri.P_v))
        cosines = dr.abs(dr.dot(self.omega_L, self.n) * dr.dot(self.omega_V, tri.Ng))
        return dr.square(self.s * self.d_L) * dr.abs(J) / (cosines * area2)


def connect(tri, incidence, V, d, u, v):
    """``Connection`` of light, points of triangles and V.

    tri        ``triangle.Triangle``
    incidence  ``optics.Incidence`` of the light
    V          Point3f, body coordinates
    d          Vector3f, unit direction in which V moves with t
    u, v       Float, the points' place in the triangles
    """
    light, eta = incidence.light, incidence.eta
    P = tri.position(u, v)
    n, n_u = tri.normal_derivative(u, v, 1, 0)
    _, n_v = tri.normal_derivative(u, v, 0, 1)
    to_V = V - P
    omega_L, d_L = light.seen_from(P)
    s = dr.norm(to_V) * dr.select(dr.dot(to_V, tri.Ng) > 0, -1, 1)
    omega_V = to_V / s

    def change(move):
        return (move - omega_V * dr.dot(omega_V, move)) / s

    q_u, q_v = (light.direction_change(omega_L, d_L, P_x) - eta * change(P_x) for P_x in (tri.P_u, tri.P_v))
    s_t, s_u, s_v = dr.dot(omega_V, d), -dr.dot(omega_V, tri.P_u), -dr.dot(omega_V, tri.P_v)
    return Connection(P, n, omega_L, d_L, omega_V, s, omega_L + eta * omega_V, eta * change(d), q_u, q_v,
                      n_u, n_v, s_t, s_u, s_v)  # fmt: skip

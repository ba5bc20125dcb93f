"""The constraint that a refracted light path L -> P -> V fulfils, with its derivatives.

With unit directions omega_L from P to the light and omega_V from P to V = o + t d let q = omega_L + eta omega_V.
Light from L is refracted at P to V where q is parallel to the normal n, with both directions on their sides of the
surface. The residual of this, given together with its 3 x 3 Jacobian by (t, u, v), is q x n, for every eta. At eta = 1, where q
itself is 0 and normals play no part, q is another one, better at grazing incidence. The published one, sign(eta - 1) q / |q| + n
(Walter et al. 2009; Holzschuch 2015), loses digits as eta goes to 1, where |q| goes to |eta - 1|.

In all omega_V points into the body on the line through P and V, so that a root may also have V
behind P (s < 0): callers test ``s``.
"""

from dataclasses import dataclass

import drjit as dr


@dataclass
class Residual:
    """A residual (3 numbers) and its derivatives by t, u and v: the columns of its Jacobian."""

    value: object
    by_t: object
    by_u: object
    by_v: object

    def times(self, f, f_t, f_u, f_v):
        """The residual times a function, given with its derivatives."""
        parts = ((self.by_t, f_t), (self.by_u, f_u), (self.by_v, f_v))
        return Residual(self.value * f, *(by * f + self.value * f_x for by, f_x in parts))

    def tangent(self):
        """A vector along the curve residual = 0 in (t, u, v), of any length and sign.

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
    """The path from the light over P to V: unit directions from P, distances (``s`` is negative where V is on the
    light's side), the normal, q, and their derivatives."""

    P: object
    n: object
    omega_L: object
    d_L: object
    omega_V: object
    s: object
    q: object
    q_t: object
    q_u: object
    q_v: object
    n_u: object
    n_v: object
    s_t: object
    s_u: object
    s_v: object

    def cross(self):
        """``Residual`` q x n."""
        return Residual(
            dr.cross(self.q, self.n), dr.cross(self.q_t, self.n),
            dr.cross(self.q_u, self.n) + dr.cross(self.q, self.n_u), dr.cross(self.q_v, self.n) + dr.cross(self.q, self.n_v),
        )  # fmt: skip

    def residual(self, straight, length=None):
        """``Residual`` for Newton's method: q if eta is 1 (``straight``), else q x n.

        Times s / ``length`` where that is given: continuous where P passes V, so that V may lie next to the surface.
        """
        c = Residual(self.q, self.q_t, self.q_u, self.q_v) if straight else self.cross()
        if length is None:
            return c
        return c.times(*(x / length for x in (self.s, self.s_t, self.s_u, self.s_v)))

    def distance_correction(self, tri):
        """D: light that is refracted at P spreads at V as from a source at distance sqrt(D) (Walter et al. 2009;
        here in one form for interpolated and for facet normals):

            D = s^2 d_L^2 |J| / (|omega_L . n| |omega_V . Ng| |P_u x P_v|),
            J = n . [(q_u - mu n_u) x (q_v - mu n_v)],   mu = q . n
        """
        mu = dr.dot(self.q, self.n)
        J = dr.dot(self.n, dr.cross(self.q_u - mu * self.n_u, self.q_v - mu * self.n_v))
        area2 = dr.norm(dr.cross(tri.P_u, tri.P_v))
        cosines = dr.abs(dr.dot(self.omega_L, self.n) * dr.dot(self.omega_V, tri.Ng))
        return dr.square(self.s * self.d_L) * dr.abs(J) / (cosines * area2)


def connect(tri, incidence, V, d, u, v):
    """``Connection`` of the light of an ``optics.Incidence``, the point (u, v) of triangles and ``V``, which moves along ``d``."""
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

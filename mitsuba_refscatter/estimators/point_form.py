"""The point form of single scattering, and its roots: the light paths L -> P -> V for a given V.

Radiance per unit length along the camera ray (Walter et al. 2009, eq. 9 and section 3; Holzschuch 2015, eqs. 2, 9), one
term per root P of the constraint for V = o + t d:

    dL/dt = sigma_s p I (1 - F) eta^2 / D  exp(-sigma_t (t + s))  V(P, L) V(P, V)
"""

import drjit as dr

from .. import optics, tolerances
from ..solve import newton
from ..solve.constraint import connect

NEWTON = newton.Limits(
    tolerances.ROOT_STEP,
    tolerances.ROOT_LONGEST,
    tolerances.ROOT_ITERATIONS,
    tolerances.ROOT_PARALLEL,
    tolerances.ROOT_ROUNDING,
)


def root(taken, light, V, d, start, margin, active=True):
    """Newton's method for P at fixed V, from ``start`` (Vector2f, in the piece's own coordinates: its corners are
    (0, 0), (1, 0), (0, 1)). Roots farther than ``margin`` outside the piece are not taken. Returns the
    ``newton.Solution``; its unknowns are in the piece's coordinates."""
    tri, piece = taken.tri, taken.piece

    def system(a, b):
        c = connect(tri, light, V, d, piece.u0 + piece.h * a, piece.v0 + piece.h * b).cross()
        return c.value, c.by_u * piece.h, c.by_v * piece.h

    def domain(a, b):
        return (a >= -margin) & (b >= -margin) & (a + b <= 1 + margin)

    return newton.solve(system, (start.x, start.y), domain, NEWTON, active)


def refracts(path, tri):
    """Where a path is refracted into the body: light outside and V inside, by both normals."""
    lit = (dr.dot(path.omega_L, path.n) > 0) & (dr.dot(path.omega_L, tri.Ng) > 0)
    return lit & (dr.dot(path.omega_V, path.n) < 0) & (path.s > 0)


def in_scattered(path, tri, d, lighting, sigma_t):
    """The term of one root without sigma_s, I, visibility and attenuation along the camera ray."""
    F, _ = optics.fresnel(dr.dot(path.omega_L, path.n), lighting.eta)
    value = (1 - F) * dr.square(lighting.eta) / path.distance_correction(tri)
    return value * lighting.phase(-dr.dot(path.omega_V, d)) * dr.exp(-sigma_t * path.s)

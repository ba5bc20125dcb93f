"""The point form of single scattering, and its roots: the light paths L -> P -> V for a given V.

Radiance per unit length along the camera ray (Walter et al. 2009; Holzschuch 2015), one term per root P of the constraint
for V = o + t d:

    dL/dt = sigma_s p I (1 - F) eta^2 / D  exp(-sigma_t (t + s))  V(P, L) V(P, V)
"""

from dataclasses import replace

import drjit as dr

from .. import optics, tolerances
from ..culling.beam import fold
from ..solve import newton
from ..solve.constraint import connect

NEWTON = newton.Limits(
    step=tolerances.ROOT_STEP, longest=tolerances.ROOT_LONGEST, iterations=tolerances.ROOT_ITERATIONS,
    parallel=tolerances.ROOT_PARALLEL, rounding=tolerances.ROOT_ROUNDING,
)  # fmt: skip


def _system(tri, piece, illumination, V, d):
    """The constraint at fixed V as a function of the place in a piece, whose corners are (0, 0), (1, 0), (0, 1)."""
    length = fold(dr.maximum, [dr.norm(V - P) for P in piece.P])

    def system(a, b):
        path = connect(tri, illumination, V, d, piece.u0 + piece.h * a, piece.v0 + piece.h * b)
        c = path.residual(illumination.straight, length)
        return c.value, c.by_u * piece.h, c.by_v * piece.h

    return system


def root(taken, illumination, V, d, start, margin, active=True):
    """Newton's method for P at fixed V, from ``start`` (Vector2f, place in the piece).

    Roots farther than ``margin`` outside the piece are not taken. Returns the ``newton.Solution``; its unknowns are
    the place in the piece.
    """

    def domain(a, b):
        return (a >= -margin) & (b >= -margin) & (a + b <= 1 + margin)

    system = _system(taken.tri, taken.piece, illumination, V, d)
    return newton.solve(system, (start.x, start.y), domain, NEWTON, active)


def in_double(taken, illumination, V, d, x):
    """The place ``x`` of a root, improved in double precision: next to a fold it is then known well enough to say in
    which of two neighbouring pieces the root lies."""
    tri, piece = (type(y)(**{k: _double(v) for k, v in vars(y).items()}) for y in (taken.tri, taken.piece))
    light = replace(illumination.light, L=_double(illumination.light.L))
    exact = replace(illumination, light=light, eta=_double(illumination.eta))
    system = _system(tri, piece, exact, _double(V), _double(d))
    return newton.improve(system, tuple(_double(y) for y in x), tolerances.DOUBLE_STEPS, tolerances.ROOT_LONGEST)


def _double(x):
    if isinstance(x, list):
        return [_double(y) for y in x]
    return dr.float64_array_t(type(x))(x)


def refracts(path, tri):
    """Where a path is refracted into the body: light outside and V inside, by both normals."""
    lit = (dr.dot(path.omega_L, path.n) > 0) & (dr.dot(path.omega_L, tri.Ng) > 0)
    return lit & (dr.dot(path.omega_V, path.n) < 0) & (path.s > 0)


def in_scattered(path, tri, d, illumination, sigma_t):
    """The term of one root without sigma_s, I, visibility and attenuation along the camera ray."""
    F, _ = optics.fresnel(dr.dot(path.omega_L, path.n), illumination.eta)
    value = (1 - F) * dr.square(illumination.eta) / path.distance_correction(tri)
    value *= illumination.emitted(path.P, path.omega_L, path.d_L)
    return (
        value
        * illumination.phase(path.omega_V, d)
        * dr.exp(-illumination.extinction(sigma_t, path.omega_V, d) * path.s)
    )

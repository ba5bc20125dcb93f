"""The point form of single scattering, and its roots: the light paths L -> P -> V for a given V.

Radiance per unit length along the camera ray (Walter et al. 2009; Holzschuch 2015), with one term per root P of the
constraint for V = o + t d:

    dL/dt = sigma_s p I (1 - F) eta^2 / D  exp(-sigma_t (t + s))  V(P, L) V(P, V)
"""

from __future__ import annotations

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
"""Of Newton's method, in units of the light beam."""


def _system(pair, V):
    """The constraint at fixed V as a function of the place in a piece, whose corners are (0, 0), (1, 0), (0, 1)."""
    piece, illumination = pair.piece, pair.illumination
    length = fold(dr.maximum, [dr.norm(V - P) for P in piece.P])

    def system(a, b):
        path = connect(pair.tri, illumination, V, pair.segment.d, piece.u0 + piece.h * a, piece.v0 + piece.h * b)
        c = path.residual(illumination.straight, length)
        return c.value, c.by_u * piece.h, c.by_v * piece.h

    return system


def root(pair, V, start, active=True):
    """Newton's method for P at fixed V: the ``newton.Solution``, whose unknowns are the place in the piece.

    pair    ``pair_data.PairData``
    V       Point3f, on the segments, body coordinates
    start   Vector2f, place in the piece where it begins
    active  Bool, which lanes are solved

    Roots farther than ``tolerances.OUTSIDE`` outside the piece are not taken.
    """

    def domain(a, b):
        return (a >= -tolerances.OUTSIDE) & (b >= -tolerances.OUTSIDE) & (a + b <= 1 + tolerances.OUTSIDE)

    return newton.solve(_system(pair, V), (start.x, start.y), domain, NEWTON, active)


def in_double(pair, V, x):
    """The place ``x`` in the piece of a root for V, improved in double precision.

    Next to a fold it is then known well enough to say in which of two neighbouring pieces the root lies.
    """
    tri, piece = (type(y)(**{k: _double(v) for k, v in vars(y).items()}) for y in (pair.tri, pair.piece))
    light = replace(pair.illumination.light, L=_double(pair.illumination.light.L))
    exact = replace(
        pair,
        taken=replace(pair.taken, tri=tri, piece=piece),
        illumination=replace(pair.illumination, light=light, eta=_double(pair.illumination.eta)),
        segment=replace(pair.segment, d=_double(pair.segment.d)),
    )
    system = _system(exact, _double(V))
    return newton.improve(system, tuple(_double(y) for y in x), tolerances.DOUBLE_STEPS, tolerances.ROOT_LONGEST)


def _double(x):
    if isinstance(x, list):
        return [_double(y) for y in x]
    return dr.float64_array_t(type(x))(x)


def refracts(path, tri):
    """Where (Bool) a ``constraint.Connection`` is refracted into the body ``tri`` is of.

    The light is then outside and V inside, by both normals.
    """
    outside = (dr.dot(path.omega_L, path.n) > 0) & (dr.dot(path.omega_L, tri.Ng) > 0)
    return outside & (dr.dot(path.omega_V, path.n) < 0) & (path.s > 0)


def in_scattered(pair, path):
    """The term of one root (Spectrum) without sigma_s, I, visibility and attenuation along the camera ray.

    pair  ``pair_data.PairData``
    path  ``constraint.Connection`` at the root
    """
    illumination, d = pair.illumination, pair.segment.d
    F, _ = optics.fresnel(dr.dot(path.omega_L, path.n), illumination.eta)
    value = (1 - F) * dr.square(illumination.eta) / path.distance_correction(pair.tri)
    value *= illumination.emitted(path.P, path.omega_L, path.d_L)
    attenuation = dr.exp(-illumination.extinction(pair.sigma_t, path.omega_V, d) * path.s)
    return value * illumination.phase(path.omega_V, d) * attenuation

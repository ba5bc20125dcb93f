"""Refraction and reflection at a smooth boundary, and phase functions. Knows no scene and no mesh.

Conventions: unit vectors point away from the surface point; ``eta = n_in / n_out``; the normal ``n``
is a unit vector that points out of the body. All functions take Dr.Jit arrays of any width.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from . import tolerances


@dataclass
class LocalLight:
    """A light in the coordinates of a body, as refraction sees it.

    L        Point3f, body coordinates, one or one per camera segment; or the unit direction (Vector3f) to a distant one
    distant  whether it is infinitely far away. That decides about kernels, so that neither kind pays for the other.
    """

    L: mi.Point3f
    distant: bool = False

    def to(self, P):
        """The vector from P to the light; of length 1 if it is distant."""
        return self.L + 0 * P if self.distant else self.L - P

    def seen_from(self, P):
        """``(omega_L, d_L)``: unit direction from P to the light, and its distance.

        By the distance's square the intensity is divided. It is 1 if the light is distant: irradiance stands for
        intensity.
        """
        if self.distant:
            return self.to(P), 1.0
        to_light = self.L - P
        d_L = dr.norm(to_light)
        return to_light / d_L, d_L

    def direction_change(self, omega_L, d_L, d_P):
        """Derivative of omega_L where P moves by ``d_P``; ``omega_L`` and ``d_L`` as ``seen_from`` gives them."""
        return 0 * d_P if self.distant else (omega_L * dr.dot(omega_L, d_P) - d_P) / d_L


@dataclass
class Incidence:
    """Light that comes to a boundary: all that refraction there depends on, but for the place.

    light  in the boundary's body coordinates
    eta    Float, index of refraction behind the boundary over that before it
    """

    light: LocalLight
    eta: mi.Float


def refract_in(omega_L, n, eta):
    """Refracts light that arrives from outside into the body (Snell).

    omega_L  Vector3f, unit, from the surface to the light
    n        Vector3f, unit normal
    eta      Float, index inside over that outside

    Returns ``(omega, c_L, c_V)``: the unit direction of travel inside, the cosine outside and the cosine inside. Where
    there is no refracted ray (total reflection, eta < 1) ``c_V`` is 0 and ``omega`` its limit at the critical angle.
    For ``c_L < 0`` (away from the light) the formula's smooth continuation is returned. Callers test ``c_L`` and
    ``c_V``.

    >>> omega, c_L, c_V = refract_in(mi.Vector3f(0.6, 0, 0.8), mi.Vector3f(0, 0, 1), mi.Float(1.5))
    >>> print(f"{omega.x[0]:.3f} {omega.z[0]:.3f}, cosines {c_L[0]:.3f} and {c_V[0]:.3f}")  # sines: 0.6 = 1.5 x 0.4
    -0.400 -0.917, cosines 0.800 and 0.917
    """
    c_L = dr.dot(omega_L, n)
    c_V = dr.safe_sqrt(inside_cosine2(c_L, eta))
    omega = dr.fma(n, c_L / eta - c_V, -omega_L / eta)
    return omega, c_L, c_V


def inside_cosine2(c_L, eta):
    """Square of the cosine inside for the cosine outside (Snell); negative under total reflection.

    >>> round(inside_cosine2(0.8, 1.5), 4), inside_cosine2(0.0, 0.5)
    (0.84, -3.0)
    """
    return 1 - (1 - dr.square(c_L)) / dr.square(eta)


def refract_in_derivative(omega_L, n, eta, cosines, d_omega_L, d_n):
    """Derivative of ``refract_in``'s direction.

    omega_L, n, eta  as there
    cosines          (c_L, c_V), which it returns
    d_omega_L, d_n   derivatives of ``omega_L`` and ``n``
    """
    c_L, c_V = cosines
    d_c_L = dr.dot(d_omega_L, n) + dr.dot(omega_L, d_n)
    d_c_V = d_c_L * c_L / (dr.square(eta) * dr.maximum(c_V, tolerances.CRITICAL))
    return -d_omega_L / eta + d_n * (c_L / eta - c_V) + n * (d_c_L / eta - d_c_V)


def transmission(c_L, c_V, eta):
    """``(1 - F) c_L / c_V`` for light going in: flux transmitted, per cosine-weighted area inside.

    c_L, c_V  cosines outside and inside
    eta       index inside over that outside

    Written without the division 0/0 at eta = 1, at grazing incidence and at the critical angle:
    ``2 eta c_L^2 [1/(c_L + eta c_V)^2 + 1/(eta c_L + c_V)^2]``. It is zero for c_L < 0.

    >>> round(transmission(1.0, 1.0, 1.5), 3), transmission(0.3, 0.3, 1.0)  # glass reflects 4 %, eta = 1 nothing
    (0.96, 1.0)
    """
    c = dr.maximum(c_L, 0)
    s_wave = dr.rcp(dr.maximum(c + eta * c_V, tolerances.LEAST_COSINES))
    p_wave = dr.rcp(dr.maximum(eta * c + c_V, tolerances.LEAST_COSINES))
    return 2 * eta * (dr.square(c * s_wave) + dr.square(c * p_wave))


def fresnel(cos_i, eta_ti):
    """Unpolarised Fresnel reflectance and the cosine behind the boundary: ``(F, cos_t)``.

    cos_i   cosine on the incident side, 0 to 1
    eta_ti  index behind the boundary over that before it

    Under total reflection ``F = 1`` and ``cos_t = 0``.

    >>> [round(float(F), 3) for F, _ in (fresnel(1.0, 1.5), fresnel(0.1, 1.5), fresnel(0.1, 1 / 1.5))]
    [0.04, 0.572, 1.0]
    """
    sin2_t = (1 - dr.square(cos_i)) / dr.square(eta_ti)
    cos_t = dr.safe_sqrt(1 - sin2_t)
    r_s = (cos_i - eta_ti * cos_t) / dr.maximum(cos_i + eta_ti * cos_t, tolerances.LEAST_COSINES)
    r_p = (eta_ti * cos_i - cos_t) / dr.maximum(eta_ti * cos_i + cos_t, tolerances.LEAST_COSINES)
    F = 0.5 * (dr.square(r_s) + dr.square(r_p))
    return dr.select(sin2_t >= 1, 1, F), cos_t


def twice(F):
    """Reflectance of a thin sheet, whose two boundaries each reflect F, with all reflections between them.

    >>> round(twice(0.04), 3), twice(1.0)
    (0.077, 1.0)
    """
    return 2 * F / (1 + F)


def reflect(d, n):
    """Direction in which a mirror with unit normal ``n`` sends what travels along ``d``."""
    return d - 2 * dr.dot(d, n) * n


def refract(d, n, cos_t, eta_ti):
    """Unit direction behind the boundary of light or a ray that travels along ``d``.

    d       Vector3f, unit
    n       Vector3f, unit normal on the incident side: dot(d, n) <= 0
    cos_t   Float, cosine behind the boundary, from ``fresnel``
    eta_ti  Float, index behind the boundary over that before it
    """
    cos_i = -dr.dot(d, n)
    return dr.normalize(d / eta_ti + n * (cos_i / eta_ti - cos_t))


def isotropic():
    """Phase function of isotropic scattering, 1/sr."""
    return dr.inv_four_pi


def henyey_greenstein(cosine, g):
    """Phase function of Henyey and Greenstein (1941), 1/sr.

    cosine  between the directions of travel before and after scattering, +1 for forward scattering
    g       mean cosine, -1 to 1

    >>> round(henyey_greenstein(1.0, 0.5) / isotropic(), 3), round(henyey_greenstein(-1.0, 0.5) / isotropic(), 3)
    (6.0, 0.222)
    """
    base = dr.maximum(1 + dr.square(g) - 2 * g * cosine, tolerances.LEAST_LOBE)
    return dr.inv_four_pi * (1 - dr.square(g)) * dr.rsqrt(base) / base

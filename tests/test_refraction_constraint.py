"""The constraint of a refracted path: derivatives by finite differences, roots by Snell's law, the distance correction
by closed forms and by the area that a bundle of light rays lights."""

import mitsuba as mi
import numpy as np
import oracle
import pytest
from meshes import Patch, dot, norm, unit

from mitsuba_refscatter.geometry.triangle import Triangle
from mitsuba_refscatter.optics import Incidence, LocalLight
from mitsuba_refscatter.solve.constraint import connect

N = 400


def random_patches(rng, n, smooth, bend=0.3):
    """Triangles of about unit size, facing up within 60 degrees; normals that differ from the facet's if ``smooth``."""
    p, e1 = rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    e2 = np.cross(unit(rng.normal(size=(n, 3))), e1) + 0.3 * rng.normal(size=(n, 3))
    cross = np.cross(e1, e2)
    ng = unit(cross)
    normals = [unit(ng + bend * rng.normal(size=(n, 3))) if smooth else ng for _ in range(3)]
    return Patch(p, e1, e2, normals[0], normals[1] - normals[0], normals[2] - normals[0], ng, norm(cross))


def double(x):
    return mi.Vector3d(np.ascontiguousarray(x.T))


def triangle(patch):
    return Triangle(*(double(x) for x in (patch.p, patch.e1, patch.e2, patch.n, patch.m1, patch.m2, patch.ng)))


def numbers(x):
    return np.array(x).T


def connection(patch, light, eta, V, d, uv):
    u, v = (mi.Float64(np.ascontiguousarray(x)) for x in uv.T)
    return connect(triangle(patch), Incidence(LocalLight(double(light)), eta), double(V), double(d), u, v)


def half_vector(c, eta):
    """The published residual, f = sign(eta - 1) q / |q| + n (Walter et al. 2009; Holzschuch 2015), of a
    ``Connection``."""
    q = numbers(c.q)
    return (1 if eta > 1 else -1) * q / norm(q) + numbers(c.n)


@pytest.fixture
def rng(rgb):
    return np.random.default_rng(11)


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("form", ["cross", "straight"])
@pytest.mark.parametrize("eta", [0.7, 1.0, 1.5, 2.4])
def test_jacobian(rng, form, smooth, eta):
    """All nine entries against central differences of the residual in float64; V on both sides of the surface."""
    patch = random_patches(rng, N, smooth)
    light, V = patch.p + 3 * patch.ng + rng.normal(size=(N, 3)), patch.p - 2 * patch.ng + rng.normal(size=(N, 3))
    V[::5] = patch.p[::5] + 2 * patch.ng[::5]
    d, uv, h = unit(rng.normal(size=(N, 3))), rng.uniform(0, 0.5, (N, 2)), 1e-5

    def residual(t, uv):
        return connection(patch, light, eta, V + t * d, d, uv).residual(form == "straight")

    exact = residual(0, uv)
    steps = {"by_t": (h, [0, 0]), "by_u": (0, [h, 0]), "by_v": (0, [0, h])}
    for name, (dt, duv) in steps.items():
        difference = numbers(residual(dt, uv + duv).value) - numbers(residual(-dt, uv - duv).value)
        np.testing.assert_allclose(numbers(getattr(exact, name)), difference / (2 * h), rtol=1e-5, atol=1e-7)


def refracted_paths(rng, eta, smooth=True):
    """Paths that Snell's law makes: patch, light, V, (u, v), the oracle's light ray, s; some on the other side (s <
    0)."""
    patch = random_patches(rng, 4 * N, smooth)
    light = patch.p + 3 * patch.ng + rng.normal(size=(4 * N, 3))
    uv = rng.uniform(0, 0.5, (4 * N, 2))
    x = oracle.light_ray(patch, uv, light, eta)
    s = rng.uniform(0.2, 3, (4 * N, 1))
    good = ((x.c_l > 0.1) & (x.radicand > 0.01) & (dot(x.omega, patch.ng) < -0.05))[:, 0]
    keep = np.flatnonzero(good)[:N]
    return Patch(*(y[keep] for y in patch)), light[keep], (x.point + s * x.omega)[keep], uv[keep], keep, s[keep], eta


@pytest.mark.parametrize("eta", [0.7, 0.999, 1.0, 1.001, 1.5, 2.4])
def test_refracted_paths_are_roots(rng, eta):
    """Both residuals vanish on the oracle's refracted paths; f does not for those that are reflected."""
    patch, light, V, uv, keep, s, _ = refracted_paths(rng, eta)
    assert len(keep) > N / 4
    c = connection(patch, light, eta, V, 0 * V + [1, 0, 0], uv)
    assert norm(numbers(c.cross().value)).max() < 1e-9
    np.testing.assert_allclose(np.array(c.s), s[:, 0], rtol=1e-12)
    if eta != 1:
        assert norm(half_vector(c, eta)).max() < 1e-7


@pytest.mark.parametrize("eta", [0.7, 1.5, 2.4])
def test_reflected_paths_are_no_roots(rng, eta):
    """V where the surface mirrors the light to: what is left of q x n is (1 + eta) times the sine of incidence."""
    patch, light, _, uv, _, s, _ = refracted_paths(rng, eta)
    x = oracle.light_ray(patch, uv, light, eta)
    V = x.point + s * (2 * x.c_l * x.n - x.w_l)
    above = (dot(V - x.point, patch.ng) > 0)[:, 0]
    c = connection(patch, light, eta, V, 0 * V + [1, 0, 0], uv)
    sine = np.sqrt(1 - x.c_l**2)
    np.testing.assert_allclose(norm(numbers(c.cross().value))[above], (1 + eta) * sine[above], rtol=1e-6)
    f = norm(half_vector(c, eta))
    assert above.sum() > N / 4 and (f > 0.3 * sine)[above].all()


def test_tangent_follows_the_curve(rng):
    """A step along the tangent leaves the residual unchanged to second order."""
    patch, light, V, uv, *_ = refracted_paths(rng, 1.5)
    d, h = unit(rng.normal(size=V.shape)), 1e-5
    tangent = numbers(connection(patch, light, 1.5, V, d, uv).cross().tangent())
    tangent /= norm(tangent)
    moved = connection(patch, light, 1.5, V + h * tangent[:, :1] * d, d, uv + h * tangent[:, 1:]).cross()
    scale = sum(norm(numbers(x)) for x in (moved.by_t, moved.by_u, moved.by_v))
    assert (norm(numbers(moved.value)) / scale).max() < 1e-3 * h


def correction(patch, light, eta, V, uv):
    c = connection(patch, light, eta, V, 0 * V + [1, 0, 0], uv)
    return np.array(c.distance_correction(triangle(patch)))


@pytest.mark.parametrize("eta", [0.7, 1.0, 1.5, 2.4])
def test_distance_correction_of_facets(rng, eta):
    """The closed form for a plane."""
    patch, light, V, uv, *_ = refracted_paths(rng, eta, smooth=False)
    x = oracle.light_ray(patch, uv, light, eta)
    s = norm(V - x.point)
    plane = (s + eta * x.d_l) * (x.c_l / x.c_v * s + x.c_v / x.c_l * eta * x.d_l)
    np.testing.assert_allclose(correction(patch, light, eta, V, uv), plane[:, 0], rtol=1e-6)


@pytest.mark.parametrize("eta", [0.7, 1.5, 2.4])
def test_distance_correction_is_the_spread_of_light(rng, eta):
    """D from the area across the refracted light that a small bundle of rays lights (the curve form's measure)."""
    patch, light, V, uv, _, s, _ = refracted_paths(rng, eta)
    x = oracle.light_ray(patch, uv, light, eta)
    w_u, w_v = oracle.light_slopes(patch, x, eta)
    lit = np.abs(dot(np.cross(patch.e1 + s * w_u, patch.e2 + s * w_v), x.omega)) / patch.area2
    spread = eta**2 * x.d_l**2 * lit / (x.c_l / x.c_v * np.abs(dot(x.omega, patch.ng)))
    np.testing.assert_allclose(correction(patch, light, eta, V, uv), spread[:, 0], rtol=1e-5, atol=1e-9)


def test_distance_correction_of_a_sphere(rng):
    """Focal lengths of the unit sphere: D = eta^2 d_L^2 (cos_V / cos_L) |1 - s / t'| |1 - s / s'|."""
    eta, P = 1.5, unit(rng.normal(size=(N, 3)))
    # A triangle whose interpolated normal at its first corner is the sphere's to first order.
    e1 = unit(np.cross(P, rng.normal(size=(N, 3))))
    e2 = np.cross(P, e1)
    patch = Patch(P, e1, e2, P, e1, e2, P, norm(np.cross(e1, e2)))
    light = P * rng.uniform(1.2, 3, (N, 1)) + 0.5 * (e1 * rng.normal(size=(N, 1)) + e2 * rng.normal(size=(N, 1)))
    x = oracle.light_ray(patch, np.zeros((N, 2)), light, eta)
    s = rng.uniform(0.1, 1.5, (N, 1))
    K = eta * x.c_v - x.c_l
    tangential, sagittal = (K - x.c_l**2 / x.d_l) / (eta * x.c_v**2), (K - 1 / x.d_l) / eta
    D = eta**2 * x.d_l**2 * (x.c_v / x.c_l) * np.abs(1 - s * tangential) * np.abs(1 - s * sagittal)
    ours = correction(patch, light, eta, x.point + s * x.omega, np.zeros((N, 2)))
    np.testing.assert_allclose(ours, D[:, 0], rtol=1e-6, atol=1e-9)

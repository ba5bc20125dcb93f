"""Star-shaped bodies, as deformed geodesic spheres with exact normals.

Every generator returns ``(vertices, faces, normals)``: float64 (n, 3), int (m, 3)
wound counter-clockwise seen from outside, and the unit outward normals of the
smooth surface that the mesh samples. The number of triangles is the one of the
form 20 f² that is nearest to what was asked for.
"""

from __future__ import annotations

import numpy as np

from ..geometry.geodesic import geodesic_sphere, nearest_frequency

Mesh = tuple[np.ndarray, np.ndarray, np.ndarray]

# Bumps of the bumpy sphere: sum of AMPLITUDE/√WAVES · sin(k·direction + phase).
BUMP_WAVES = 24
BUMP_AMPLITUDE = 0.04  # in radii, root of the summed squared wave heights
BUMP_WAVELENGTHS = (0.4, 0.6)  # in radii
BUMP_SEED = 3

# Rounded cube: |x|_p = CUBE_SIZE − GROOVE_DEPTH · Σ_i exp(−(x_i/GROOVE_WIDTH)²).
CUBE_POWER = 8
CUBE_SIZE = 0.82
GROOVE_DEPTH = 0.09
GROOVE_WIDTH = 0.14


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def sphere(triangles: int) -> Mesh:
    """Sphere of radius 1."""
    d, faces = geodesic_sphere(nearest_frequency(triangles))
    return d, faces, d.copy()


def _bump_waves() -> tuple[np.ndarray, np.ndarray, float]:
    """Wave vectors (n, 3), phases (n) and the common height, the same on every machine."""
    rng = np.random.RandomState(BUMP_SEED)
    k = _unit(rng.normal(size=(BUMP_WAVES, 3)))
    k *= 2 * np.pi / rng.uniform(*BUMP_WAVELENGTHS, size=(BUMP_WAVES, 1))
    phase = rng.uniform(0, 2 * np.pi, size=BUMP_WAVES)
    return k, phase, BUMP_AMPLITUDE / BUMP_WAVES**0.5


def bumpy_sphere(triangles: int) -> Mesh:
    """Sphere of radius 1 with smooth bumps and dents: r(d) = 1 + Σ a sin(k·d + φ).

    The normal is that of the smooth surface, r d − ∇r with ∇r along the sphere.
    """
    d, faces = geodesic_sphere(nearest_frequency(triangles))
    k, phase, height = _bump_waves()
    angle = d @ k.T + phase
    r = 1.0 + height * np.sin(angle).sum(axis=1, keepdims=True)
    slope = height * np.cos(angle) @ k
    slope -= d * (d * slope).sum(axis=1, keepdims=True)
    return r * d, faces, _unit(r * d - slope)


def _cube_residual(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Implicit function of the rounded cube (negative inside) and its gradient."""
    norm = (x**CUBE_POWER).sum(axis=1, keepdims=True) ** (1.0 / CUBE_POWER)
    dent = GROOVE_DEPTH * np.exp(-((x / GROOVE_WIDTH) ** 2))
    value = norm - CUBE_SIZE + dent.sum(axis=1, keepdims=True)
    gradient = (x / norm) ** (CUBE_POWER - 1) - 2.0 * x / GROOVE_WIDTH**2 * dent
    return value, gradient


def rounded_cube(triangles: int) -> Mesh:
    """Cube of edge 1.64 with round edges and a groove along each of its mid-planes.

    Newton's method along each direction: the implicit function rises
    monotonically outwards, because the groove term falls by at most
    2·GROOVE_DEPTH/e per axis against a norm of about CUBE_SIZE.
    """
    d, faces = geodesic_sphere(nearest_frequency(triangles))
    r = CUBE_SIZE / (d**CUBE_POWER).sum(axis=1, keepdims=True) ** (1.0 / CUBE_POWER)
    for _ in range(30):
        value, gradient = _cube_residual(r * d)
        r = r - value / (gradient * d).sum(axis=1, keepdims=True)
    x = r * d
    return x, faces, _unit(_cube_residual(x)[1])

"""Star-shaped bodies, as deformed geodesic spheres with exact normals.

Every generator returns ``(vertices, faces, normals)``. Vertices are float64 (V, 3). Faces are int (F, 3), wound
counter-clockwise seen from outside. Normals (V, 3) are the unit outward ones of the smooth surface that the mesh
samples. The number of triangles is the one of the form 20 f² that is nearest to what was asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.geodesic import geodesic_sphere, nearest_frequency

Mesh = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Bumps:
    """Waves on a sphere: the sum of amplitude/√waves · sin(k·direction + phase). Lengths are in radii.

    waves        their number
    amplitude    root of the summed squared wave heights
    wavelengths  the shortest and the longest
    seed         of directions, lengths and phases
    """

    waves: int
    amplitude: float
    wavelengths: tuple[float, float]
    seed: int


BUMPY_SPHERE = Bumps(waves=24, amplitude=0.04, wavelengths=(0.4, 0.6), seed=3)
AMBER = Bumps(waves=10, amplitude=0.07, wavelengths=(1.3, 2.6), seed=11)
AMBER_AXES = (1.25, 0.95, 0.85)  # of the ellipsoid that the waved sphere is stretched to

# Rounded cube: |x|_p = CUBE_SIZE − GROOVE_DEPTH · Σ_i exp(−(x_i/GROOVE_WIDTH)²).
CUBE_POWER = 8
CUBE_SIZE = 0.82
GROOVE_DEPTH = 0.09
GROOVE_WIDTH = 0.14


def _unit(v: np.ndarray) -> np.ndarray:
    """Vectors (n, 3), normalized."""
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def sphere(triangles: int) -> Mesh:
    """Sphere of radius 1."""
    d, faces = geodesic_sphere(nearest_frequency(triangles))
    return d, faces, d.copy()


def _waved_sphere(bumps: Bumps, triangles: int) -> Mesh:
    """Sphere of radius 1 with smooth bumps and dents: r(d) = 1 + Σ a sin(k·d + φ).

    The normal is that of the smooth surface, r d − ∇r with ∇r along the sphere.
    """
    rng = np.random.RandomState(bumps.seed)  # the same numbers on every machine
    k = _unit(rng.normal(size=(bumps.waves, 3)))
    k *= 2 * np.pi / rng.uniform(*bumps.wavelengths, size=(bumps.waves, 1))
    phase, height = rng.uniform(0, 2 * np.pi, size=bumps.waves), bumps.amplitude / bumps.waves**0.5
    d, faces = geodesic_sphere(nearest_frequency(triangles))
    angle = d @ k.T + phase
    r = 1.0 + height * np.sin(angle).sum(axis=1, keepdims=True)
    slope = height * np.cos(angle) @ k
    slope -= d * (d * slope).sum(axis=1, keepdims=True)
    return r * d, faces, _unit(r * d - slope)


def bumpy_sphere(triangles: int) -> Mesh:
    """Sphere of radius 1 with short bumps."""
    return _waved_sphere(BUMPY_SPHERE, triangles)


def amber(triangles: int) -> Mesh:
    """A polished pebble: a sphere with long, shallow bumps, stretched."""
    vertices, faces, normals = _waved_sphere(AMBER, triangles)
    return vertices * AMBER_AXES, faces, _unit(normals / AMBER_AXES)


def _cube_residual(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Implicit function of the rounded cube (negative inside) and its gradient."""
    norm = (x**CUBE_POWER).sum(axis=1, keepdims=True) ** (1.0 / CUBE_POWER)
    dent = GROOVE_DEPTH * np.exp(-((x / GROOVE_WIDTH) ** 2))
    value = norm - CUBE_SIZE + dent.sum(axis=1, keepdims=True)
    gradient = (x / norm) ** (CUBE_POWER - 1) - 2.0 * x / GROOVE_WIDTH**2 * dent
    return value, gradient


def rounded_cube(triangles: int) -> Mesh:
    """Cube of edge 1.64 with round edges and a groove along each of its mid-planes.

    It is found by Newton's method along each direction. The implicit function rises monotonically outwards, because the
    groove term falls by at most 2·GROOVE_DEPTH/e per axis, against a norm of about CUBE_SIZE.
    """
    d, faces = geodesic_sphere(nearest_frequency(triangles))
    r = CUBE_SIZE / (d**CUBE_POWER).sum(axis=1, keepdims=True) ** (1.0 / CUBE_POWER)
    for _ in range(30):
        value, gradient = _cube_residual(r * d)
        r = r - value / (gradient * d).sum(axis=1, keepdims=True)
    x = r * d
    return x, faces, _unit(_cube_residual(x)[1])

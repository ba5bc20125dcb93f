"""A branching body: a coral of round cones, smoothly joined and meshed."""

from __future__ import annotations

import numpy as np

from .bodies import Mesh
from .surface_nets import project, subdivide, surface_net

BLEND = 0.04  # width of the smooth union, in scene units
MIN_TRIANGLES = 4000  # below, the grid no longer resolves the thinnest arms
_BASE_TRIANGLES = 60000  # above, a coarser net is subdivided: grids grow with the cube


def _fork(arm: np.ndarray, count: int, length: float, tilt: float, azimuth: float) -> list[np.ndarray]:
    """Grow thinner arms from the end of an arm, as rows like those of ``_arms``.

    arm      row
    count    of the new ones
    length   of each
    tilt     away from the arm's axis, radians
    azimuth  of the first around the axis, radians
    """
    start, radius = arm[3:6], arm[7]
    axis = start - arm[0:3]
    axis = axis / np.linalg.norm(axis)
    side = np.cross(axis, [0.31, 0.05, 0.95])
    side /= np.linalg.norm(side)
    up = np.cross(side, axis)
    arms = []
    for i in range(count):
        angle = azimuth + 2.0 * np.pi * i / count
        out = np.cos(tilt) * axis + np.sin(tilt) * (np.cos(angle) * side + np.sin(angle) * up)
        out[1] += 0.35  # arms seek the light
        end = start + length * out / np.linalg.norm(out)
        arms.append(np.concatenate([start, end, [0.95 * radius, 0.76 * radius]]))
    return arms


def _arms() -> np.ndarray:
    """Arms as rows (start, end, radius at start, radius at end), (22, 8): 1 trunk, then 3, 6 and 12.

    The angles keep arms that do not share a fork apart. Where two sheets come closer than the grid of the surface
    net, the mesh is not a manifold.
    """
    generation = [np.array([0.0, -0.8, 0.0, 0.0, -0.3, 0.0, 0.24, 0.192])]
    arms, azimuth = generation[:], 1.78
    for count, length, tilt in ((3, 0.52, 1.28), (2, 0.465, 0.91), (2, 0.39, 0.87)):
        generation = [
            child
            for i, parent in enumerate(generation)
            for child in _fork(parent, count, length, tilt, azimuth + 0.76 * i)
        ]
        arms += generation
        azimuth += 0.95
    return np.array(arms)


def _round_cone(x: np.ndarray, arm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance and its gradient for the hull of two spheres.

    The distance is the least over h of |x − c(h)| − r(h), with c and r linear in h. By the envelope theorem its
    gradient is the unit vector from c(h) to x.
    """
    start, axis, r0, r1 = arm[0:3], arm[3:6] - arm[0:3], arm[6], arm[7]
    length = np.linalg.norm(axis)
    slope = (r0 - r1) / length
    along = (x - start) @ axis / length
    radial = np.sqrt(np.maximum(((x - start) ** 2).sum(axis=1) - along**2, 0.0))
    h = np.clip((along - radial * slope / (1.0 - slope**2) ** 0.5) / length, 0.0, 1.0)
    away = x - start - h[:, None] * axis
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-12)  # on the axis: any direction
    return distance - (r0 + h * (r1 - r0)), away / distance[:, None]


def _field(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smooth union −k log Σ exp(−d_i/k) of all arms, and its gradient."""
    parts = [_round_cone(x, arm) for arm in _arms()]
    d = np.stack([p[0] for p in parts])
    nearest = d.min(axis=0)
    weight = np.exp((nearest - d) / BLEND)
    total = weight.sum(axis=0)
    gradient = sum(w[:, None] * p[1] for w, p in zip(weight, parts)) / total[:, None]
    return nearest - BLEND * np.log(total), gradient


def _net(triangles: int) -> tuple[np.ndarray, np.ndarray]:
    """Surface net with nearly ``triangles`` triangles: their number grows as 1/h²."""
    arms = _arms()
    margin = arms[:, 6:].max() + 0.1
    ends = np.concatenate([arms[:, 0:3], arms[:, 3:6]])
    low, high = ends.min(axis=0) - margin, ends.max(axis=0) + margin
    h, net = 0.05, None
    for _ in range(4):
        net = surface_net(_field, low, high, h)
        if abs(len(net[1]) - triangles) <= 0.005 * triangles:
            break
        h *= (len(net[1]) / triangles) ** 0.5
    assert net is not None
    return net


def branches(triangles: int) -> Mesh:
    """Coral of a trunk and three generations of arms, about 2 units high: ``(vertices, faces, normals)``.

    The number of triangles is within about 1 % of what was asked for, which must be at least ``MIN_TRIANGLES``.
    """
    if triangles < MIN_TRIANGLES:
        raise ValueError(f"branches needs at least {MIN_TRIANGLES} triangles, not {triangles}")
    levels = 0
    while triangles / 4**levels > _BASE_TRIANGLES:
        levels += 1
    x, faces = _net(round(triangles / 4**levels))
    for _ in range(levels):
        x, faces = subdivide(_field, x, faces)
    x = project(_field, x)
    gradient = _field(x)[1]
    return x, faces, gradient / np.linalg.norm(gradient, axis=1, keepdims=True)

"""Meshes and rays at the extremes."""

import build
import numpy as np
from meshes import Mesh, bumpy_sphere, dot, icosphere, unit


def bumps(level):
    return bumpy_sphere(level, 0.06, 6.0)


def edges(mesh):
    """The middles of the first two edges of each triangle."""
    corners = mesh.vertices[mesh.faces]
    return np.concatenate([(corners[:, 0] + corners[:, 1]) / 2, (corners[:, 1] + corners[:, 2]) / 2])


def grazing(origin, angle):
    """Rays that pass the edge of the unit sphere, ``angle`` radians inside its silhouette."""
    origin = np.array(origin, float)
    far = np.linalg.norm(origin)
    axis = -origin / far
    side = np.cross(axis, [1.0, 0, 0])
    side /= np.linalg.norm(side)
    up = np.cross(axis, side)
    theta, phi = np.arcsin(1 / far) - angle, np.linspace(0, 2 * np.pi, 40, endpoint=False)[:, None]
    d = np.cos(theta) * axis + np.sin(theta) * (np.cos(phi) * side + np.sin(phi) * up)
    return build.rays_towards(origin, origin + far * d)


def needles(width):
    """A ball of which each triangle has a needle cut off: a vertex ``width`` of an edge from another one."""
    mesh = icosphere(2)
    vertices, normals, faces = list(mesh.vertices), list(mesh.normals), []
    middle = {}
    for a, b, c in mesh.faces:
        cut = []
        for i, j in ((a, b), (b, c), (c, a)):
            key = (min(i, j), max(i, j))
            if key not in middle:
                middle[key] = len(vertices)
                low, high = key
                x = (1 - width) * mesh.vertices[low] + width * mesh.vertices[high]
                vertices.append(x)
                n = (1 - width) * mesh.normals[low] + width * mesh.normals[high]
                normals.append(n / np.linalg.norm(n))
            cut.append(middle[key])
        ab, bc, ca = cut
        faces += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return Mesh(np.array(vertices), np.array(faces), np.array(normals))


def tetrahedron(size):
    """A body whose top is one triangle of ``size`` in the plane z = 0, and as deep."""
    top = size * np.array([[0.3, 1.2, 0], [0.3 - np.sqrt(0.75), -0.3, 0], [0.3 + np.sqrt(0.75), -0.3, 0]])
    return Mesh(np.concatenate([top, [[0, 0, -size]]]), np.array([[0, 1, 2], [1, 0, 3], [2, 1, 3], [0, 2, 3]]), None)


def with_degenerate(mesh):
    """The mesh and, in some of its edges, triangles without area, some of them twice."""
    corners = mesh.faces[::7]
    flat = np.stack([corners[:, 0], corners[:, 1], corners[:, 0]], axis=1)
    points = np.stack([corners[:, 2]] * 3, axis=1)
    return Mesh(mesh.vertices, np.concatenate([mesh.faces, flat, points, points]), mesh.normals)


def tilted(mesh, degrees):
    """A ball with vertex normals turned about the y axis, by up to ``degrees``, alternating."""
    angle = np.radians(degrees) * np.sin(7 * mesh.vertices[:, 0]) * np.cos(5 * mesh.vertices[:, 2])
    n = mesh.normals
    x = np.cos(angle) * n[:, 0] + np.sin(angle) * n[:, 2]
    z = -np.sin(angle) * n[:, 0] + np.cos(angle) * n[:, 2]
    return Mesh(mesh.vertices, mesh.faces, np.stack([x, n[:, 1], z], axis=1))


def cylinder(sides):
    """A closed cylinder about y with smooth sides: two corners of each side triangle share their normal."""
    phi = np.arange(sides) * 2 * np.pi / sides
    ring = np.stack([np.cos(phi), np.zeros(sides), np.sin(phi)], axis=1)
    up = np.array([0, 1.0, 0])
    vertices, normals, faces = [], [], []
    i, j = np.arange(sides), np.roll(np.arange(sides), -1)
    vertices += [ring - 0.7 * up, ring + 0.7 * up]
    normals += [ring, ring]
    faces += [np.stack([i, i + sides, j], 1), np.stack([j, i + sides, j + sides], 1)]
    for sign in (-1, 1):
        first = sum(len(x) for x in vertices)
        vertices += [ring + 0.7 * sign * up, 0.7 * sign * up[None]]
        normals += [np.tile(sign * up, (sides + 1, 1))]
        rim = np.stack([first + i, first + j, np.full(sides, first + sides)], 1)
        faces.append(rim if sign < 0 else rim[:, ::-1])
    return Mesh(np.concatenate(vertices), np.concatenate(faces), np.concatenate(normals))


AXES, FOCUS = np.array([np.sqrt(5) / 3, np.sqrt(5) / 3, 1]), np.array([0, 0, -2 / 3])
"""Of an ellipsoid about z with eccentricity 2/3: with eta 1.5 it brings light along z to one point."""


def lens(level):
    ball = icosphere(level)
    return Mesh(ball.vertices * AXES, ball.faces, unit(ball.vertices / AXES))


def rays_at_focus(n, radius):
    """Rays from outside that inside the lens pass its focus by up to ``radius`` or a little more."""
    rng = np.random.default_rng(6)
    side = rng.normal(size=(n, 3))
    side[:, 2] = -np.abs(side[:, 2]) * 0.3
    P = AXES * unit(side)
    out = unit(P - FOCUS - radius * rng.uniform(-1, 1, (n, 3)))
    normal = unit(P / AXES**2)
    across = 1.5 * (out - dot(out, normal) * normal)
    sine2 = dot(across, across)
    keep = sine2[:, 0] < 0.9
    outside = across + np.sqrt(np.maximum(1 - sine2, 0)) * normal
    return build.rays_towards((P + 4 * outside)[keep], P[keep])

"""What the oracle stands on: mesh records, ray tracer, (u,v) grids, one interface, generators.

World space, one length unit.  Directions are unit vectors.  Imports nothing but NumPy.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass

import numpy as np

END_TOLERANCE = 1e-9  # of the scene's extent: a hit closer to either end of a ray is that end
LEAF = 4  # triangles in a leaf of the box tree, at least (at most twice as many)
RAY_BATCH = 1 << 16  # rays traced together (memory)


def dot(a, b):
    """Inner product over the last axis, which is kept: (...,3), (...,3) -> (...,1)."""
    return np.einsum("...i,...i->...", a, b)[..., None]


def norm(a):
    """Length over the last axis, which is kept: (...,3) -> (...,1)."""
    return np.sqrt(dot(a, a))


def unit(a):
    """Of length 1 over the last axis: (...,3) -> (...,3)."""
    return a / norm(a)


@dataclass(frozen=True)
class Mesh:
    """Closed triangle mesh in world space with outward winding.

    vertices (V,3); faces (F,3) int; normals (V,3) outward, any length, or None: facet normals.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None

    @property
    def corners(self):
        """Corner positions, (F,3,3): triangle, corner, xyz."""
        return np.asarray(self.vertices, float)[self.faces]

    @property
    def facet_normals(self):
        """Unit geometric normals Ng, (F,3)."""
        p = self.corners
        cross = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        return cross / norm(cross)

    def corner_normals(self, eta):
        """Shading normals at the corners, (F,3,3): Ng if there are none, or if eta = 1."""
        if self.normals is None or eta == 1:
            return np.repeat(self.facet_normals[:, None], 3, axis=1)
        return np.asarray(self.normals, float)[self.faces]


# Triangles (...,3): P = p + u e1 + v e2, normal n + u m1 + v m2 (any length), Ng, |P_u x P_v|.
Patch = namedtuple("Patch", "p e1 e2 n m1 m2 ng area2")


def make_patches(mesh, eta):
    """All triangles of a mesh as a Patch of (F,3) arrays; area2 is (F,1)."""
    p, n = mesh.corners, mesh.corner_normals(eta)
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    return Patch(
        p[:, 0], e1, e2, n[:, 0], n[:, 1] - n[:, 0], n[:, 2] - n[:, 0], mesh.facet_normals, norm(np.cross(e1, e2))
    )


def take(patches, index):
    """The patches with the numbers `index`, an array of any shape."""
    return Patch(*(x[index] for x in patches))


class BoxTree:
    """Median-split box tree over the triangles of `meshes`, numbered through (`first` per mesh).

    Traversed breadth first with arrays of (ray, node) pairs; tests every leaf that a ray meets.
    A ray exactly through a shared edge may count two crossings or none.
    """

    def __init__(self, meshes):
        p = np.concatenate([m.corners for m in meshes])
        self.first = np.cumsum([0] + [len(m.faces) for m in meshes])
        self.p, self.e1, self.e2 = p[:, 0], p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
        self.tolerance = END_TOLERANCE * np.ptp(p.reshape(-1, 3), axis=0).max()
        lo, hi = p.min(1), p.max(1)
        n, order, self.levels = len(p), np.arange(len(p)), []
        depth = max(0, int(np.log2(n / LEAF)))
        for level in range(depth + 1):  # node i of a level holds order[starts[i]:starts[i + 1]]
            starts = n * np.arange(2**level + 1) // 2**level
            box_lo = np.minimum.reduceat(lo[order], starts[:-1])
            box_hi = np.maximum.reduceat(hi[order], starts[:-1])
            self.levels.append((box_lo - self.tolerance, box_hi + self.tolerance))
            if level < depth:  # sort every node along its longest axis
                node = np.repeat(np.arange(2**level), np.diff(starts))
                axis = np.argmax(box_hi - box_lo, axis=1)[node]
                order = order[np.lexsort(((lo + hi)[order, axis], node))]
        self.starts, self.order = starts, order

    def _leaves(self, o, d, length):
        """Pairs (ray, leaf) whose boxes the rays may touch."""
        inverse = 1 / np.where(np.abs(d) < 1e-200, 1e-200, d)
        ray, node = np.arange(len(o)), np.zeros(len(o), int)
        for level, (lo, hi) in enumerate(self.levels):
            if level:
                ray, node = np.repeat(ray, 2), (2 * node[:, None] + [0, 1]).ravel()
            near, far = np.zeros(len(ray)), length[ray]
            for k in range(3):
                start, inv = o[ray, k], inverse[ray, k]
                a, b = (lo[node, k] - start) * inv, (hi[node, k] - start) * inv
                near, far = np.maximum(near, np.minimum(a, b)), np.minimum(far, np.maximum(a, b))
            ray, node = ray[near <= far], node[near <= far]
        return ray, node

    def hits(self, o, d, length, skip):
        """All crossings of the rays o + t d (n,3) with tolerance < t < length - tolerance.

        length (n,), may be inf; skip (n,): a triangle that the ray ignores, or -1.
        Returns ray (m,), triangle (m,), and t, u, v (m,3): distance and barycentric coordinates.
        """
        found = [(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3)))]
        for first in range(0, len(o), RAY_BATCH):
            part = slice(first, first + RAY_BATCH)
            rays, leaf = self._leaves(o[part], d[part], length[part])
            for k in range(2 * LEAF):  # Moeller-Trumbore, the k-th triangle of every leaf
                inside = self.starts[leaf] + k < self.starts[leaf + 1]
                ray = rays[inside] + first
                tri = self.order[self.starts[leaf[inside]] + k]
                e1, e2, start, along = self.e1[tri], self.e2[tri], o[ray] - self.p[tri], d[ray]
                h, q = np.cross(along, e2), np.cross(start, e1)
                with np.errstate(divide="ignore", invalid="ignore"):
                    tuv = np.hstack([dot(e2, q), dot(start, h), dot(along, q)]) / dot(e1, h)
                t, u, v = np.where(np.isfinite(tuv), tuv, -1).T  # -1: parallel to the plane
                good = (u >= 0) & (v >= 0) & (u + v <= 1) & (tri != skip[ray])
                good &= (t > self.tolerance) & (t < length[ray] - self.tolerance)
                found.append((ray[good], tri[good], tuv[good]))
        return tuple(np.concatenate(x) for x in zip(*found))

    def closest(self, o, d, skip):
        """First hits: the m rays that hit, triangle (m,), and t, u, v (m,1) each."""
        ray, tri, tuv = self.hits(o, d, np.full(len(o), np.inf), skip)
        order = np.lexsort((tuv[:, 0], ray))
        index, first = np.unique(ray[order], return_index=True)
        return index, tri[order][first], *tuv[order][first].T[..., None]

    def clear(self, start, end, skip):
        """Whether nothing lies between start (n,3) and end (n,3), triangle skip (n,) left out."""
        length = norm(end - start)
        free = np.ones(len(start), bool)
        direction = (end - start) / np.where(length > 0, length, 1)
        free[self.hits(start, direction, length[:, 0], skip)[0]] = False
        return free


def panels(breaks, order):
    """Gauss-Legendre nodes and weights, (panels * order,), on consecutive panels."""
    x, w = np.polynomial.legendre.leggauss(order)
    half = np.diff(breaks)[:, None] / 2
    return (breaks[:-1, None] + half * (x + 1)).ravel(), (half * w).ravel()


def bisect(same, lo, hi, rounds):
    """Where same(x) (n,) turns from true, at lo (n,), to false, at hi (n,)."""
    for _ in range(rounds):
        middle = (lo + hi) / 2
        before = same(middle)
        lo, hi = np.where(before, middle, lo), np.where(before, hi, middle)
    return lo


def switches(state, x):
    """Where state(x), (k,n), changes between neighbours of the ascending x (n,), bisected."""
    kind = state(x)
    change = np.flatnonzero((kind[:, 1:] != kind[:, :-1]).any(0))
    return bisect(lambda y: (state(y) == kind[:, change]).all(0), x[change], x[change + 1], 50)


def triangle_grid(m):
    """A triangle's (u,v) domain cut m x m: vertices ((m + 1)(m + 2)/2, 2), faces (m^2,3)."""
    keys = [(i, j) for i in range(m + 1) for j in range(m + 1 - i)]
    k = {key: n for n, key in enumerate(keys)}
    faces = [(k[i, j], k[i + 1, j], k[i, j + 1]) for i, j in keys if i + j < m]
    faces += [(k[i + 1, j], k[i + 1, j + 1], k[i, j + 1]) for i, j in keys if i + j < m - 1]
    return np.array(keys) / m, np.array(faces)


def quarter(uv):
    """Triangles uv (n,3,2) cut in four at the middles of their edges, (4n,3,2), same winding."""
    a, b, c = uv.transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def within(uv, point):
    """Whether point (n,2) lies in the counterclockwise triangle uv (n,3,2), edges included."""
    edge, away = uv[:, [1, 2, 0]] - uv, point[:, None] - uv
    area = edge[..., 0] * away[..., 1] - edge[..., 1] * away[..., 0]
    return area.min(1) >= -1e-9 * area.sum(1)


def may_vanish(uv, g, g_u, g_v):
    """Whether a smooth g may vanish on triangles, from g and its derivatives at their corners.

    uv (3,...,2); the others are three arrays (...).  True if the corners differ in sign, or if the
    tangent planes at two of them change sign towards another corner: a curve that enters and
    leaves by one edge, or a loop inside."""
    positive, bent = [x > 0 for x in g], 0
    for k in range(3):
        sides = [uv[k - j] - uv[k] for j in (1, 2)]
        other = [(g[k] + g_u[k] * x[..., 0] + g_v[k] * x[..., 1] > 0) != positive[k] for x in sides]
        bent = bent + (other[0] | other[1]).astype(np.int8)
    return (positive[0] != positive[1]) | (positive[0] != positive[2]) | (bent >= 2)


def fresnel_reflectance(c, c_t, eta):
    """Unpolarised reflectance for the cosines of incidence and transmission, eta = n_t / n_i."""
    r_s, r_p = (c - eta * c_t) / (c + eta * c_t), (eta * c - c_t) / (eta * c + c_t)
    return (r_s**2 + r_p**2) / 2


def interface(d, n, eta):
    """Smooth dielectric for d, n (m,3): F (m,1), reflected, refracted direction, scale (m,1).

    d.n < 0 enters.  scale is 1/eta^2 on entering, eta^2 on leaving.  Total reflection: F = 1."""
    c = -dot(d, n)
    ratio, n, c = np.where(c > 0, eta, 1 / eta), np.where(c > 0, n, -n), np.abs(c)
    radicand = 1 - (1 - c * c) / ratio**2
    c_t = np.sqrt(np.maximum(radicand, 0))
    fresnel = np.where(radicand > 0, fresnel_reflectance(c, c_t, ratio), 1)
    return fresnel, d + 2 * c * n, d / ratio + n * (c / ratio - c_t), ratio**-2


def icosphere(level, radius=1.0):
    """Sphere about the origin with its own normals and 20 * 4^level triangles (vertices on it)."""
    golden = (1 + 5**0.5) / 2
    points = [np.roll((0, a, b * golden), k) for k in range(3) for a in (-1, 1) for b in (-1, 1)]
    points = np.array(points, float) / np.hypot(1, golden)
    edge = 2 / np.hypot(1, golden)
    near = np.abs(np.linalg.norm(points[:, None] - points, axis=2) - edge) < 1e-9
    faces = np.array(
        [(i, j, k) for i in range(12) for j in range(i) for k in range(j) if near[i, j] and near[j, k] and near[i, k]]
    )
    inward = np.linalg.det(points[faces]) < 0
    faces[inward] = faces[inward][:, ::-1]
    for _ in range(level):
        pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        edges, index = np.unique(pairs, axis=0, return_inverse=True)
        middle = points[edges].sum(1)
        a, b, c = faces.T
        ab, bc, ca = index.reshape(-1, 3).T + len(points)
        points = np.concatenate([points, middle / norm(middle)])
        faces = np.concatenate([np.stack(x, 1) for x in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return Mesh(radius * points, faces, points.copy())


def bumpy_sphere(level, amplitude=0.05, frequency=5.0):
    """r = 1 + amplitude sin(f x) sin(f y) sin(f z) on the unit sphere, with its exact normals."""
    sphere = icosphere(level)
    x = sphere.vertices
    sine, cosine = np.sin(frequency * x), np.cos(frequency * x)
    r = 1 + amplitude * sine.prod(1, keepdims=True)
    gradient = np.stack([cosine[:, k] * sine[:, k - 1] * sine[:, k - 2] for k in range(3)], 1)
    gradient = amplitude * frequency * gradient
    normals = x - (gradient - x * dot(gradient, x)) / r
    return Mesh(r * x, sphere.faces, normals / norm(normals))


def box(lower, upper):
    """Axis-aligned box from corner lower (3,) to corner upper (3,), 12 triangles, facet normals."""
    corner = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Mesh(np.asarray(lower) + corner * np.subtract(upper, lower), faces)

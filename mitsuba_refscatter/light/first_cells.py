"""First cells of light beams: a boundary's own triangles, or those of a coarse mesh over it."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..geometry import triangle


@dataclass
class Points:
    """Places on a boundary, lane by lane, body coordinates.

    P      Vector3f
    n      Vector3f, unit normal
    Ng     Vector3f, unit, of the facet
    area   Float, of the surface per area in (u, v)
    start  Vector3f, where rays start instead of at P
    found  Bool, whether there is such a place
    """

    P: mi.Vector3f
    n: mi.Vector3f
    Ng: mi.Vector3f
    area: mi.Float
    start: mi.Vector3f
    found: mi.Bool


def faces_light(tri, light, side=1):
    """False only if no point of the triangle is lit: the facet faces away, or n . (L - P) < 0 throughout; of its back
    for the ``side`` -1.

    The latter is a polynomial in (u, v), of which the largest Bernstein coefficient is a bound. These are means of the
    values for pairs of corners.
    """
    a, n = [light.to(p) for p in tri.corners()], [side * x for x in tri.corner_normals()]
    top = dr.dot(n[0], a[0])
    for i in range(len(a)):
        for j in range(i, len(a)):
            top = dr.maximum(top, 0.5 * (dr.dot(n[i], a[j]) + dr.dot(n[j], a[i])))
    return (top > 0) & (side * dr.dot(tri.Ng, a[0]) > 0)


class Facets:
    """A boundary's own triangles as first cells.

    records    packed triangles
    triangles  UInt32, which of them
    light      ``optics.LocalLight``: of triangles that face away from it there are no cells
    side       1 for light from outside of the boundary, -1 from inside
    """

    def __init__(self, records, triangles, light, side=1):
        self.records, self.side = records, dr.opaque(mi.Float, side)
        facing = faces_light(triangle.gather(records, triangles), light, self.side)
        self.triangles = arrays.gather(triangles, dr.compress(facing))

    def __len__(self):
        return dr.width(self.triangles)

    def points(self, cell, u, v, middle):
        """``Points`` at (u, v) of cells (UInt32); ``middle``: (u, v) of a point further inside."""
        tri = triangle.gather(self.records, dr.gather(mi.UInt32, self.triangles, cell))
        P, inside = tri.position(u, v), tri.position(*middle)
        area = dr.norm(dr.cross(tri.P_u, tri.P_v))
        n, Ng = self.side * tri.normal(u, v), self.side * tri.Ng
        return Points(P, n, Ng, area, P + tolerances.INWARDS * (inside - P), mi.Bool(True))

    def edges(self):
        """Longest edges (Float) and centres (Vector3f) of the cells."""
        return _edges(triangle.gather(self.records, self.triangles))


class Sheets:
    """A coarse mesh over a boundary as first cells: its points are moved along its normals onto the boundary.

    scene  ``scene.Scene``
    body   the boundary
    mesh   ``coarse_mesh.Mesh``
    """

    def __init__(self, scene, body, mesh):
        self.scene, self.body = scene, body
        corners = mesh.vertices[mesh.faces] - np.array(body.centre)
        normals = mesh.normals[mesh.faces]
        self.count = len(corners)
        edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        turn = np.linalg.norm(normals - normals.mean(axis=1, keepdims=True), axis=2).max(axis=1)
        self.reach = arrays.array(mi.Float, tolerances.BULGE * edge * turn + tolerances.SLIP * edge)
        self.records = arrays.array(mi.Float, triangle.pack(corners, normals, 0 * normals[:, 0]))

    def __len__(self):
        return self.count

    def points(self, cell, u, v, _middle):
        """``Points`` at (u, v) of cells (UInt32)."""
        sheet, reach = triangle.gather(self.records, cell), dr.gather(mi.Float, self.reach, cell)
        X, a = sheet.position(u, v), sheet.normal_before(u, v)
        hit, found = self._meet(X, dr.normalize(a), reach)
        tri = triangle.gather(self.scene.records, dr.select(found, self._first() + hit.prim_index, 0), found)
        P, n, Ng = tri.position(*hit.prim_uv), tri.normal(*hit.prim_uv), tri.Ng
        side = dr.sign(dr.dot(Ng, a))
        n, Ng = side * n, side * Ng
        h = dr.dot(P - X, a) / dr.squared_norm(a)
        across = dr.cross(sheet.P_u + h * sheet.n_u, sheet.P_v + h * sheet.n_v)
        area = dr.abs(dr.dot(across, a)) / dr.maximum(dr.abs(dr.dot(a, Ng)), 1e-30)
        flat = dr.normalize(a)
        return Points(
            dr.select(found, P, X), dr.select(found, n, flat), dr.select(found, Ng, flat), dr.select(found, area, 0),
            dr.select(found, P, X), found,
        )  # fmt: skip

    def _first(self):
        return dr.opaque(mi.UInt32, self.scene.bodies[self.body.index].first_record)

    def _meet(self, X, a, reach):
        """Where the boundary is met from X + reach a on along -a, and whether it is; once more slightly aside where
        it isn't."""
        scene, centre = self.scene, dr.opaque(mi.Point3f, self.body.centre)
        frame = mi.Frame3f(a)

        def cast(start, active):
            ray = mi.Ray3f(mi.Point3f(start + reach * a) + centre, -a)
            ray.maxt = 2 * reach
            hit = scene.mi_scene.ray_intersect_preliminary(ray, active=active)
            return hit, hit.is_valid() & (scene.find(hit.shape) == self.body.index) & active

        hit, found = cast(X, mi.Bool(True))
        again, there = cast(X + tolerances.SLIP * reach * (frame.s + 0.618 * frame.t), ~found)
        return dr.select(found, hit, again), found | there

    def edges(self):
        """As ``Facets.edges``."""
        return _edges(triangle.gather(self.records, dr.arange(mi.UInt32, self.count)))


def _edges(tri):
    """Longest edges (Float) and centres (Vector3f) of triangles."""
    a, b, c = tri.corners()
    return dr.maximum(dr.maximum(dr.norm(a - b), dr.norm(b - c)), dr.norm(c - a)), (a + b + c) / 3

"""Visibility along the light path L -> P -> V: any surface in between is a shadow.

Shadow rays against the scene, and what makes most of them unnecessary: triangles proven to be lit
entirely, and lengths to which beams are proven to be free.
"""

import drjit as dr
import mitsuba as mi
import numpy as np

from . import lanes, tolerances
from .geometry import silhouette, triangle


class Shadows:
    """The shadow tests of one light in one body.

    ``lit(P, Ng, L, active)``: nothing between the light point L and P (body coordinates); ``inside(P, Ng, direction,
    length, active)``: nothing between P and the point at ``length``. A test is None where nothing can be in
    the way: a convex body does not shadow itself. ``position``: of the light, world; ``L``: the same in body coordinates,
    for ``seen`` alone.
    """

    def __init__(self, scene, body, position, L):
        self.scene, self.body, self.position, self.L = scene, body, position, L
        self.centre = dr.opaque(mi.Point3f, body.centre)
        self.offset = dr.opaque(mi.Float, tolerances.SHADOW_OFFSET * body.extent)
        others = scene.others + [other.shape for other in scene.bodies if other is not body]
        guests = any(_boxes_meet(body.shape.bbox(), shape.bbox()) for shape in others)
        self.lit = None if body.convex and not others else self._lit
        self.inside = None if body.convex and not guests else self._inside
        self.may_prove_inside = self.inside is not None and not guests

    def _lit(self, P, Ng, L, active):
        start = P + self.offset * Ng
        to_light = L - start
        distance = dr.norm(to_light)
        return self._free(start, to_light / distance, distance, active)

    def _inside(self, P, Ng, direction, length, active):
        return self._free(P - self.offset * Ng, direction, length, active)

    def _free(self, start, direction, length, active):
        ray = mi.Ray3f(start + self.centre, direction)
        ray.maxt = length * (1 - tolerances.SHADOW_END)
        return ~self.scene.mi_scene.ray_test(ray, active)

    def seen(self, triangles):
        """Of the triangles (UInt32, scene's numbering): which to keep (indices), and which of these are
        proven to be lit everywhere. The others that are proven to be dark everywhere are left out."""
        if self.lit is None:
            return dr.arange(mi.UInt32, dr.width(triangles)), dr.full(mi.Bool, True, dr.width(triangles))
        corners = self.body.corners[triangles.numpy().astype(np.int64) - self.body.first_record]
        edges = [silhouette.silhouette_edges(b.corners, b.normals, b.twin, self.position) for b in self.scene.bodies]
        uniform = self._uniform(corners, np.concatenate(edges), triangles)
        for shape in self.scene.others:
            uniform &= self._beside(corners, shape.bbox())
        tri = triangle.gather(self.scene.records, triangles)
        visible = self.lit(tri.position(1 / 3, 1 / 3), tri.Ng, self.L, True)
        uniform = lanes.array(mi.Bool, uniform)
        kept = dr.compress(visible | ~uniform)
        return kept, dr.gather(mi.Bool, uniform, kept)

    def _uniform(self, corners, edges, triangles):
        """Which triangles no silhouette edge is in front of."""
        uniform = silhouette.uniform(corners, edges, self.position)
        rest = np.flatnonzero(~uniform)
        if len(rest) > 0 and len(edges) > 0:
            tri = triangle.gather(
                self.scene.records, dr.gather(mi.UInt32, triangles, lanes.array(mi.UInt32, rest.astype(np.uint32)))
            )
            relative = [p - self.L for p in tri.corners()]
            skin = tolerances.SHADOW_OFFSET * self.body.extent
            uniform[rest] = ~silhouette.covered(relative, tri.Ng, edges - self.position, skin).numpy()
        return uniform

    def _beside(self, corners, box):
        """Triangles whose box with the light does not meet ``box``: nothing in it can shadow them."""
        low = np.minimum(corners.min(axis=1), self.position)
        high = np.maximum(corners.max(axis=1), self.position)
        return (high < np.array(box.min)).any(axis=1) | (low > np.array(box.max)).any(axis=1)


def _boxes_meet(a, b):
    return all(a.min[k] <= b.max[k] and b.min[k] <= a.max[k] for k in range(3))

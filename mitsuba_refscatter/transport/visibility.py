"""Visibility along the light path L -> P -> V: any surface in between is a shadow.

Shadow rays against the scene, and what makes most of them unnecessary: triangles proven to be lit
entirely, and lengths to which beams are proven to be free.
"""

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..geometry import silhouette, triangle
from ..scene.boundaries import box_of, boxes_meet

SAMPLES = ((0.1, 0.1), (0.8, 0.1), (0.1, 0.8), (1 / 3, 1 / 3))
"""(u, v) of points of a triangle that are asked whether they are lit."""


class Shadows:
    """The shadow tests of one light in one body, whose triangles are among ``records``.

    ``lit(P, Ng, L, active)``: nothing between the light and P (body coordinates); ``inside(P, Ng, direction,
    length, active)``: nothing between P and the point at ``length``. A test is None where nothing can be in the
    way: a convex body does not shadow itself; ``inner_objects``: whether other shapes may be inside. ``incidence``:
    ``optics.Incidence`` of the light, one, for ``seen`` alone; ``emitter``: a shape that the light's points lie
    on, where it is convex: it is not in the way of what it sends. Light that comes to the body through media is
    followed by ``Transmittance`` instead; ``sampled``: whether what is lit may be judged by samples; ``emission``: what
    the light sends to P (P, omega_L, d_L), or None where it is the same everywhere.
    """

    def __init__(self, scene, body, records, incidence, *, emitter=None, sampled=False, emission=None):
        self.scene, self.body, self.records = scene, body, records
        self.incidence, self.light = incidence, incidence.light
        self.sampled, self.emission = sampled, emission
        self.centre = dr.opaque(mi.Point3f, body.centre)
        self.offset = dr.opaque(mi.Float, tolerances.SHADOW_OFFSET * body.extent)
        other_bodies = [other.shape for other in scene.bodies if other.shape is not body.shape]
        self.others = [shape for shape in scene.others if shape is not emitter]
        self.inner_objects = any(meets(body, shape) for shape in scene.others + other_bodies)
        straight = scene.through_media(body)
        self.lit = None if straight or (body.convex and not self.others and not other_bodies) else self._lit
        self.inside = None if body.convex and not self.inner_objects else self._inside
        self.may_prove_inside = self.inside is not None and not self.inner_objects and body.closed

    def _lit(self, P, Ng, L, active):
        start = P + self.offset * Ng
        if self.light.distant:
            return ~self.scene.mi_scene.ray_test(mi.Ray3f(start + self.centre, mi.Vector3f(L)), active)
        to_light = L - start
        distance = dr.norm(to_light)
        return self._free(start, to_light / distance, distance, active)

    def _inside(self, P, Ng, direction, length, active):
        return self._free(P - self.offset * Ng, direction, length, active)

    def _free(self, start, direction, length, active):
        ray = mi.Ray3f(start + self.centre, direction)
        ray.maxt = length * (1 - tolerances.SHADOW_END)
        return ~self.scene.mi_scene.ray_test(ray, active)

    def reach(self, P, Ng, direction, most):
        """How far light that comes in at P gets: to the first surface, or as far as ``most``, if that is not None."""
        ray = mi.Ray3f(P - self.offset * Ng + self.centre, direction)
        most = None if most is None else dr.opaque(mi.Float, most)
        if most is not None:
            ray.maxt = most
        hit = self.scene.mi_scene.ray_intersect_preliminary(ray)
        # In a closed body the only ones that meet nothing slip through an edge where they come in.
        return dr.select(hit.is_valid(), hit.t, 0 if most is None else most)

    def stop(self, P, Ng, direction, most):
        """How far light that comes in at P gets, at most ``most`` (Float), and the number of what stops it (UInt32):
        0 where nothing does."""
        ray = mi.Ray3f(P - self.offset * Ng + self.centre, direction)
        ray.maxt = most
        hit = self.scene.mi_scene.ray_intersect_preliminary(ray)
        found = hit.is_valid()
        stop = dr.select(found, dr.reinterpret_array(mi.UInt32, hit.shape) + 1, 0)
        # In a closed body the only ones that meet nothing slip through an edge where they come in.
        before = -self.offset * dr.dot(direction, Ng)
        return dr.select(found, hit.t + before, 0 if self.body.closed else most), stop

    def seen(self, triangles):
        """Of the triangles (UInt32, scene's numbering): which to keep (indices), and which of these are
        proven to be lit everywhere. The others that are proven to be dark everywhere are left out."""
        if self.lit is None:
            return dr.arange(mi.UInt32, dr.width(triangles)), dr.full(mi.Bool, True, dr.width(triangles))
        if self.sampled:
            return self._seen_at_samples(triangles)
        corners = self.body.corners[triangles.numpy().astype(np.int64) - self.body.first_record]
        light, distant = self._light_in_world(), self.light.distant
        edges = [
            silhouette.silhouette_edges(b.corners, b.normals, b.twin, light, distant)
            for b in (
                self.body,
                *(b for b in self.scene.bodies if b.shape is not self.body.shape),
            )
        ]
        uniform = self._uniform(corners, np.concatenate(edges), triangles, light)
        for shape in self.others:
            uniform &= _beside(corners, box_of(shape), light, distant)
        tri = triangle.gather(self.records, triangles)
        visible = self.lit(tri.position(1 / 3, 1 / 3), tri.Ng, self.light.L, True)
        uniform = arrays.array(mi.Bool, uniform)
        kept = dr.compress(visible | ~uniform)
        return kept, dr.gather(mi.Bool, uniform, kept)

    def _seen_at_samples(self, triangles):
        """``seen``, judged by some points of each triangle where it is the body alone that may be in the way."""
        n, several = dr.width(triangles), len(SAMPLES)
        i = dr.arange(mi.UInt32, several * n)
        tri = triangle.gather(self.records, dr.gather(mi.UInt32, triangles, i // several))
        u, v = (dr.gather(mi.Float, arrays.array(mi.Float, x), i % several) for x in zip(*SAMPLES))
        count = dr.block_sum(
            dr.select(self._lit(tri.position(u, v), tri.Ng, self.light.L, True), mi.UInt32(1), 0), several
        )
        all_of_it, some = count == several, count > 0
        others = self.others + [b.shape for b in self.scene.bodies if b.shape is not self.body.shape]
        if others:
            corners = self.body.corners[triangles.numpy().astype(np.int64) - self.body.first_record]
            alone = [_beside(corners, box_of(shape), self._light_in_world(), self.light.distant) for shape in others]
            alone = arrays.array(mi.Bool, np.all(alone, axis=0))
            some, all_of_it = some | ~alone, all_of_it & alone
        kept = dr.compress(some)
        return kept, arrays.gather(all_of_it, kept)

    def _light_in_world(self):
        L = self.light.L.numpy().ravel().astype(np.float64)
        return L if self.light.distant else L + np.array(self.body.centre)

    def _uniform(self, corners, edges, triangles, light):
        """Which triangles no silhouette edge is in front of."""
        distant = self.light.distant
        uniform = silhouette.uniform(corners, edges, light, distant)
        rest = np.flatnonzero(~uniform)
        if len(rest) > 0 and len(edges) > 0:
            tri = triangle.gather(self.records, dr.gather(mi.UInt32, triangles, arrays.array(mi.UInt32, rest)))
            relative = [p if distant else p - self.light.L for p in tri.corners()]
            skin = tolerances.SHADOW_OFFSET * self.body.extent
            edges = edges - (np.array(self.body.centre) if distant else light)
            direction = mi.Vector3f(self.light.L) if distant else None
            uniform[rest] = ~silhouette.covered(relative, tri.Ng, edges, skin, direction).numpy()
        return uniform


def _beside(corners, box, light, distant):
    """Triangles whose box with the light does not meet ``box``: nothing in it can shadow them."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    if distant:
        low, high = np.where(light < 0, -np.inf, low), np.where(light > 0, np.inf, high)
    else:
        low, high = np.minimum(low, light), np.maximum(high, light)
    return (high < box[0]).any(axis=1) | (low > box[1]).any(axis=1)


def meets(body, shape):
    """Whether the boxes of a body and of another shape have points in common."""
    return boxes_meet(body.box, box_of(shape))

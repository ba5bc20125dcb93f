"""How far a light beam is certainly free inside its body, so that no shadow ray is needed up to there.

Light that entered a closed body can only be stopped by a triangle that it would leave through, that is one
with omega . Ng > 0; the triangles around the point of entry are not of that kind. A tree over the body's
triangles with bounding spheres and boxes of normals gives, per beam, the smallest distance at which it
can touch such a triangle.
"""

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..geometry import bvh
from ..geometry.surface import Surface
from . import beam

NODE = 12
"""Numbers per node: centre and radius of a sphere, middle and half width of the normals' box, 2 pad."""


def estimate(tri, piece, shadows):
    """How far beams get, as the numbers of ``pairs.Reach``, judged by four of their rays: linear between those at the corners, give or
    take several times what the one in the middle differs from that. ``shadows``: ``visibility.Shadows`` of their light."""
    ends = []
    for u, v in (*beam.CORNERS, (1 / 3, 1 / 3)):
        P, omega, _ = beam.refracted(tri, piece.u0 + piece.h * u, piece.v0 + piece.h * v, shadows.incidence)
        ends.append(shadows.reach(P, tri.Ng, omega, None))
    mean = (ends[0] + ends[1] + ends[2]) / 3
    slack = tolerances.SAMPLED * dr.abs(ends[3] - mean) + tolerances.SAMPLED_LEAST * mean
    return [*ends[:3], slack, slack]


class Clearance:
    """How far light is free inside a body, independent of the light. ``corners``: float64 (F, 3, 3), body coordinates."""

    def __init__(self, records, first_record, corners):
        self.surface = Surface(records, first_record, corners, lambda tri: [tri.Ng], _pack, NODE)

    def clear(self, tri, piece):
        """Length to which beams (``beam.Piece``) are certainly free, as the numbers of ``pairs.Reach``."""
        sag = piece.twist if tri.curved else mi.Float(0)  # at least how far light comes in from the plane triangle
        P, omega, bend = piece.P, piece.omega, piece.bend
        axis_P, axis = (P[0] + P[1] + P[2]) / 3, dr.normalize(omega[0] + omega[1] + omega[2])
        start = dr.maximum(dr.norm(P[0] - axis_P), dr.maximum(dr.norm(P[1] - axis_P), dr.norm(P[2] - axis_P))) + sag
        spread = (
            dr.maximum(dr.norm(omega[0] - axis), dr.maximum(dr.norm(omega[1] - axis), dr.norm(omega[2] - axis))) + bend
        )
        wide = spread > tolerances.BROAD

        def visit(x, leaf, at_leaf, active, best):
            near, touched = _first_touch(mi.Vector3f(x[0:3]) - axis_P, x[3], axis, start, spread)
            out = dr.dot(axis, mi.Vector3f(x[4:7])) + dr.dot(dr.abs(axis), mi.Vector3f(x[7:10])) + spread > 0
            enter = active & touched & out & (near < best)
            here = enter & at_leaf
            for j in range(bvh.LEAF):
                best = dr.minimum(best, self._touch(leaf, j, here, P, omega, bend, axis_P, axis, start, spread, sag))
            return enter, best

        width = dr.width(P[0].x)
        best = bvh.walk(self.surface.tree, width, visit, dr.full(mi.Float, tolerances.ENDLESS, width))
        best = dr.select(wide, 0, best)
        return [best, best, best, mi.Float(0), mi.Float(tolerances.ENDLESS)]

    def _touch(self, leaf, j, active, P, omega, bend, axis_P, axis, start, spread, sag):
        """Smallest distance at which the beams can leave through the j-th triangle of a leaf, or ``tolerances.ENDLESS``."""
        _, tri = self.surface.member(leaf, j, active)
        middle, radius = tri.ball()
        near, touched = _first_touch(middle - axis_P, radius, axis, start, spread)
        # Where the linear beam meets the plane: a ratio of linear functions, smallest at a corner.
        cosines = [dr.dot(w, tri.Ng) for w in omega]
        steepest, flattest = (
            dr.maximum(dr.maximum(*cosines[:2]), cosines[2]),
            dr.minimum(dr.minimum(*cosines[:2]), cosines[2]),
        )
        plane = mi.Float(tolerances.ENDLESS)
        for p, c in zip(P, cosines):
            plane = dr.minimum(plane, dr.dot(tri.P0 - p, tri.Ng) / dr.maximum(c, tolerances.LEAVING))
        least = dr.maximum(flattest, tolerances.LEAVING)
        plane -= sag / least
        plane *= tolerances.TRUSTED - dr.minimum(bend / least, tolerances.TRUSTED)
        near = dr.select(flattest > 2 * bend + tolerances.STEEP, dr.maximum(near, plane), near)
        return dr.select(active & touched & (steepest + bend > 0), near, tolerances.ENDLESS)


def _first_touch(to_centre, radius, axis, start, spread):
    """Where a cone around a ray (radius start + spread s) can first touch a sphere, and whether it does."""
    along = dr.dot(to_centre, axis)
    last = (along + radius + start) / dr.maximum(1 - spread, 1 - tolerances.BROAD)
    reach = radius + start + spread * dr.maximum(last, 0)
    across2 = dr.squared_norm(to_centre) - dr.square(along)
    room = dr.square(reach) - across2
    return dr.maximum(along - dr.safe_sqrt(room), 0), (room >= 0) & (last >= 0)


def _pack(bounds):
    low, high, n_low, n_high = bounds
    c, n, h = 0.5 * (low + high), 0.5 * (n_low + n_high), 0.5 * (n_high - n_low)
    return [c.x, c.y, c.z, 0.5 * dr.norm(high - low), n.x, n.y, n.z, h.x, h.y, h.z, mi.Float(0), mi.Float(0)]

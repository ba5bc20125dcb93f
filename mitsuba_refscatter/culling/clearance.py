"""How far a light beam is certainly free inside its body, so that no shadow ray is needed up to there.

Light that entered a closed body can only be stopped by a triangle that it would leave through: one with omega . Ng > 0.
The triangles around the point of entry are not of that kind. The smallest distance at which a beam can touch such a
triangle follows from a tree over the body's triangles. Its nodes are bounding spheres and boxes of normals.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..geometry import bvh
from ..geometry.surface_tree import SurfaceTree
from . import beam

NODE = 12
"""Numbers per node: centre and radius of a sphere, middle and half width of the normals' box, 2 pad."""


def estimate(tri, piece, shadows):
    """How far beams get, as the numbers of ``pairs.Reach``, judged by four of their rays.

    tri      ``triangle.Triangle``
    piece    ``beam.Piece``
    shadows  ``visibility.Shadows`` of the light

    The length is linear between the rays at the corners, give or take several times what the ray in the middle differs.
    """
    ends = []
    for u, v in (*beam.CORNERS, (1 / 3, 1 / 3)):
        P, omega, _ = beam.refracted(tri, piece.u0 + piece.h * u, piece.v0 + piece.h * v, shadows.incidence)
        ends.append(shadows.reach(P, tri.Ng, omega, None))
    mean = (ends[0] + ends[1] + ends[2]) / 3
    slack = tolerances.SAMPLED * dr.abs(ends[3] - mean) + tolerances.SAMPLED_LEAST * mean
    return [*ends[:3], slack, slack]


@dataclass
class _Cone:
    """A cone around all rays of light beams, with the radius start + spread s at the distance s along the axis.

    piece   the light beams, one per lane
    apex    Vector3f, where the axis starts, body coordinates
    axis    Vector3f, unit
    start   Float, radius around the apex
    spread  Float, growth of the radius per length
    """

    piece: beam.Piece
    apex: mi.Vector3f
    axis: mi.Vector3f
    start: mi.Float
    spread: mi.Float

    @classmethod
    def around(cls, piece):
        """That around beams."""
        P, omega = piece.P, piece.omega
        apex, axis = (P[0] + P[1] + P[2]) / 3, dr.normalize(omega[0] + omega[1] + omega[2])
        start = dr.maximum(dr.norm(P[0] - apex), dr.maximum(dr.norm(P[1] - apex), dr.norm(P[2] - apex)))
        spread = dr.maximum(dr.norm(omega[0] - axis), dr.maximum(dr.norm(omega[1] - axis), dr.norm(omega[2] - axis)))
        return cls(piece, apex, axis, start, spread + piece.bend)

    def first_touch(self, centre, radius):
        """Where it can first touch a sphere (Float, along the axis), and whether it does (Bool)."""
        to_centre = centre - self.apex
        along = dr.dot(to_centre, self.axis)
        last = (along + radius + self.start) / dr.maximum(1 - self.spread, 1 - tolerances.BROAD)
        widest = radius + self.start + self.spread * dr.maximum(last, 0)
        across2 = dr.squared_norm(to_centre) - dr.square(along)
        room = dr.square(widest) - across2
        return dr.maximum(along - dr.safe_sqrt(room), 0), (room >= 0) & (last >= 0)


class Clearance:
    """How far light is free inside a body, independent of the light.

    records       the packed triangles of the body, and maybe others
    first_record  int, index of the body's first triangle
    corners       float64 (F, 3, 3), body coordinates
    """

    def __init__(self, records, first_record, corners):
        self.surface = SurfaceTree(records, first_record, corners, lambda tri: [tri.Ng], _pack, NODE)

    def clear(self, piece):
        """Length to which beams (``beam.Piece``) are certainly free, as the numbers of ``pairs.Reach``."""
        cone = _Cone.around(piece)
        axis, spread = cone.axis, cone.spread

        def visit(x, leaf, at_leaf, active, best):
            near, touched = cone.first_touch(mi.Vector3f(x[0:3]), x[3])
            out = dr.dot(axis, mi.Vector3f(x[4:7])) + dr.dot(dr.abs(axis), mi.Vector3f(x[7:10])) + spread > 0
            enter = active & touched & out & (near < best)
            here = enter & at_leaf
            for j in range(bvh.LEAF):
                best = dr.minimum(best, self._touch(leaf, j, here, cone))
            return enter, best

        width = dr.width(piece.P[0].x)
        best = bvh.walk(self.surface.tree, width, visit, dr.full(mi.Float, tolerances.ENDLESS, width))
        best = dr.select(spread > tolerances.BROAD, 0, best)
        return [best, best, best, mi.Float(0), mi.Float(tolerances.ENDLESS)]

    def _touch(self, leaf, j, active, cone):
        """Smallest distance at which the beams can leave through the j-th triangle of a leaf, or ``ENDLESS``."""
        _, tri = self.surface.member(leaf, j, active)
        near, touched = cone.first_touch(*tri.ball())
        P, bend = cone.piece.P, cone.piece.bend
        # Where the linear beam meets the plane: a ratio of linear functions, smallest at a corner.
        cosines = [dr.dot(w, tri.Ng) for w in cone.piece.omega]
        steepest, flattest = (
            dr.maximum(dr.maximum(*cosines[:2]), cosines[2]),
            dr.minimum(dr.minimum(*cosines[:2]), cosines[2]),
        )
        plane = mi.Float(tolerances.ENDLESS)
        for p, c in zip(P, cosines):
            plane = dr.minimum(plane, dr.dot(tri.P0 - p, tri.Ng) / dr.maximum(c, tolerances.LEAVING))
        least = dr.maximum(flattest, tolerances.LEAVING)
        plane *= tolerances.TRUSTED - dr.minimum(bend / least, tolerances.TRUSTED)
        near = dr.select(flattest > 2 * bend + tolerances.STEEP, dr.maximum(near, plane), near)
        return dr.select(active & touched & (steepest + bend > 0), near, tolerances.ENDLESS)


def _pack(bounds):
    low, high, n_low, n_high = bounds
    c, n, h = 0.5 * (low + high), 0.5 * (n_low + n_high), 0.5 * (n_high - n_low)
    return [c.x, c.y, c.z, 0.5 * dr.norm(high - low), n.x, n.y, n.z, h.x, h.y, h.z, mi.Float(0), mi.Float(0)]

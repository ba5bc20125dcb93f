"""Culling by the spindle test: which triangles can refract light onto which camera segment.

Nothing is computed for the light beforehand, so that each segment may have a light point of its own.

The test is that of Walter et al. 2009 and Holzschuch 2015. Refraction at P deviates the ray from the light L by at most
acos(min(eta, 1 / eta)). So P lies in a spindle around L and V. And the normal at P is parallel to q = omega_L + eta
omega_V. Both are tested with bounds of all P and normals of a node: a sphere and a cone. Here V is not a point but a
whole camera segment, as in the latter publication.

The departure from the publications is a third test: whether the refracted light line can meet the line of the segment
at all, |g| against a bound. Without it the number of triangles found grows like that of all triangles. For the normals'
test must take each point of the segment by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .. import optics, tolerances
from ..geometry.surface_tree import SurfaceTree
from ..transport.segments import LocalSegments
from . import beam as light_beam
from .pairs import Taken
from .protocol import Culling

NODE = 8
"""Numbers per node: centre and radius of the sphere, axis of the cone of normals and sine of its half-angle (1 or more:
all directions)."""


class Spindle(Culling):
    """The tree over the triangles of a body, and its tests. Independent of the light.

    body     ``scene.boundaries.Body``
    records  the packed triangles of the body, and maybe others
    """

    for_one_light = False
    bundle, width = 1, 0.0
    most_levels = tolerances.MOST_LEVELS

    def __init__(self, body, records):
        self.surface = SurfaceTree(
            records, body.first_record, body.corners - body.centre, lambda tri: tri.corner_normals(), _pack, NODE
        )
        self.tree, self.eta_above_1 = self.surface.tree, body.eta >= 1

    @classmethod
    def of(cls, body, _shadows, structures, _drawn):
        """As ``Culling.of``; the same for all lights."""
        return structures.once("spindle", lambda: cls(body, structures.scene.records), body)

    def node_test(self, segments, incidence):
        """The conservative test of camera segments against a node of the tree, for ``bvh.traverse``."""

        def hit(x):
            ball, cone = (mi.Vector3f(x[0:3]), x[3]), (mi.Vector3f(x[4:7]), x[7])
            return _may_refract(ball, cone, segments, incidence, self.eta_above_1)

        return hit

    def plausible(self, pairs, segment, incidence):
        """The test for single triangles, which must face the light, too."""
        if pairs.code is not None:
            return mi.Bool(True)
        exists = pairs.beam < dr.opaque(mi.UInt32, self.surface.count)
        _, tri = self.surface.at(pairs.beam, exists)
        normals = tri.corner_normals()
        middle = (normals[0] + normals[1] + normals[2]) / 3
        wide = light_beam.fold(dr.maximum, [dr.norm(n - middle) for n in normals])
        facing = dr.dot(tri.Ng, incidence.light.to(tri.P0)) > 0
        possible = _may_refract(tri.ball(), _cone(middle, wide), segment, incidence, self.eta_above_1)
        return exists & facing & possible

    def triangle_of(self, pairs, active=True):
        """Indices (UInt32) of the pairs' triangles among the scene's records."""
        return self.surface.at(pairs.beam, active)[0]

    def take(self, pairs, incidence, active=True):
        """``Taken``: triangles and light beams for pairs; nothing is proven."""
        _, tri = self.surface.at(pairs.beam, active)
        place = pairs.place(mi.Float(0), mi.Float(0), mi.Float(1))
        piece = light_beam.piece_at(tri, incidence, *place)
        coarse = light_beam.excess(piece, incidence.light) > 1
        return Taken(tri, piece, pairs.code is not None, None, mi.Bool(False), coarse)


def _pack(bounds):
    low, high, n_low, n_high = bounds
    c = 0.5 * (low + high)
    axis, sine = _cone(0.5 * (n_low + n_high), 0.5 * dr.norm(n_high - n_low))
    return [c.x, c.y, c.z, 0.5 * dr.norm(high - low), axis.x, axis.y, axis.z, sine]


def _cone(middle, radius):
    """Axis and sine of the cone around the vectors within ``radius`` of ``middle``."""
    length = dr.maximum(dr.norm(middle), 1e-30)
    return middle / length, dr.minimum(radius / length, 2)


def _may_refract(ball, cone, segment, incidence, eta_above_1):
    """False only if no point in the ball with a normal in the cone can refract light onto the segment.

    ball         (centre, radius): Vector3f, Float, body coordinates
    cone         (axis, sine of the half-angle): Vector3f, Float
    segment      ``LocalSegments``
    incidence    ``optics.Incidence`` of the light
    eta_above_1  whether eta is 1 or more
    """
    (c, r), (axis, sin_n) = ball, cone
    light, eta, a = incidence.light, incidence.eta, segment.o - c
    near = dr.norm(a + dr.clip(-dr.dot(a, segment.d), 0, segment.t_max) * segment.d)
    to_L = light.to(c)
    d_L = dr.maximum(dr.norm(to_L), 1e-30)
    omega_L = to_L / d_L
    towards_L, towards_V = _Spread(0 * r if light.distant else r / d_L), _Spread(r / dr.maximum(near, 1e-30))
    view = _View(segment, eta, a, r, omega_L, axis, _Spread(sin_n), towards_L, towards_V)
    straight, t = _largest_cosine(-omega_L, a, segment)
    possible = _deviates_enough(straight, view)
    facing = view.normals.plus(towards_L)
    facing = facing.over_90 | (dr.dot(axis, omega_L) >= -facing.sine - tolerances.COSINE)
    parallel = _may_be_normal(view, t, 1 if eta_above_1 else -1)
    meets = _may_meet(view)
    possible &= view.normals.wide | (facing & parallel & meets)
    return possible | towards_L.wide | towards_V.wide


class _Spread:
    """A cone of directions around an axis, lane by lane.

    sine    Float, of its half-angle
    cosine  Float, of the same; computed from the sine where it is not given
    chord   Float, the longest chord on the unit sphere from a direction to the axis
    wide    Bool, whether it is so wide that nothing is known
    """

    def __init__(self, sine, cosine=None):
        self.sine, self.cosine = sine, dr.safe_sqrt(1 - dr.square(sine)) if cosine is None else cosine
        self.wide = sine > tolerances.WIDE
        self.chord = sine * dr.sqrt(2 / (1 + self.cosine))

    def plus(self, other):
        """Both half-angles added."""
        sine = self.sine * other.cosine + self.cosine * other.sine
        return _Spread(sine, self.cosine * other.cosine - self.sine * other.sine)

    @property
    def over_90(self):
        """Whether the half-angle is 90 degrees or more."""
        return self.cosine <= 0


@dataclass
class _View:
    """A ball of points with a cone of normals, and where segment and light are from there; body coordinates.

    segment    camera segments
    eta        Float, relative index of refraction
    a          Vector3f, from the ball's centre to the segment's origin
    r          Float, the ball's radius
    omega_L    Vector3f, unit direction from the centre to the light
    axis       Vector3f, unit, of the cone of normals
    normals    the cone
    towards_L  cone of the directions from points of the ball to the light
    towards_V  the same to a point of the segment
    """

    segment: LocalSegments
    eta: mi.Float
    a: mi.Vector3f
    r: mi.Float
    omega_L: mi.Vector3f
    axis: mi.Vector3f
    normals: _Spread
    towards_L: _Spread
    towards_V: _Spread


def _largest_cosine(w, a, segment):
    """Largest cosine between ``w`` and the directions from a point to the segment, and the t where it is, or near it.

    w        Vector3f, of unit length, or as long as the cosine is to be multiplied by
    a        Vector3f, from the point to the segment's origin
    segment  ``LocalSegments``
    """
    b = a + segment.t_max * segment.d
    p, q, A, B = dr.dot(w, a), dr.dot(w, segment.d), dr.squared_norm(a), dr.dot(a, segment.d)
    slope = p - q * B
    t = dr.clip((q * A - p * B) / dr.select(slope == 0, 1, slope), 0, segment.t_max)
    ends = dr.maximum(p * dr.rsqrt(A), dr.dot(w, b) * dr.rsqrt(dr.squared_norm(b)))
    return dr.maximum(ends, (p + t * q) * dr.rsqrt(A + 2 * B * t + dr.square(t))), t


def _deviates_enough(straight, view):
    """Whether refraction can deviate light as far as to the segment: by at most acos(min(eta, 1 / eta)).

    ``straight``: Float, largest cosine between the light's direction and those to the segment.
    """
    k = dr.minimum(view.eta, dr.rcp(view.eta))
    deviation = _Spread(dr.safe_sqrt(1 - dr.square(k)), k).plus(view.towards_L).plus(view.towards_V)
    return (deviation.sine <= 0) | (straight >= deviation.cosine - tolerances.COSINE)


def _may_be_normal(view, t, sign):
    """Whether -q (eta > 1, ``sign`` 1) or q (-1) can be in the cone of normals.

    q = omega_L + eta omega_V, known to ``rho``, moves on an arc. Is all of it in front of a plane through 0 that the
    cone is behind? Two planes are tried: from the place ``t``, and from the place on the arc nearest to that plane.
    """
    omega_L, axis, normals, eta = view.omega_L, view.axis, view.normals, view.eta
    rho = view.towards_L.chord + eta * view.towards_V.chord
    possible = mi.Bool(True)
    for _ in range(2):
        omega_V = dr.normalize(view.a + t * view.segment.d)
        x = -sign * (omega_L + eta * omega_V)
        side = x - axis * dr.dot(axis, x)
        length = dr.norm(side)
        m = side * (normals.cosine / dr.maximum(length, 1e-30)) - axis * normals.sine
        most, t = _largest_cosine(sign * m, view.a, view.segment)
        in_front = -sign * dr.dot(omega_L, m) - eta * most > rho + tolerances.COSINE
        possible &= ~in_front | (length < tolerances.COSINE)
    return possible


def _may_meet(view):
    """Whether the refracted light can meet the line of the segment: |g| against how much it can change in the ball.

    omega = -omega_L / eta + n b, b = c_L / eta - c_V, where b is monotone in c_L.
    """
    omega_L, axis, eta, segment = view.omega_L, view.axis, view.eta, view.segment
    eps_L, eps_n = view.towards_L.chord, view.normals.chord

    def b(c_L):
        return c_L / eta - dr.safe_sqrt(optics.inside_cosine2(c_L, eta))

    least = dr.safe_sqrt(1 - dr.square(eta))  # the critical angle
    cosine = dr.dot(omega_L, axis)
    b_0, b_1, b_2 = (b(dr.clip(cosine + x, least, 1)) for x in (0, -eps_L - eps_n, eps_L + eps_n))
    omega = axis * b_0 - omega_L / eta
    change = (
        eps_L / eta + dr.maximum(dr.abs(b_1), dr.abs(b_2)) * eps_n + dr.maximum(dr.abs(b_1 - b_0), dr.abs(b_2 - b_0))
    )
    k = -dr.cross(view.a, segment.d)
    bound = dr.norm(k) * change + view.r * (dr.norm(dr.cross(segment.d, omega)) + change)
    return dr.abs(dr.dot(k, omega)) <= bound + tolerances.COSINE * dr.norm(view.a)

"""A scene as one record: bodies, regions and emitters, and tables of them for kernels."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..core.arrays import NONE
from ..core.cache import RecordsKey
from .boundaries import Body
from .emitters import Emitter
from .regions import Region
from .surfaces import albedos, box, names

ONCE = 1 << 16
"""What a boundary counts for that light may go straight through only if it is the only such one: there are no
light paths through several refracting boundaries, straight or not."""


@dataclass
class Scene:
    """All that the integrator needs to know of a scene. Tables are for lookups in kernels.

    mi_scene       Mitsuba's, in which every boundary is a mesh of its own
    bodies         ``Body`` of every boundary
    mirror_bodies  ``Body`` of every mirror that is a mesh; they are none of ``bodies``
    regions        ``Region`` of every volume
    emitters       ``Emitter`` of every light
    records        packed triangles of all bodies (``geometry.triangle``), each in its body's coordinates
    body_of_shape  UInt32 by the number of a shape: index of its body, or NONE
    eta            Float by body: index of refraction inside over outside
    first_record   UInt32 by body: number of its first triangle
    centre         Float, three by body, world
    extent         Float by body: its largest coordinate, world
    inside         UInt32 by body: region behind its normals, or NONE
    outside        UInt32 by body: region before them, or NONE
    index2         Float by region: square of the index of refraction relative to the outermost
    owner          UInt32 by region: the closed body whose inside it is, or NONE
    thin           Bool by body, whether it is a thin sheet; None where none is
    straight       UInt32 by body, what it counts for light to go straight through it: 1 or ``ONCE``, 0 if light
                   can't; None where none can be gone through
    passed         the bodies that light goes straight through
    others         shapes that are no bodies
    mirrors        Float by the number of a shape: largest coordinate, world, of mirrors, else 0; None where there
                   are none
    records_key    what ``records`` were made from
    geometry       changes where any shape moves or changes its form; None where that is not known
    """

    mi_scene: mi.Scene
    bodies: list[Body]
    mirror_bodies: list[Body]
    regions: list[Region]
    emitters: list[Emitter]
    records: mi.Float
    body_of_shape: mi.UInt32
    eta: mi.Float
    first_record: mi.UInt32
    centre: mi.Float
    extent: mi.Float
    inside: mi.UInt32
    outside: mi.UInt32
    index2: mi.Float
    owner: mi.UInt32
    thin: mi.Bool | None
    straight: mi.UInt32 | None
    passed: list[Body]
    others: list
    mirrors: mi.Float | None
    records_key: RecordsKey
    geometry: tuple | None

    def find(self, shape):
        """Index of the body of each shape pointer, or NONE; a null pointer is no body."""
        return dr.gather(mi.UInt32, self.body_of_shape, dr.reinterpret_array(mi.UInt32, shape))

    def lights_at(self, o, d, share):
        """Emitters that are points where camera rays (``o``, ``d``: (n, 3)) all come from, seen from some body: nearer
        than ``share`` of the way there."""
        points = [emitter for emitter in self.emitters if not emitter.drawn and not emitter.place.distant]
        ways = [
            np.linalg.norm(np.maximum(0, np.maximum(low - o[0], o[0] - high)))
            for low, high in (b.box for b in self.bodies)
        ]
        near = share * min(ways, default=0)
        return [x for x in points if (np.linalg.norm(np.cross(o - np.ravel(x.place.L), d), axis=1) < near).all()]

    def through_media(self, body):
        """Whether light comes to a boundary through a medium or straight through other boundaries."""
        outside = self.regions[body.outside] if body.outside != NONE else None
        return self.straight is not None or (outside is not None and outside.medium is not None)

    def near(self, target, leaving, active):
        """Region on the near side of rays that meet the boundaries ``target``, from inside where they are
        ``leaving``."""
        inside, outside = (dr.gather(mi.UInt32, table, target, active) for table in (self.inside, self.outside))
        return dr.select(leaving, inside, outside)

    def missed_behind(self, region, target, leaving, active):
        """Of rays that meet a boundary from another region than theirs: which have already been in the one on its
        near side. The others come from the inside of a body that touches it, and have missed the boundary of
        that."""
        owner = self._owner(region, active)
        return active & (leaving | (owner == NONE) | (owner == target))

    def enclosed(self, region):
        """Which regions a closed body ends."""
        return self._owner(region, True) != NONE

    def _owner(self, region, active):
        known = active & (region != NONE)
        return dr.select(known, dr.gather(mi.UInt32, self.owner, region, known), NONE)

    @property
    def splits(self):
        """Whether camera rays may meet what they are followed beyond without random choice: boundaries, mirrors,
        media."""
        return bool(self.bodies or self.regions) or self.mirrors is not None

    def lets_pass(self, hit):
        """Whether rays that meet a boundary (``crossing.Hit``) and go through it are not bent, as if it were not
        there."""
        if self.straight is None:
            return mi.Bool(False)
        return hit.boundary & (dr.gather(mi.UInt32, self.straight, hit.target, hit.boundary) == 1)

    def squared_index(self, region):
        """Square of the index of refraction of regions."""
        known = region != NONE
        return dr.select(known, dr.gather(mi.Float, self.index2, region, known), 1)

    def encloses(self, outer, inner):
        """Whether a body is inside another, directly or in one that is."""
        while inner.outside != NONE and (around := self.regions[inner.outside].body) is not None:
            if around is outer:
                return True
            inner = around
        return False

    def names(self):
        """Names of all shapes by their number."""
        return names(self.mi_scene)

    def box(self):
        """Box around all shapes (low, high), or None where there are none."""
        return box(self.mi_scene)

    def albedos(self):
        """Shares of light that plain surfaces reflect, by the number of a shape (``surfaces.albedos``)."""
        return albedos(self.mi_scene, self.others)

    def mirror_extent(self, shape):
        """The largest coordinate of each shape pointer that is a mirror; 0 where it is none."""
        return dr.gather(mi.Float, self.mirrors, dr.reinterpret_array(mi.UInt32, shape))

    def is_mirror(self, shape):
        """Whether each shape pointer is a mirror."""
        return self.mirror_extent(shape) > 0

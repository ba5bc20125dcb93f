"""Regions: the volumes between boundaries, each with one medium or none, and which boundary is between which."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from . import media
from .boundaries import NONE, Body, boxes_meet, enclosed_share
from .errors import SceneError, name_medium
from .support import refusal


@dataclass
class Region:
    """A volume with one medium, or a closed body's inside without.

    name        of what it fills, as messages call it
    index       its number among the regions of the scene
    body        the closed body whose inside it is, or None
    medium      Mitsuba's, or None
    scatters    whether it scatters light
    phase       phase function (omega, d), 1/sr: ``media.phase``
    directed    ``media.directed``, or None
    visible_range  how far light and camera rays are followed in it, or None where its body ends it
    admits      whether light may come in without refraction
    boundaries  refracting ones, each as the ``Body`` that has this region inside
    """

    name: str
    index: int
    body: Body | None
    medium: mi.Medium | None
    scatters: bool = False
    phase: Callable | None = None
    directed: Callable | None = None
    visible_range: float | None = None
    admits: bool = False
    boundaries: list[Body] = field(default_factory=list)

    @property
    def label(self):
        """How its medium is called: by its id if it has one, else by what it fills."""
        name = self.medium.id()
        return f'the medium "{name}"' if name and not name.startswith("_") else f"the medium of {self.name}"

    def coefficients(self, wavelengths, d):
        """``media.coefficients`` along d."""
        return media.coefficients(self.medium, wavelengths, d if self.directed else None)


class Regions:
    """Finds the regions of the bodies of a scene, and sets the bodies' ``inside`` and ``outside``."""

    def __init__(self, bodies, sensors):
        self.found, self._open = [], {}
        inside_of = _containers(bodies)
        for body in bodies:
            if body.closed:
                body.inside = self._add(body.name, body, body.shape.interior_medium()).index
        for body in bodies:
            container, interior, exterior = (
                inside_of.get(body.index),
                body.shape.interior_medium(),
                body.shape.exterior_medium(),
            )
            if not body.closed:
                body.inside = self._around(body, container, interior, "interior")
            body.outside = self._around(body, container, exterior, "exterior")
        for sensor in sensors:
            if sensor.get_medium() is not None and not any(r.medium == sensor.get_medium() for r in self.found):
                self._of(sensor.get_medium(), None)

    def _add(self, name, body, medium):
        region = Region(name, len(self.found), body, medium)
        self.found.append(region)
        if medium is not None:
            media.check(name, medium)
            region.scatters, region.phase = media.scatters(medium), media.phase(medium)
            region.directed = media.directed(medium)
        if body is None:
            region.visible_range = _visible_range(name, medium)
        return region

    def _of(self, medium, body):
        """The region that no closed body bounds, of a medium."""
        if medium is None:
            return NONE
        for known, region in self._open.values():
            if known == medium:
                return region.index
        region = self._add(body.name if body is not None else "the sensor", None, medium)
        self._open[region.index] = medium, region
        return region.index

    def _around(self, body, container, medium, side):
        """Index of the region on a side of a body where no body but its ``container``, if it has one, ends it."""
        if container is None:
            return self._of(medium, body)
        region = self.found[container.inside]
        if region.medium != medium:
            what = f"no {side} medium" if medium is None else f"another {side} medium, {name_medium(medium)}"
            around = name_medium(region.medium)
            raise refusal("exterior", body.name, other=container.name, what=what, around=around, side=side)
        return region.index


def _visible_range(name, medium):
    """Distance behind which no more is seen of an unbounded medium."""
    around = mi.warp.square_to_uniform_sphere(dr.meshgrid(*2 * [dr.linspace(mi.Float, 0, 1, 9)]))
    sigma_t = np.array(media.coefficients(medium, media.visible(), mi.Vector3f(around))[1]).ravel()
    if not (sigma_t > 0).any():
        raise SceneError(f"{name} has an unbounded medium that absorbs and scatters nothing: remove it")
    return float(tolerances.OPAQUE / sigma_t[sigma_t > 0].min())


def _containers(bodies):
    """The smallest closed body around each body (by index). Refuses those that overlap."""
    around = {}
    for inner in bodies:
        for outer in bodies:
            if outer is inner or not outer.closed or not boxes_meet(inner.box, outer.box):
                continue
            share = enclosed_share(outer.corners, inner.corners)
            if 0 < share < 1 or (share == 1 and inner in around.get(outer.index, ())):  # the latter: in the same place
                raise refusal("overlap", inner.name, other=outer.name)
            if share == 1:
                around.setdefault(inner.index, []).append(outer)
    return {
        index: min(outer, key=lambda body: np.prod(np.subtract(*body.box[::-1]))) for index, outer in around.items()
    }

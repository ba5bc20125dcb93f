"""Where the camera is: in which region, and what is refused of what its sensor says."""

from __future__ import annotations

import numpy as np

from ..core.arrays import NONE
from .boundaries import holds
from .errors import SceneError, name_edge, name_medium
from .support import refusal


def region_of_camera(scene, medium, origin):
    """Index of the region in which camera rays start (or NONE), from the ``medium`` that the sensor names (or
    None) and an ``origin`` of its rays (3 numbers). Open boundaries do not tell on which side of them it is: what
    the rays meet does (``side_refusal``)."""
    around = [body for body in scene.bodies if body.closed and holds(body, origin)]
    body = min(around, key=lambda body: np.prod(np.subtract(*body.box[::-1])), default=None)
    if body is not None:
        region = scene.regions[body.inside]
        if region.medium != medium:
            raise side_refusal(body, True, region.medium, medium, "is around the camera")
        return region.index
    if medium is None:
        return NONE
    matches = [region for region in scene.regions if region.medium == medium]
    if not matches:
        raise SceneError(
            f"the sensor names {name_medium(medium)}, which no part of the scene has: remove it from the sensor"
        )
    if all(region.body is not None for region in matches):
        raise refusal("sensor outside", matches[0].body.name, medium=name_medium(medium))
    return next(region.index for region in matches if region.body is None)


def side_refusal(body, inside, medium, named, where):
    """The ``SceneError`` for a camera that is on a side of a boundary (``where`` says how that is known) with
    another ``medium`` (or None) than the sensor has ``named``."""
    if medium is None:
        side = "interior" if inside else "exterior"
        return refusal("sensor medium", body.name, where=where, named=name_medium(named), side=side)
    instead = "move it to the other side, or turn the surface with flip_normals"
    if body.closed:
        instead = "or move it out" if inside else "or remove that from the shape's exterior"
    names = {"medium": name_medium(medium), "named": name_medium(named)}
    return refusal("camera medium", body.name, where=where, instead=instead, **names)


def hole_refusal(body, medium, share):
    """The ``SceneError`` for an open boundary of which the camera sees the outside, and by a ``share`` of its
    rays the inside."""
    edges = np.flatnonzero(body.twin < 0)
    edge = name_edge(body.corners, edges[0])
    return refusal("hole", body.name, share=share, medium=name_medium(medium), count=len(edges), edge=edge)

"""Shadow rays of the light path L -> P -> V against the scene: any surface in between is a shadow."""

import drjit as dr
import mitsuba as mi

from . import tolerances


def tests(scene, body, L):
    """The visibility tests ``(lit, inside)`` of a body for a light at ``L`` (body coordinates).

    ``lit(P, Ng, active)``: nothing between the light and P. ``inside(P, Ng, direction, length, active)``:
    nothing between P and the point at ``length``. A test is None where nothing can be in the way: a convex
    body does not shadow itself.
    """
    centre = dr.opaque(mi.Point3f, body.centre)
    offset = dr.opaque(mi.Float, tolerances.SHADOW_OFFSET * scene.extent)

    def lit(P, Ng, active):
        start = P + offset * Ng
        to_light = L - start
        distance = dr.norm(to_light)
        ray = mi.Ray3f(start + centre, to_light / distance, distance * (1 - tolerances.SHADOW_END), 0, [])
        return ~scene.mi_scene.ray_test(ray, active)

    def inside(P, Ng, direction, length, active):
        ray = mi.Ray3f(P - offset * Ng + centre, direction, length * (1 - tolerances.SHADOW_END), 0, [])
        return ~scene.mi_scene.ray_test(ray, active)

    alone = len(scene.bodies) == 1 and not scene.others
    inner = body.convex and not any(_boxes_meet(body.shape.bbox(), shape.bbox()) for shape in _others(scene, body))
    return None if body.convex and alone else lit, None if inner else inside


def _others(scene, body):
    return scene.others + [other.shape for other in scene.bodies if other is not body]


def _boxes_meet(a, b):
    return all(a.min[k] <= b.max[k] and b.min[k] <= a.max[k] for k in range(3))

"""What camera rays tell of a scene that is not as it says: the sensor's medium is another one, or bodies overlap."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..scene import NONE, holds, hole_refusal, refusal, side_refusal


def refuse_other_medium(scene, legs, hit, elsewhere):
    """Camera rays that first meet a boundary from a side where another medium is than the sensor names.

    A few may have slipped through edges, or see an open surface from behind through its hole. They are made up
    for, as long as they are at most ``tolerances.FROM_ELSEWHERE`` of the rays in this wavefront that hit
    anything. None are where the sensor is in a medium without end and a body is met from outside.
    """
    found = dr.compress(scene.missed_behind(legs.region, hit.target, hit.leaving, elsewhere))
    if dr.width(found) == 0:
        return
    start = int(dr.gather(mi.UInt32, legs.region, found)[0])
    around = None if start == NONE else scene.regions[start]
    named = None if around is None else around.medium
    target, here, inside = (arrays.gather(x, found).numpy() for x in (hit.target, hit.near, hit.leaving))
    differs = np.array([region.medium != named for region in scene.regions] + [named is not None])
    wrong, hits = differs[np.minimum(here, len(scene.regions))], int(dr.count(hit.valid)[0])
    if wrong.sum() <= tolerances.FROM_ELSEWHERE * hits:
        wrong &= ~inside & (around is not None and around.body is None)
    if not wrong.any():
        return
    sides, first, counts = np.unique(2 * target[wrong] + inside[wrong], return_index=True, return_counts=True)
    most = np.argmax(counts)
    body, leaves = scene.bodies[sides[most] // 2], bool(sides[most] % 2)
    lane = dr.gather(mi.UInt32, found, mi.UInt32(int(np.flatnonzero(wrong)[first[most]])))
    if leaves and body.closed and not holds(body, dr.gather(mi.Point3f, legs.o, lane).numpy().ravel()):
        return  # it slipped through twice
    medium = None if (there := body.inside if leaves else body.outside) == NONE else scene.regions[there].medium
    share = f"{100 * counts[most] / hits:.3g} %"
    if leaves and not body.closed and medium is not None and bool(dr.any((hit.target == body.index) & ~hit.leaving)):
        raise hole_refusal(body, medium, share)
    where = f"is met from its {'inside' if leaves else 'outside'} by {share} of the camera rays that hit anything"
    raise side_refusal(body, leaves, medium, named, where)


def refuse_overlaps(scene, legs, hit, elsewhere):
    """Refuses a scene if legs that meet a boundary from a region that it is not next to come from inside of two
    bodies."""
    found = dr.compress(elsewhere)
    if dr.width(found) == 0:
        return
    few = dr.gather(mi.UInt32, found, dr.arange(mi.UInt32, min(tolerances.OVERLAP_RAYS, dr.width(found))))
    middle = dr.gather(mi.Point3f, mi.Point3f(legs.o + 0.5 * hit.pi.t * legs.d), few).numpy().T
    named = [dr.gather(mi.UInt32, x, few).numpy() for x in (legs.region, hit.target)]
    for point, here, met in zip(middle, *named):
        a = None if here == NONE else scene.regions[here].body
        b = scene.bodies[met]
        nested = a is not None and (scene.encloses(a, b) or scene.encloses(b, a))
        if a is not None and a is not b and not nested and b.closed and holds(a, point) and holds(b, point):
            raise refusal("overlap", b.name, other=a.name)

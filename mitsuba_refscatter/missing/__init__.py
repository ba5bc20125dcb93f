"""What a picture lacks: a rough estimate, told in warnings. The one place that knows which light is not computed.

A few thousand photons go from the lights through boundaries and media and off surfaces, whether that is computed
or not. What they leave in each medium is sorted by what happened to them before. For surfaces that are seen,
straight lines to the lights tell how much light media take on the way.
"""

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..scene import NONE, media
from .emission import offset, photons, points
from .walk import FURTHER, INSIDE, REFLECTED, REFRACTED, SURFACES, Tables, follow, look, meet

silent = False
"""Whether nothing is said: by commands that measure, whose renders are many, and all of single scattering alone."""

SAYS = {
    REFRACTED: "it passes through {culprit} first, and light is followed through one refraction only",
    INSIDE: "it is reflected inside {culprit} first, which is not followed",
    REFLECTED: "it is reflected by {culprit} first, which is not followed",
    SURFACES: "it comes from surfaces such as {culprit}, which is not followed",
    FURTHER: "it has scattered before, and single scattering alone is computed; volpath finds the rest",
}
"""Why light is missing in a medium, by what happened to it."""

IN_MEDIA = "{share} of the light that scatters in {region} is missing: {reason}"

ON_SURFACES = (
    "{share} of the light on the surfaces that are seen is wrong: {region} is ignored on its way "
    "from the lights; "
    "surfaces=false leaves surfaces out"
)


def in_media(scene):
    """Sentences about the light that is missing in the media of a ``scene.Scene``."""
    regions = [region for region in scene.regions if region.scatters]
    if silent or not regions or not scene.emitters:
        return []
    left, by_shape = follow(scene, photons(scene))
    names, out = scene.names(), []
    for region in regions:
        total = left[:, region.index].sum()
        for kind, sentence in SAYS.items():
            share = left[kind, region.index] / max(total, 1e-30)
            if share > (tolerances.MISSING_BEHIND if kind == REFRACTED else tolerances.MISSING):
                reason = sentence.format(culprit=names.get(int(np.argmax(by_shape[kind, region.index])), "a boundary"))
                out.append(IN_MEDIA.format(share=_about(share), region=region.label, reason=reason))
    return out


def on_surfaces(scene, ends):
    """Sentences about what media do to light on the surfaces where camera rays end. ``ends``: a list of
    ``camera.Legs``."""
    if silent or not scene.emitters or not any(region.medium is not None for region in scene.regions):
        return []
    total = sum(map(len, ends))
    some = [legs.gather(_evenly(len(legs), -(-len(legs) * tolerances.MISSING_PHOTONS // total))) for legs in ends]
    legs = type(ends[0]).concat(some)
    count = len(legs)
    met = meet(scene, legs.o, legs.d, True)
    P, n, tables = met.p, dr.select(dr.dot(met.n, legs.d) > 0, -met.n, met.n), Tables(scene)
    start, seen, wrong = P + n * offset(P), 0.0, np.zeros(len(scene.regions) + 1)
    for emitter, point in points(scene, mi.PCG32(size=count)):
        omega_L, d_L = point.local(mi.Point3f(0)).seen_from(P)
        arriving = legs.weight * point.intensity(media.visible()) * dr.maximum(dr.dot(n, omega_L), 0) / dr.square(d_L)
        emission = point.emission(mi.Point3f(0), media.visible())
        arriving = dr.mean(mi.Spectrum(arriving if emission is None else arriving * emission(P, omega_L, d_L)))
        lit = met.valid & dr.isfinite(arriving) & (arriving > 0)
        distance = tolerances.ENDLESS if point.distant else d_L * (1 - tolerances.SHADOW_END)
        view = look(scene, tables, start, omega_L, distance, (legs.region, lit))
        # The nested integrator connects a point through nothing at all, and meets larger lights by chance behind
        # anything.
        exact = mi.Bool(not emitter.drawn)
        counted = dr.select(~view.free | (exact & view.crosses), mi.Float(0), 1)
        right = dr.select(view.free & ~(exact & view.refracts), view.left, 0)
        seen += float(dr.sum(dr.select(lit, arriving * dr.maximum(counted, right), 0))[0])
        off = dr.zeros(mi.Float, arrays.room(len(wrong)))
        dr.scatter_add(off, arriving * dr.abs(counted - right), view.region, lit & (view.region != NONE))
        wrong += np.array(off)[: len(wrong)]
    share = wrong.sum() / max(seen, 1e-30)
    if share <= tolerances.MISSING_ON_SURFACES:
        return []
    return [ON_SURFACES.format(share=_about(share), region=scene.regions[int(np.argmax(wrong))].label)]


def _evenly(n, count):
    """Numbers of ``count`` of ``n`` things, or of all of them."""
    return arrays.array(mi.UInt32, (np.arange(min(n, count)) + 0.5) * n / min(n, count))


def _about(share):
    return f"about {max(1, round(100 * share))}%"

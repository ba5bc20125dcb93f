"""What a picture lacks: a rough estimate, told in warnings. The one place that knows which light is not computed.

A few thousand photons go from the lights through boundaries and media and off surfaces, whether that is computed
or not. What they leave in each medium is sorted by what happened to them before.
"""

import numpy as np

from .. import tolerances
from .emission import photons
from .walk import FURTHER, INSIDE, REFLECTED, REFRACTED, SURFACES, follow

SAYS = {
    REFRACTED: "it passes through {culprit} first, and {limit}",
    INSIDE: "it is reflected inside {culprit} first, and {limit}",
    REFLECTED: "it is reflected by {culprit} first, and {limit}",
    SURFACES: "it comes from surfaces such as {culprit}, which is not followed",
    FURTHER: "it has scattered before, and single scattering alone is computed; volpath finds the rest",
}
"""Why light is missing in a medium, by what happened to it."""

IN_MEDIA = "{share} of the light that scatters in {region} is missing: {reason}"


LIMIT = "light_bounces = {bounces} ends it there; set it higher"
LIMITED = "this method knows one refraction only"


def in_media(scene, bounces=None):
    """Sentences about the light that is missing in the media of a ``scene.Scene``. ``bounces``: as of the option
    ``light_bounces``; None where a method has none."""
    regions = [region for region in scene.regions if region.scatters]
    if not regions or not scene.emitters:
        return []
    left, by_shape = follow(scene, photons(scene), bounces or 0)
    limit = LIMITED if bounces is None else LIMIT.format(bounces=bounces)
    names, out = scene.names(), []
    for region in regions:
        total = left[:, region.index].sum()
        for kind, sentence in SAYS.items():
            share = left[kind, region.index] / max(total, 1e-30)
            if share > (tolerances.MISSING_BEHIND if kind == REFRACTED else tolerances.MISSING):
                culprit = names.get(int(np.argmax(by_shape[kind, region.index])), "a boundary")
                reason = sentence.format(culprit=culprit, limit=limit)
                out.append(IN_MEDIA.format(share=_about(share), region=region.label, reason=reason))
    return out


def _about(share):
    return f"about {max(1, round(100 * share))}%"

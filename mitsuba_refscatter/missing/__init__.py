"""What a picture lacks: a rough estimate, told in warnings. The one place that knows which light is not computed.

A few thousand photons go from the lights through boundaries and media and off surfaces, whether that is computed
or not. What they leave in each medium is sorted by what happened to them before.
"""

import numpy as np

from .. import tolerances
from .emission import photons
from .walk import FURTHER, INSIDE, REFLECTED, REFRACTED, SURFACES, follow

SAYS = {
    REFRACTED: "it passes through {culprit} first, and light is followed through one refraction only",
    INSIDE: "it is reflected inside {culprit} first, which is not followed",
    REFLECTED: "it is reflected by {culprit} first, which is not followed",
    SURFACES: "it comes from surfaces such as {culprit}, which is not followed",
    FURTHER: "it has scattered before, and single scattering alone is computed; volpath finds the rest",
}
"""Why light is missing in a medium, by what happened to it."""

IN_MEDIA = "{share} of the light that scatters in {region} is missing: {reason}"


def in_media(scene):
    """Sentences about the light that is missing in the media of a ``scene.Scene``."""
    regions = [region for region in scene.regions if region.scatters]
    if not regions or not scene.emitters:
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


def _about(share):
    return f"about {max(1, round(100 * share))}%"

"""What a render says besides its image: warnings, each once."""

from __future__ import annotations

import mitsuba as mi

from .. import tolerances


class Messages:
    """Warnings of one integrator. ``told``: sentences since the last render began."""

    def __init__(self):
        self.told = set()

    def begin(self):
        """A new render begins, which may say again what another has said."""
        self.told = set()

    def warn(self, sentences):
        """Says what has not been said in this render."""
        for sentence in sentences:
            if sentence not in self.told:
                mi.Log(mi.LogLevel.Warn, f"refscatter: {sentence}.")
            self.told.add(sentence)


def lights_at_the_camera(scene, ends):
    """Sentences about the lights that are where camera rays come from: of what these send straight back most
    estimators find little. ``ends``: origins and directions of the first and the last ray, (2, 3) each."""
    return [
        f"{emitter.name} is at the camera: of what it sends straight back most is not found. Move it aside by "
        f'{2 * tolerances.AT_CAMERA:g} of its distance from the body, or set estimator to "point"'
        for emitter in scene.lights_at(*ends, tolerances.AT_CAMERA)
    ]


def unresolved(counts, tolerance):
    """Sentences about the camera samples whose light paths were not all found. ``counts``: ``wavefront.Counts``."""
    share = counts.unresolved / max(counts.samples, 1)
    if share <= tolerances.MOST_UNRESOLVED:
        return []
    return [
        f"{share:.1%} of the camera samples are not known to the tolerance {tolerance:g}: their rays graze caustics, "
        'or triangles are large for what they refract; the AOV "unresolved" shows where. Lower the tolerance or '
        "tessellate the boundary more finely"
    ]

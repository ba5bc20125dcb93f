"""All that estimators know of pairs of a camera segment and a light beam, lane by lane."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi

from ..culling.pairs import Pairs, Taken
from ..light.illumination import Illumination
from ..transport.segments import LocalSegments


@dataclass
class PairData:
    """Pairs with their segments, light and triangles, in body coordinates; every field has one entry per pair.

    pairs         the numbers of segments and light beams
    segment       camera segments, without their ``sigma_t``
    sigma_t       Spectrum, extinction along the segments in 1/length
    illumination  of the boundary, for these segments
    taken         triangles, light beams and proofs of the culling
    """

    pairs: Pairs
    segment: LocalSegments
    sigma_t: mi.Spectrum
    illumination: Illumination
    taken: Taken

    @classmethod
    def of(cls, pairs, segments, culling, illumination):
        """Gathers the data of pairs.

        pairs         ``culling.pairs.Pairs``
        segments      ``LocalSegments``, which the pairs' numbers mean
        culling       ``culling.protocol.Culling``, which found the pairs
        illumination  ``light.illumination.Illumination`` of all segments
        """
        illumination = illumination.at(pairs.segment)
        taken = culling.take(pairs, illumination)
        return cls(pairs, segments.gather(pairs.segment), segments.sigma_t_of(pairs.segment), illumination, taken)

    @property
    def tri(self):
        """The triangles."""
        return self.taken.tri

    @property
    def piece(self):
        """The light beams."""
        return self.taken.piece

    def visible(self, P, uv, omega, s, active):
        """``active`` (Bool) where nothing is in the way from the light to P and on to P + s omega.

        P      Point3f, on the triangle
        uv     (u, v), its place there
        omega  Vector3f, unit direction of the refracted light
        s      Float, length of the way behind P
        """
        return self.illumination.visible(P, uv, omega, s, self.taken, active)

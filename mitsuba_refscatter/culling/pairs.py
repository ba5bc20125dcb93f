"""Pairs of a camera segment and a light beam: what culling hands to an estimator."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..core import arrays
from ..geometry.triangle import Triangle
from . import beam


@dataclass
class Pairs:
    """(segment, beam) pairs. They may mean a part of the beam only, and a part tau0 < tau < tau1 of the curve in it.

    segment     UInt32, number of the camera segment
    beam        UInt32, number of the light beam, or of the culling's item
    code        UInt32, sub-triangle (``beam.sub_triangle``), or None where the whole beam is meant
    level       UInt32, level of that, or None
    tau0, tau1  Float, part of the curve, 0 to 1, or None where all of it is meant
    """

    segment: mi.UInt32
    beam: mi.UInt32
    code: mi.UInt32 | None = None
    level: mi.UInt32 | None = None
    tau0: mi.Float | None = None
    tau1: mi.Float | None = None

    def gather(self, index):
        """The pairs at ``index`` (UInt32)."""
        return Pairs(*(None if x is None else arrays.gather(x, index) for x in self.__dict__.values()))

    def halves(self):
        """The pairs as a list of two ``Pairs``."""
        n = len(self) // 2
        second = dr.opaque(mi.UInt32, n) + dr.arange(mi.UInt32, len(self) - n)
        return [self.gather(dr.arange(mi.UInt32, n)), self.gather(second)]

    def cut(self, n):
        """Each part of the curve in ``n`` shorter ones."""
        if len(self) == 0:
            return self
        i = dr.arange(mi.UInt32, n * len(self))
        parts = self.gather(i // n)
        whole = parts.tau0 is None or parts.tau1 is None
        tau0, tau1 = (mi.Float(0), mi.Float(1)) if whole else (parts.tau0, parts.tau1)
        step = (tau1 - tau0) / n
        parts.tau0 = tau0 + mi.Float(i % n) * step
        parts.tau1 = parts.tau0 + step
        return parts

    def quarters(self):
        """The four parts of what each pair means, as pairs."""
        if len(self) == 0:
            return self
        i = dr.arange(mi.UInt32, 4 * len(self))
        out = self.gather(i // 4)
        code, level = (mi.UInt32(0), mi.UInt32(0)) if out.code is None or out.level is None else (out.code, out.level)
        return Pairs(out.segment, out.beam, code | ((i & 3) << (2 * level)), level + mi.UInt32(1))

    def place(self, u0, v0, h):
        """Corner and signed size (u, v, h) of what is meant; ``u0``, ``v0``, ``h``: those of the whole beams."""
        if self.code is None:
            return u0, v0, h
        u, v, size = beam.sub_triangle(self.code, self.level)
        return u0 + h * u, v0 + h * v, h * size

    def share(self):
        """How much of a pair each part counts for: a line meets at most 2^(level + 1) of the 4^level parts."""
        share = mi.Float(1) if self.code is None else dr.rcp(mi.Float(2 << self.level))
        return share if self.tau0 is None or self.tau1 is None else share * (self.tau1 - self.tau0)

    def __len__(self):
        return dr.width(self.segment)


@dataclass
class Reach:
    """How far light beams get inside their body, lane by lane.

    u0, v0      Float, corner of the beam's part of its triangle in (u, v)
    h           Float, signed size of the part
    at_corners  three Float, lengths there; in between they are linear
    below       Float, light is free up to so much less than the length
    above       Float, light is blocked from so much more on; ``tolerances.ENDLESS`` where nothing is known of that
    """

    u0: mi.Float
    v0: mi.Float
    h: mi.Float
    at_corners: list[mi.Float]
    below: mi.Float
    above: mi.Float

    def known(self, u, v, s):
        """Whether light from (u, v) is free for the length s, and whether it is blocked (Bool)."""
        a, b, c = self.at_corners
        length = a + ((u - self.u0) * (b - a) + (v - self.v0) * (c - a)) / self.h
        return s < length - self.below, s > length + self.above


@dataclass
class Taken:
    """What culling knows of pairs, body coordinates, lane by lane.

    tri         triangles
    piece       light beams
    parts       whether some of these may be of parts of triangles only
    reach       how far light gets inside the body, or None
    proven_lit  Bool, whether all of the beam is proven to be lit
    coarse      Bool, whether it is too large for one sample of the light
    """

    tri: Triangle
    piece: beam.Piece
    parts: bool
    reach: Reach | None
    proven_lit: mi.Bool
    coarse: mi.Bool

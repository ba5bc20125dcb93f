"""Pairs of a camera segment and a light beam: what culling hands to an estimator."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..core import arrays
from . import beam


@dataclass
class Pairs:
    """(segment, beam) pairs as UInt32 arrays. Pairs may be of a part of a beam only: the sub-triangle ``code`` of
    ``level`` (``beam.sub_triangle``; None where the whole beam is meant); and of a part tau0 < tau < tau1 of
    the curve in it only (Float; None where all is meant)."""

    segment: object
    beam: object
    code: object = None
    level: object = None
    tau0: object = None
    tau1: object = None

    def gather(self, index):
        """The pairs at ``index``."""
        return Pairs(*(None if x is None else arrays.gather(x, index) for x in self.__dict__.values()))

    def halves(self):
        """The pairs as two lists."""
        n = len(self) // 2
        second = dr.opaque(mi.UInt32, n) + dr.arange(mi.UInt32, len(self) - n)
        return [self.gather(dr.arange(mi.UInt32, n)), self.gather(second)]

    def cut(self, n):
        """Each part of the curve in ``n`` shorter ones."""
        i = dr.arange(mi.UInt32, n * len(self))
        parts = self.gather(i // n)
        if parts.tau0 is None:
            parts.tau0, parts.tau1 = mi.Float(0), mi.Float(1)
        step = (parts.tau1 - parts.tau0) / n
        parts.tau0 = parts.tau0 + mi.Float(i % n) * step
        parts.tau1 = parts.tau0 + step
        return parts

    def place(self, u0, v0, h):
        """Corner and signed size (u, v, h) of what is meant, of beams at the place (u0, v0, h) in their triangles."""
        if self.code is None:
            return u0, v0, h
        u, v, size = beam.sub_triangle(self.code, self.level)
        return u0 + h * u, v0 + h * v, h * size

    def share(self):
        """How much of a pair each part counts for: a line meets at most 2^(level + 1) of the 4^level parts."""
        share = mi.Float(1) if self.code is None else dr.rcp(mi.Float(2 << self.level))
        return share if self.tau0 is None else share * (self.tau1 - self.tau0)

    def __len__(self):
        return dr.width(self.segment)


@dataclass
class Reach:
    """How far light beams get inside their body: lengths ``at_corners`` of their triangles, at the place (u0, v0, h), and linear
    in between. Free up to ``below`` less than that, blocked from ``above`` more on (``tolerances.ENDLESS`` where nothing is known of that)."""

    u0: object
    v0: object
    h: object
    at_corners: list
    below: object
    above: object

    def known(self, u, v, s):
        """Whether light from (u, v) is free for the length s, and whether it is blocked."""
        a, b, c = self.at_corners
        length = a + ((u - self.u0) * (b - a) + (v - self.v0) * (c - a)) / self.h
        return s < length - self.below, s > length + self.above


@dataclass
class Taken:
    """What culling knows of pairs: triangle; light beam (``beam.Piece``); whether some of these may be parts of triangles
    only; how far it gets inside the body (``Reach``), or None; whether all of it is proven to be lit; and whether
    it is too large for one sample of the light (``coarse``)."""

    tri: object
    piece: object
    parts: bool
    reach: object
    proven_lit: object
    coarse: object

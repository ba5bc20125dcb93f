"""Bundles of neighbouring camera segments, which go through a tree together."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..core import arrays
from ..geometry import bvh
from .pairs import Pairs


@dataclass
class Bundles:
    """Bundles of consecutive camera segments, body coordinates, lane by lane.

    first     UInt32, number of the first segment
    count     UInt32, how many there are
    o         Point3f, mean of their origins
    d         Vector3f, mean of their directions, not of unit length
    t_max     Float, the longest length
    spread_o  Float, how far origins are from ``o``
    spread_d  Float, how far unit directions are from ``d``
    most      segments in a bundle, at most
    """

    first: mi.UInt32
    count: mi.UInt32
    o: mi.Point3f
    d: mi.Vector3f
    t_max: mi.Float
    spread_o: mi.Float
    spread_d: mi.Float
    most: int

    @property
    def inverse_d(self):
        """1 / d, finite."""
        return bvh.finite_inverse(self.d)

    def __len__(self):
        return dr.width(self.first)

    def _fields(self):
        return {key: value for key, value in vars(self).items() if key != "most"}

    def gather(self, index):
        """Those at ``index`` (UInt32)."""
        return Bundles(**{key: arrays.gather(x, index) for key, x in self._fields().items()}, most=self.most)

    def joined(self, other):
        """These and other ``Bundles``."""
        pairs = zip(self._fields().items(), other._fields().values())
        return Bundles(**{key: arrays.concat([a, b]) for (key, a), b in pairs}, most=self.most)

    def pairs(self, lane, leaf, index):
        """The ``Pairs`` numbered ``index`` of (bundle, leaf) pairs, which have ``most * bvh.LEAF`` each.

        lane   UInt32, bundles
        leaf   UInt32, leaves
        index  UInt32, numbers of pairs of a segment and an item of a leaf
        """
        if dr.width(index) == 0:
            return Pairs(index, index)
        most = dr.opaque(mi.UInt32, self.most)
        item = index // most
        place = item // bvh.LEAF
        first = arrays.gather(self.first, arrays.gather(lane, place))
        return Pairs(first + (index - item * most), arrays.gather(leaf, place) * bvh.LEAF + (item & (bvh.LEAF - 1)))


def bundles_of(segments, most, width):
    """``Bundles`` of consecutive segments; of single ones where these are too far apart.

    segments  ``LocalSegments``
    most      int, segments in a bundle
    width     float, mean width of light beams: what is ``tolerances.BUNDLE`` times that apart is not bundled
    """
    n = len(segments)
    first = dr.arange(mi.UInt32, -(-n // most)) * dr.opaque(mi.UInt32, most)
    out = _bundle(segments, first, most)
    if most == 1:
        return out
    wide = out.spread_o + out.t_max * out.spread_d > dr.opaque(mi.Float, tolerances.BUNDLE * width)
    dr.eval(wide, *out._fields().values())
    together, apart = dr.compress(~wide), dr.compress(wide)
    if dr.width(apart) == 0:
        return out
    apart = arrays.gather(first, apart)
    i = dr.arange(mi.UInt32, dr.width(apart) * most)
    apart = arrays.gather(apart, i // most) + i % most
    single = _bundle(segments, arrays.gather(apart, dr.compress(apart < dr.opaque(mi.UInt32, n))), 1)
    return single if dr.width(together) == 0 else out.gather(together).joined(single)


def _bundle(segments, first, most):
    count = dr.minimum(dr.opaque(mi.UInt32, len(segments)) - first, most)
    every = [segments.gather(dr.minimum(first + j, first + count - 1)) for j in range(most)]
    o, d = (sum(x[1:], x[0]) / most for x in ([s.o for s in every], [s.d for s in every]))
    t_max, spread_o, spread_d = mi.Float(0), mi.Float(0), mi.Float(0)
    for s in every:
        t_max = dr.maximum(t_max, s.t_max)
        spread_o, spread_d = dr.maximum(spread_o, dr.norm(s.o - o)), dr.maximum(spread_d, dr.norm(s.d - d))
    out = Bundles(first, count, mi.Point3f(o), mi.Vector3f(d), t_max, spread_o, spread_d, most)
    dr.eval(*out._fields().values())
    return out

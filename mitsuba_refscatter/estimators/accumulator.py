"""Where estimators add what they find along camera segments."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..core import arrays


@dataclass
class Sums:
    """What light brings to each camera segment, without the segment's weight, sigma_s and the light's intensity.

    value          Spectrum, radiance
    unresolved     Float, how much of it is of pairs that were not resolved, in the channel where that is most
    candidates     Float, number of pairs that were looked at; None where not asked for
    contributions  Float, number of pairs that contributed, parts of beams by their share; None where not asked for
    """

    value: mi.Spectrum
    unresolved: mi.Float
    candidates: mi.Float | None = None
    contributions: mi.Float | None = None

    @classmethod
    def nothing(cls, n, detail=False):
        """To begin with, for at least ``n`` segments; ``detail``: whether pairs are counted."""
        n = arrays.room(n)
        return cls(
            dr.zeros(mi.Spectrum, n),
            dr.zeros(mi.Float, n),
            *(dr.zeros(mi.Float, n) if detail else None for _ in range(2)),
        )

    def look_at(self, pairs, mask):
        """Counts the pairs in ``mask`` (Bool) as candidates."""
        if self.candidates is not None:
            dr.scatter_add(self.candidates, mi.Float(1), pairs.segment, mask)

    def add(self, pairs, total, contributes, resolved, share=1):
        """Adds what pairs bring to their segments.

        pairs        ``culling.pairs.Pairs``
        total        Spectrum, radiance of each pair
        contributes  Bool, which pairs count
        resolved     Bool, for which of them all that was looked for was found
        share        Float, as how many contributions each counts
        """
        dr.scatter_add(self.value, total, pairs.segment, contributes)
        dr.scatter_add(self.unresolved, dr.max(total), pairs.segment, contributes & ~resolved)
        if self.contributions is not None:
            dr.scatter_add(self.contributions, mi.Float(share), pairs.segment, contributes)

    def add_all(self, other, weight, index):
        """Adds the ``Sums`` of other segments, times a ``weight`` (Spectrum), to those at ``index`` (UInt32)."""
        dr.scatter_add(self.value, weight * other.value, index)
        dr.scatter_add(self.unresolved, dr.max(weight) * other.unresolved, index)
        if self.candidates is not None:
            for name in ("candidates", "contributions"):
                dr.scatter_add(getattr(self, name), getattr(other, name), index)
        self.eval()

    def first(self, n):
        """Those of the first ``n`` segments."""
        index = dr.arange(mi.UInt32, n)
        return Sums(*(None if x is None else dr.gather(type(x), x, index) for x in vars(self).values()))

    def eval(self, *others):
        """Evaluates them, and ``others``, in one kernel."""
        dr.eval(*vars(self).values(), *others)

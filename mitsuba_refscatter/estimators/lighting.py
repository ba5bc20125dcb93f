"""What estimators share: the light, what may be in its way, and where they add what they find."""

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from .. import lanes, optics


@dataclass
class Lighting:
    """What an estimator knows of light and body besides the triangles.

    ``L``: position of the light (Point3f, body coordinates), one for all camera segments or one for each (points of an area); ``eta``;
    ``side``: the sign of eta - 1 (kernels differ); ``g``: asymmetry of Henyey-Greenstein or None for isotropic;
    ``lit(P, Ng, L, active)``, ``inside(P, Ng, direction, length, active)``: visibility tests, or None where nothing
    can be in the way.
    """

    L: object
    eta: object
    side: int
    g: object
    lit: object
    inside: object

    def at(self, segment):
        """The lighting of camera segments (indices)."""
        return replace(self, L=lanes.of(self.L, segment))

    @property
    def light(self):
        """``(L, eta)``: what decides how light is refracted."""
        return self.L, self.eta

    @property
    def total_reflection(self):
        return self.side < 0

    @property
    def straight(self):
        return self.side == 0

    @property
    def shadowless(self):
        return self.lit is None and self.inside is None

    def phase(self, cosine):
        """Phase function in 1/sr; ``cosine`` is +1 for forward scattering."""
        return optics.isotropic() if self.g is None else optics.henyey_greenstein(cosine, self.g)

    def proven(self, s, taken):
        """Where culling has proven that nothing is in the way from the light to P and on to P + s omega."""
        return (s < taken.clear if self.inside is not None else True) & taken.proven_lit

    def visible(self, P, Ng, omega, s, taken, active):
        """``active`` where nothing is in the way from the light to ``P`` and on to P + s omega."""
        if self.inside is not None:
            free = s < taken.clear
            active = active & (free | self.inside(P, Ng, omega, s, active & ~free))
        if self.lit is not None:
            active = active & (taken.proven_lit | self.lit(P, Ng, self.L, active & ~taken.proven_lit))
        return active


@dataclass
class Sums:
    """Per segment: the radiance ``value`` (without the segment's weight, sigma_s and the light's intensity), and the
    numbers of pairs that were looked at (``candidates``), that contributed (parts of beams by their share), and of those
    that were not resolved (None where not asked for)."""

    value: object
    candidates: object = None
    contributions: object = None
    unresolved: object = None

    @classmethod
    def nothing(cls, n, detail=False):
        """To begin with, for at least ``n`` segments."""
        n = lanes.room(n)
        return cls(dr.zeros(mi.Spectrum, n), *(dr.zeros(mi.Float, n) if detail else None for _ in range(3)))

    def look_at(self, pairs, mask):
        """Counts the pairs in ``mask`` as candidates."""
        if self.candidates is not None:
            dr.scatter_add(self.candidates, mi.Float(1), pairs.segment, mask)

    def add(self, pairs, total, contributes, resolved, share=1):
        """Adds the ``total`` of pairs to their segments; each counts as ``share`` contributions."""
        dr.scatter_add(self.value, total, pairs.segment, contributes)
        if self.contributions is not None:
            dr.scatter_add(self.contributions, mi.Float(share), pairs.segment, contributes)
            dr.scatter_add(self.unresolved, mi.Float(1), pairs.segment, contributes & ~resolved)

    def add_all(self, other, weight, index):
        """Adds the sums of other segments, times a weight, to those at ``index``."""
        dr.scatter_add(self.value, weight * other.value, index)
        if self.candidates is not None:
            for name in ("candidates", "contributions", "unresolved"):
                dr.scatter_add(getattr(self, name), getattr(other, name), index)
        self.eval()

    def first(self, n):
        """Those of the first ``n`` segments."""
        index = dr.arange(mi.UInt32, n)
        return Sums(*(None if x is None else dr.gather(type(x), x, index) for x in vars(self).values()))

    def eval(self, *others):
        dr.eval(*vars(self).values(), *others)

"""What estimators share: the light, what may be in its way, and where they add what they find."""

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from .. import lanes, optics


@dataclass
class Lighting:
    """What an estimator knows of light and body besides the triangles.

    ``L``: position of the light (Point3f, body coordinates), one for all camera segments or one for each; ``eta``;
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
    """Per segment: the radiance ``value`` (without the segment's weight, sigma_s and the light's intensity), the number
    of pairs that contributed (parts of beams by their share), and of those that were not resolved (None where not
    asked for)."""

    value: object
    contributions: object = None
    unresolved: object = None

    def add(self, pairs, total, contributes, resolved):
        """Adds the ``total`` of pairs to their segments."""
        dr.scatter_add(self.value, total, pairs.segment, contributes)
        if self.contributions is not None:
            dr.scatter_add(self.contributions, pairs.share(), pairs.segment, contributes)
            dr.scatter_add(self.unresolved, mi.Float(1), pairs.segment, contributes & ~resolved)

    def eval(self, *others):
        dr.eval(self.value, self.contributions, self.unresolved, *others)

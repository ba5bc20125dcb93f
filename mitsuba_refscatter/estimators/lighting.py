"""What estimators share: the light, what may be in its way, and where they add what they find."""

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from .. import lanes, optics


@dataclass
class Lighting:
    """What an estimator knows of light and body besides the triangles.

    ``light``: ``optics.Source`` in body coordinates, its L one for all camera segments or one for each (points of an area);
    ``side``: the sign of eta - 1 (kernels differ); ``phase(omega, d)``: phase function in 1/sr for light that travels along
    omega and a camera ray along d; ``lit(P, Ng, L, active)``, ``inside(P, Ng, direction, length, active)``: visibility tests,
    or None where nothing can be in the way; ``emission(P, omega_L, d_L)``: what arrives at P relative to a light that sends
    the same into all directions, or None for such a light (``emission.at(segment)``: that of camera segments);
    ``directed(omega, d)``: extinction along omega relative to that along d, or None where it is the same; ``guests``: whether other
    objects may throw shadows inside.
    """

    light: optics.Source
    side: int
    phase: object
    lit: object
    inside: object
    emission: object = None
    directed: object = None
    guests: bool = False

    def at(self, segment):
        """The lighting of camera segments (indices)."""
        light = replace(self.light, L=lanes.of(self.light.L, segment))
        return replace(self, light=light, emission=None if self.emission is None else self.emission.at(segment))

    @property
    def eta(self):
        return self.light.eta

    @property
    def total_reflection(self):
        return self.side < 0

    @property
    def straight(self):
        return self.side == 0

    @property
    def shadowless(self):
        return self.lit is None and self.inside is None

    def emitted(self, P, omega_L, d_L):
        """``emission``, or 1."""
        return 1 if self.emission is None else self.emission(P, omega_L, d_L)

    def extinction(self, sigma_t, omega, d):
        """Extinction of light along omega, of ``sigma_t``, that along the camera ray d."""
        return sigma_t if self.directed is None else sigma_t * self.directed(omega, d)

    def known(self, u, v, s, taken):
        """Where culling knows that nothing is in the way from the light to the point at (u, v) and on for the length s; and
        where it knows that something is."""
        free, blocked = self._inside(u, v, s, taken)
        return free & taken.proven_lit, blocked

    def _inside(self, u, v, s, taken):
        if self.inside is None:
            return mi.Bool(True), mi.Bool(False)
        return (mi.Bool(False), mi.Bool(False)) if taken.reach is None else taken.reach.known(u, v, s)

    def visible(self, P, Ng, omega, u, v, s, taken, active):
        """``active`` where nothing is in the way from the light to ``P``, at (u, v), and on to P + s omega."""
        if self.inside is not None:
            free, blocked = self._inside(u, v, s, taken)
            active = active & ~blocked
            active &= free | self.inside(P, Ng, omega, s, active & ~free)
        if self.lit is not None:
            active = active & (taken.proven_lit | self.lit(P, Ng, self.light.L, active & ~taken.proven_lit))
        return active


@dataclass
class Sums:
    """Per segment: the radiance ``value`` (without the segment's weight, sigma_s and the light's intensity); how much of it is of pairs
    that were not ``resolved``, in the channel where it is most (Float); and the numbers of pairs that were looked at (``candidates``) and that contributed
    (``contributions``, parts of beams by their share), None where not asked for."""

    value: object
    unresolved: object
    candidates: object = None
    contributions: object = None

    @classmethod
    def nothing(cls, n, detail=False):
        """To begin with, for at least ``n`` segments."""
        n = lanes.room(n)
        return cls(
            dr.zeros(mi.Spectrum, n),
            dr.zeros(mi.Float, n),
            *(dr.zeros(mi.Float, n) if detail else None for _ in range(2)),
        )

    def look_at(self, pairs, mask):
        """Counts the pairs in ``mask`` as candidates."""
        if self.candidates is not None:
            dr.scatter_add(self.candidates, mi.Float(1), pairs.segment, mask)

    def add(self, pairs, total, contributes, resolved, share=1):
        """Adds the ``total`` of pairs to their segments; each counts as ``share`` contributions."""
        dr.scatter_add(self.value, total, pairs.segment, contributes)
        dr.scatter_add(self.unresolved, dr.max(total), pairs.segment, contributes & ~resolved)
        if self.contributions is not None:
            dr.scatter_add(self.contributions, mi.Float(share), pairs.segment, contributes)

    def add_all(self, other, weight, index):
        """Adds the sums of other segments, times a weight, to those at ``index``."""
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
        dr.eval(*vars(self).values(), *others)

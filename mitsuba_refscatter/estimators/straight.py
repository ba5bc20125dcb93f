"""The straight estimator: single scattering of light that comes to the camera segment without refraction.

    L = integral over t of sigma_s p E(t) exp(-sigma_t t) T(t),

E the light's intensity over its squared distance (or irradiance), T what is left of it on its way (``air.Air``). Gauss
quadrature in panels, which are regular in the angle that the light spans and in optical depth (both, each weighted
by its share of the summed densities, so that the integrand is smooth in either). Where T jumps, since something begins or
ends to be in the way, the panel is divided there.
"""

import drjit as dr
import mitsuba as mi

from .. import tolerances
from .spacing import ByAngle, ByDepth


def scatter(segments, source, emission, phase, way, accuracy):
    """Radiance along every segment (Spectrum, without sigma_s, intensity and the segment's weight).

    ``source``: ``optics.Source`` in the segments' coordinates; ``emission``, ``phase``: as ``lighting.Lighting`` has them;
    ``way(V, direction, distance, active) -> (T, number)``: what is left of the light from V to there, and a number that changes
    where T jumps; None where nothing but the segments' medium is in between.
    """
    spacings = [ByDepth(dr.mean(segments.sigma_t), segments.t_max)]
    if not source.distant:
        spacings.append(ByAngle(source.L - segments.o, segments))
    total = dr.zeros(mi.Spectrum, len(segments))
    for spacing in spacings:
        integrand = _Integrand(segments, source, emission, phase, way, spacings)
        total += _integrate(spacing, integrand, len(segments), accuracy, way is not None)
    dr.eval(total)
    return total


class _Integrand:
    """What is summed, relative to the density of the samples of all spacings."""

    def __init__(self, segments, source, emission, phase, way, spacings):
        self.segments, self.source, self.emission, self.phase = segments, source, emission, phase
        self.way, self.spacings = way, spacings

    def look(self, t, active):
        """Direction to the light, its distance, what is left on the way from there, and the number of that way."""
        segments = self.segments
        V = segments.o + t * segments.d
        omega_L, d_L = self.source.seen_from(V)
        if self.way is None:
            return V, omega_L, d_L, dr.exp(-segments.sigma_t * d_L), mi.UInt32(0)
        distance = tolerances.ENDLESS if self.source.distant else d_L
        return V, omega_L, d_L, *self.way(V, omega_L, distance, active)

    def __call__(self, t, active):
        V, omega_L, d_L, left, _ = self.look(t, active)
        density = sum(spacing.density(t) for spacing in self.spacings)
        value = left * dr.exp(-self.segments.sigma_t * t) * self.phase(-omega_L, self.segments.d)
        if self.emission is not None:
            value *= self.emission(V, omega_L, d_L)
        return value / (dr.square(d_L) * density)


def _integrate(spacing, integrand, n, accuracy, jumps):
    """The integral in panels of the spacing's x."""
    panels, nodes = dr.opaque(mi.UInt32, accuracy.panels), list(zip(*tolerances.gauss(accuracy.panel_points)))
    width = dr.rcp(mi.Float(panels))

    def number(x, active=True):
        return integrand.look(spacing.t(x), active)[-1] if jumps else mi.UInt32(0)

    def gauss(a, b, active):
        total = mi.Spectrum(0)
        for x, weight in nodes:
            value = integrand(spacing.t(a + x * (b - a)), active)
            total += dr.select(active & dr.all(dr.isfinite(value)), weight * (b - a) * value, 0)
        return total

    def panel(k, before, total):
        a, b = mi.Float(k) * width, mi.Float(k + 1) * width
        if not jumps:
            return k + 1, before, total + gauss(a, b, mi.Bool(True))
        behind = number(b)
        jump = behind != before
        middle = _jump(a, b, before, jump, number)
        total += gauss(a, dr.select(jump, middle, b), mi.Bool(True))
        return k + 1, behind, total + gauss(middle, b, jump)

    state = (dr.zeros(mi.UInt32, n), number(dr.zeros(mi.Float, n)) + dr.zeros(mi.UInt32, n), dr.zeros(mi.Spectrum, n))
    return dr.while_loop(state, lambda k, *_: k < panels, panel, label="panels", mode="symbolic")[-1]


def _jump(a, b, before, jump, number):
    """Where between a and b the way's number changes from ``before``."""

    def halve(i, a, b):
        middle = 0.5 * (a + b)
        same = number(middle, jump) == before
        return i + 1, dr.select(same, middle, a), dr.select(same, b, middle)

    n = dr.width(jump)
    steps = dr.select(jump, mi.UInt32(tolerances.BISECTIONS), 0)
    state = (dr.zeros(mi.UInt32, n), a + dr.zeros(mi.Float, n), b + dr.zeros(mi.Float, n))
    _, a, b = dr.while_loop(state, lambda i, *_: i < steps, halve, label="jump", mode="symbolic")
    return 0.5 * (a + b)

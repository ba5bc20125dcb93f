"""The straight estimator: single scattering of light that comes to the camera segment without refraction.

    L = integral over t of sigma_s p E(t) exp(-sigma_t t) T(t),

E is the light's intensity over its squared distance (or irradiance), and T what is left of it on its way
(``transmittance.Transmittance``). From a light at distance h from the camera ray, let phi be the angle between the
ray's foot and the point at t. In phi E dt = I dphi / h, so that near lights make no peak.

Gauss quadrature in phi, in panels. A panel ends where either phi or the optical depth has gone another step. It also
ends where the distance from the foot has grown or shrunk by a factor. Where T jumps, since something begins or ends to
be in the way, the panel is divided.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..geometry.interval import gauss_legendre
from ..optics import LocalLight


def angle_panels(phase, accuracy):
    """Panels into which half a circle around a light must be cut for a ``phase`` function's lobes.

    Told by the quadrature itself, with panels in four places. Its largest error over the angles of scattering that they
    cover must be below ``accuracy.lobes`` relative to the integral over all. (A light that is near a camera ray sees it
    under up to half a circle, and panels that are even in that angle are so in that of scattering.)

    phase     phase function (omega, d), 1/sr
    accuracy  ``tolerances.Accuracy``
    """
    shifts, (x, w) = np.arange(4) / 4, (np.array(y) for y in gauss_legendre(accuracy.panel_points))
    counts = [accuracy.panels]
    while counts[-1] < tolerances.MOST_PANELS:
        counts.append(2 * counts[-1])
    nodes = [(np.arange(n - 1)[:, None, None] + shifts[:, None] + x) / n for n in counts]
    fine = (np.arange(32 * tolerances.MOST_PANELS) + 0.5) / (32 * tolerances.MOST_PANELS)
    parts = [*(node.ravel() for node in nodes), fine]
    angle = np.pi * np.concatenate(parts)
    omega, d = (mi.Vector3f(arrays.array(mi.Float, f(angle)), 0, arrays.array(mi.Float, g(angle)))
                for f, g in ((np.sin, np.cos), (np.zeros_like, np.ones_like)))  # fmt: skip
    value = phase(omega, d)
    if dr.width(value) == 1:  # isotropic
        return accuracy.panels
    mean = np.array(value, dtype=np.float64).reshape(-1, len(angle)).mean(axis=0)
    *values, exact = np.split(mean, np.cumsum([part.size for part in parts])[:-1])
    upto = np.concatenate([[0], np.cumsum(exact)]) / len(exact)
    for n, node, value in zip(counts, nodes, values):
        ends = [np.interp((first + shifts) / n, np.linspace(0, 1, len(upto)), upto) for first in (0, n - 1)]
        error = (value.reshape(node.shape) * w).sum(axis=(0, 2)) / n - (ends[1] - ends[0])
        if np.abs(error).max() <= accuracy.lobes * upto[-1]:
            return n
    return counts[-1]


@dataclass
class Unrefracted:
    """Light that comes to the camera segments of a region without refraction.

    light     in the segments' coordinates
    emission  as ``light.illumination.Illumination`` has it, or None
    phase     phase function (omega, d), 1/sr
    directed  as ``Illumination`` has it, or None
    way       (V, direction, distance, active) -> (T, number), or None where only the segments' medium is in between

    T is what is left of the light from V to there; the number changes where T jumps.
    """

    light: LocalLight
    emission: Callable | None
    phase: Callable
    directed: Callable | None
    way: Callable | None


def scatter(segments, unrefracted, accuracy, angles):
    """Radiance along every segment (Spectrum, without sigma_s, intensity and the segment's weight).

    segments     ``LocalSegments``
    unrefracted  ``Unrefracted``
    accuracy     ``tolerances.Accuracy``
    angles       int, panels of the angle (``angle_panels``), for a light that is not distant
    """
    integrand, light = _Integrand(segments, unrefracted), unrefracted.light
    panels = _ByDepth(segments) if light.distant else _ByAngle(segments, light.L, angles)
    total = _integrate(panels, integrand, len(segments), accuracy, unrefracted.way is not None or integrand.has_rim)
    dr.eval(total)
    return total


class _ByDepth:
    """Panels of a distant light: steps of optical depth.

    They are equal where the depth is small, and shorter near the camera where it is large.
    """

    def __init__(self, segments):
        self.t_max = segments.t_max
        depth = 2 * dr.max(segments.sigma_t) * segments.t_max  # both legs may get longer
        self.growth = 1 + dr.maximum(dr.log(depth / tolerances.EVEN_DEPTH), 0) / dr.log(8)

    def count(self, n):
        """Number of panels for ``n`` steps of depth."""
        return n

    def end(self, k, n):
        """Where step k of n ends."""
        return self.t_max * dr.power(mi.Float(k) / mi.Float(n), self.growth)

    def next(self, _a, k, j, n):
        """End of the panel from a on, which k steps of depth and j of angle precede, and how many do its end."""
        return self.end(k + 1, n), k + 1, j

    def place(self, a, b, y):
        """t at the share y of the panel from a to b, and E dt / dy for a light of intensity 1."""
        return a + y * (b - a), b - a


class _ByAngle(_ByDepth):
    """Panels of a light at ``L``: steps of depth and of the angle."""

    def __init__(self, segments, L, angles):
        super().__init__(segments)
        self.most, self.angles = angles, dr.opaque(mi.UInt32, angles)
        d, to_light = segments.d, L - segments.o
        self.foot = dr.dot(to_light, d)
        away = dr.fma(-self.foot, d, to_light)  # with the digits of h, not of the light's distance
        rest = dr.dot(away, d)
        self.foot += rest
        h = dr.norm(dr.fma(-rest, d, away))
        self.h = dr.maximum(h, tolerances.NEAREST_LINE * dr.norm(to_light))
        self.angle = self._between(0, self.t_max)

    def count(self, n):
        return n + self.most - 1

    def _between(self, a, b):
        """The angle from a to b, without differences of large ones."""
        return dr.atan2(self.h * (b - a), dr.square(self.h) + (a - self.foot) * (b - self.foot))

    def _beyond(self, a, angle):
        """Where the ray is by an ``angle`` further than at a."""
        T, x = dr.tan(angle), a - self.foot
        return a + T * (dr.square(self.h) + dr.square(x)) / (self.h - x * T)

    def next(self, a, k, j, n):
        by_depth = self.end(k + 1, n)
        by_angle = self._beyond(0, self.angle * (mi.Float(j + 1) / mi.Float(self.angles)))
        by_angle = dr.select(j + 1 < self.angles, by_angle, self.t_max)
        depth_first = (k + 1 < n) & ((j + 1 >= self.angles) | (by_depth < by_angle))
        end = dr.clip(dr.select(depth_first, by_depth, by_angle), 0, self.t_max)
        # Next to a light the angle has made its steps long before any depth is gone: on to there by factors.
        x = a - self.foot
        by_factor = self.foot + x * dr.select(x > 0, tolerances.STRETCH, 1 / tolerances.STRETCH)
        on_the_way = (dr.abs(x) > self.h) & (by_factor < end)
        k = k + dr.select(on_the_way | ~depth_first, 0, 1)
        return dr.select(on_the_way, by_factor, end), k, j + dr.select(on_the_way | depth_first, 0, 1)

    def place(self, a, b, y):
        angle = self._between(a, b)
        return dr.clip(self._beyond(a, y * angle), a, b), angle / self.h


class _Integrand:
    """What is summed, but for E."""

    def __init__(self, segments, unrefracted):
        self.segments, self.unrefracted = segments, unrefracted
        self.has_rim = unrefracted.emission is not None and unrefracted.emission.has_rim

    def look(self, t, active):
        """V at t, direction to the light, its distance, what is left on the way from there, and that way's number."""
        segments, unrefracted = self.segments, self.unrefracted
        V = segments.o + t * segments.d
        omega_L, d_L = unrefracted.light.seen_from(V)
        if unrefracted.way is None:
            sigma_t = segments.sigma_t
            if unrefracted.directed is not None:
                sigma_t = sigma_t * unrefracted.directed(-omega_L, segments.d)
            return V, omega_L, d_L, dr.exp(-sigma_t * d_L), mi.UInt32(0)
        distance = tolerances.ENDLESS if unrefracted.light.distant else d_L
        return V, omega_L, d_L, *unrefracted.way(V, omega_L, distance, active)

    def number(self, t, active):
        """A number that changes where the integrand jumps: with the way, or where a spot's light ends."""
        V, omega_L, d_L, _, number = self.look(t, active)
        if self.has_rim:
            number = 2 * number + dr.select(dr.any(self.unrefracted.emission(V, omega_L, d_L) > 0), mi.UInt32(1), 0)
        return number

    def __call__(self, t, active):
        V, omega_L, d_L, left, _ = self.look(t, active)
        value = left * dr.exp(-self.segments.sigma_t * t) * self.unrefracted.phase(-omega_L, self.segments.d)
        emission = self.unrefracted.emission
        return value if emission is None else value * emission(V, omega_L, d_L)


def _integrate(panels, integrand, n, accuracy, jumps):
    """The integral (Spectrum) in panels.

    panels     ``_ByDepth``
    integrand  ``_Integrand``
    n          int, number of segments
    accuracy   ``tolerances.Accuracy``
    jumps      whether the integrand may jump
    """
    steps, nodes = dr.opaque(mi.UInt32, accuracy.panels), list(zip(*gauss_legendre(accuracy.panel_points)))
    count = dr.opaque(mi.UInt32, panels.count(accuracy.panels))

    def number(t, active=True):
        return integrand.number(t, active) if jumps else mi.UInt32(0)

    def gauss(a, b, active):
        total = mi.Spectrum(0)
        for y, weight in nodes:
            t, measure = panels.place(a, b, y)
            value = integrand(t, active)
            total += dr.select(active & dr.all(dr.isfinite(value)), weight * measure * value, 0)
        return total

    def panel(k, j, a, before, total):
        b, k, j = panels.next(a, k, j, steps)
        if not jumps:
            return k, j, b, before, total + gauss(a, b, mi.Bool(True))
        behind = number(b)
        jump = behind != before
        middle = dr.select(jump, _jump(a, b, before, jump, number), b)
        total += gauss(a, middle, mi.Bool(True))
        return k, j, b, behind, total + gauss(middle, b, jump)

    start = dr.zeros(mi.Float, n)
    zero = dr.zeros(mi.UInt32, n)
    state = (zero, zero, start, number(start) + zero, dr.zeros(mi.Spectrum, n))
    return dr.while_loop(state, lambda k, j, *_: k + j < count, panel, label="panels", mode="symbolic")[-1]


def _jump(a, b, before, jump, number):
    """Where between a and b the way's number changes from ``before``."""

    def halve(i, a, b):
        middle = 0.5 * (a + b)
        same = number(middle, jump) == before
        return i + 1, dr.select(same, middle, a), dr.select(same, b, middle)

    n = dr.width(jump)
    steps = dr.select(jump, mi.UInt32(tolerances.BISECTIONS), 0)
    state = (dr.zeros(mi.UInt32, n), a + dr.zeros(mi.Float, n), b + dr.zeros(mi.Float, n))
    end = dr.while_loop(state, lambda i, *_: i < steps, halve, label="jump", mode="symbolic")
    return 0.5 * (end[1] + end[2])

"""Light behind chains of refractions and reflections: how chains are told, where they begin, and what they meet.

A chain is told by one choice per surface that light meets: to go through it or to be reflected. Its first choice is
made at a *first boundary*, the first that bends light on its way from the light. Boundaries that do not refract are
gone through without being counted. ``chain_tracing`` follows the light.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..core import arrays
from ..scene.boundaries import Body
from ..scene.media import visible
from ..transport.transmittance import Transmittance
from .illumination import Illumination

THROUGH, REFLECTED = 0, 1
"""Choices."""


@dataclass(frozen=True)
class Chain:
    """Choices, in order: ``THROUGH`` or ``REFLECTED``."""

    choices: tuple[int, ...]

    def then(self, choice):
        """The same with one more."""
        return Chain((*self.choices, choice))

    @property
    def bits(self):
        """All of them in one number, the first lowest."""
        return sum(choice << k for k, choice in enumerate(self.choices))


@dataclass
class FirstBoundary:
    """A boundary or a mirror as the first that light meets.

    body    ``scene.boundaries.Body``
    side    1 where light comes from its outside, -1 from inside
    before  index of the region before it, or NONE
    behind  index of that behind it, or NONE
    eta     index of refraction behind it over that before it
    """

    body: Body
    side: int
    before: int
    behind: int
    eta: float

    @classmethod
    def both(cls, body):
        """From outside and from inside."""
        return [
            cls(body, 1, body.outside, body.inside, body.eta),
            cls(body, -1, body.inside, body.outside, 1 / body.eta),
        ]

    @property
    def is_mirror(self):
        """Whether nothing goes through it."""
        return self.body.kind == "mirror"

    @property
    def choices(self):
        """What may happen to light there."""
        return (THROUGH, REFLECTED) if self.body.refracts else (REFLECTED,)


def first_boundaries(scene):
    """All that light may meet first in a ``Scene``: list of ``FirstBoundary``."""
    bodies = [body for body in scene.bodies if body.kind != "null"] + scene.mirror_bodies
    return [first for body in bodies for first in FirstBoundary.both(body)]


def coloured(scene):
    """Whether anything in a ``Scene`` takes light that goes through chains, so that beams have optical depths."""
    media = any(region.medium is not None for region in scene.regions)
    return media or scene.mirrors is not None or any(body.tints for body in scene.bodies)


class Surroundings:
    """What chains meet in a scene, as tables for kernels.

    scene    ``scene.Scene``
    bounces  int, events that are followed
    """

    def __init__(self, scene, bounces):
        self.scene, self.bounces = scene, dr.opaque(mi.UInt32, bounces)
        regions = scene.regions
        self.coloured = coloured(scene)
        self.scatters = arrays.array(mi.UInt32, [int(region.scatters) for region in regions] + [0])
        self.visible_range = arrays.array(mi.Float, [region.visible_range or 0.0 for region in regions] + [0.0])
        self.last = dr.opaque(mi.UInt32, len(regions))
        self.transmittance = Transmittance(scene, visible())

    def along(self, d, region, length):
        """Optical depths (Spectrum) of a way in a region."""
        return self.transmittance.depth(d, region, length)

    def follows(self, region):
        """Whether light scatters in regions (Bool), and how far light goes in them where nothing stops it."""
        index = dr.minimum(region, self.last)
        return dr.gather(mi.UInt32, self.scatters, index) > 0, dr.gather(mi.Float, self.visible_range, index)


@dataclass
class ChainedLight(Illumination):
    """The light of one sample behind all chains, in a region: what an estimator asks of it.

    profile      what the light sends, by direction (``LightSample.emission``), or None
    wavelengths  of the camera segments
    coloured     whether beams have optical depths
    """

    profile: Callable | None = None
    wavelengths: mi.Spectrum | None = None
    coloured: bool = False

    @classmethod
    def of(cls, region, sample, centre, wavelengths, coloured):
        """In a ``Region``, relative to ``centre`` (Point3f)."""
        return cls(
            light=sample.local(centre), eta=mi.Float(1), side=0, phase=region.phase, lit=None, inside=None,
            directed=region.directed, profile=sample.emission(centre, wavelengths), wavelengths=wavelengths,
            coloured=coloured,
        )  # fmt: skip

    def at(self, segment):
        """As ``Illumination.at``."""
        profile = None if self.profile is None else self.profile.at(segment)
        return replace(super().at(segment), profile=profile, wavelengths=arrays.of(self.wavelengths, segment))

    def carried(self, values):
        """What beams bring besides their flux density (Spectrum or Float), by the ``values`` (Float) of their further
        quadratics."""
        size = len(dr.zeros(mi.Spectrum)) if self.coloured else 0
        out = dr.exp(-self._depth(values[:size])) if size else mi.Float(1)
        if self.profile is None:
            return out
        P = mi.Point3f(values[size : size + 3])
        return out * self.profile(P, *self.light.seen_from(P))

    def _depth(self, depths):
        """Optical depth (Spectrum) at the wavelengths, from that at ``visible()`` ones."""
        if not mi.is_spectral:
            return mi.Spectrum(depths)
        known = np.ravel(visible())
        out = depths[0] + mi.Spectrum(0)
        for a, b, low, high in zip(known, known[1:], depths, depths[1:]):
            share = dr.clip((mi.Spectrum(self.wavelengths) - float(a)) / float(b - a), 0, 1)
            out += share * (high - low)
        return out

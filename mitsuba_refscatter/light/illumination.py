"""The illumination of a boundary: a light sample, the boundary that refracts it, and what may be in its way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from .. import optics, tolerances
from ..core import arrays
from ..scene.boundaries import Body
from ..scene.media import visible
from ..transport.transmittance import Transmittance
from ..transport.visibility import Shadows
from .light_samples import Cosine, IntensityProfile


@dataclass
class Illumination(optics.Incidence):
    """A light sample at a boundary, and the medium behind that: all that an estimator knows besides the triangles.

    light     in the boundary's body coordinates, its L one for all camera segments or one for each
    eta       Float, the boundary's relative index of refraction
    side      the sign of eta - 1 (kernels differ)
    phase     phase function (omega, d) in 1/sr, for light that travels along omega and a camera ray along d
    lit       visibility test (P, Ng, L, active) of the way from the light to P, or None where nothing can be in the way
    inside    the same (P, Ng, direction, length, active) of the way on behind P
    emission  (P, omega_L, d_L): what arrives at P relative to a light that sends the same into all directions, or
              None for such a light; ``emission.at(segment)``: that of camera segments
    directed  extinction (omega, d) along omega relative to that along d, or None where it is the same
    inner_objects    whether other objects may throw shadows inside
    """

    side: int
    phase: Callable
    lit: Callable | None
    inside: Callable | None
    emission: Cosine | IntensityProfile | Arrival | None = None
    directed: Callable | None = None
    inner_objects: bool = False

    def at(self, segment):
        """The illumination of camera segments (indices)."""
        light = replace(self.light, L=arrays.of(self.light.L, segment))
        return replace(self, light=light, emission=None if self.emission is None else self.emission.at(segment))

    def off(self, apart):
        """The same for points that may be so far from the boundary (float)."""
        if not isinstance(self.emission, Arrival):
            return self
        return replace(self, emission=replace(self.emission, apart=apart))

    @property
    def total_reflection(self):
        """Whether light may be reflected totally at the boundary."""
        return self.side < 0

    @property
    def straight(self):
        """Whether light goes on as it came."""
        return self.side == 0

    @property
    def shadowless(self):
        """Whether nothing can be in the way."""
        return self.lit is None and self.inside is None

    def emitted(self, P, omega_L, d_L):
        """``emission``, or 1."""
        return 1 if self.emission is None else self.emission(P, omega_L, d_L)

    def extinction(self, sigma_t, omega, d):
        """Extinction of light along omega, of ``sigma_t``, that along the camera ray d."""
        return sigma_t if self.directed is None else sigma_t * self.directed(omega, d)

    def known(self, u, v, s, taken):
        """Where culling knows that nothing is in the way from the light to the point at (u, v) and on for the
        length s; and where it knows that something is."""
        free, blocked = self._inside(u, v, s, taken)
        return free & taken.proven_lit, blocked

    def _inside(self, u, v, s, taken):
        if self.inside is None:
            return mi.Bool(True), mi.Bool(False)
        return (mi.Bool(False), mi.Bool(False)) if taken.reach is None else taken.reach.known(u, v, s)

    def visible(self, P, uv, omega, s, taken, active):
        """``active`` (Bool) where nothing is in the way from the light to P and on to P + s omega.

        P      Point3f, on a triangle
        uv     (u, v), its place there
        omega  Vector3f, unit direction of the refracted light
        s      Float, length of the way behind P
        taken  ``culling.pairs.Taken``, the triangle and what is proven of it
        """
        if self.inside is not None:
            free, blocked = self._inside(*uv, s, taken)
            active = active & ~blocked
            active &= free | self.inside(P, taken.tri.Ng, omega, s, active & ~free)
        if self.lit is not None:
            unproven = active & ~taken.proven_lit
            active = active & (taken.proven_lit | self.lit(P, taken.tri.Ng, self.light.L, unproven))
        return active


@dataclass
class Arrival:
    """What arrives at the points of a boundary of light that goes there through media or straight through other
    boundaries.

    inner          the light's own emission, or None
    light          in body coordinates
    transmittance  of the way
    boundary       the ``Body``
    apart          how far points may be from it, units of the scene
    """

    inner: Cosine | IntensityProfile | None
    light: optics.LocalLight
    transmittance: Transmittance
    boundary: Body
    apart: float = 0.0

    has_rim = False

    def at(self, segment):
        """What arrives on account of the camera segments ``segment`` (indices)."""
        inner = None if self.inner is None else self.inner.at(segment)
        light = replace(self.light, L=arrays.of(self.light.L, segment))
        return replace(self, inner=inner, light=light, transmittance=self.transmittance.at(segment))

    def __call__(self, P, omega_L, d_L):
        # Off the boundary on the light's side: the way is longer by nothing that matters.
        body = self.boundary
        start = mi.Point3f(P) + dr.opaque(mi.Point3f, body.centre)
        start += omega_L * dr.opaque(mi.Float, tolerances.ARRIVAL_OFFSET * body.extent + self.apart)
        distance = tolerances.ENDLESS if self.light.distant else d_L * (1 - tolerances.SHADOW_END)
        left, _ = self.transmittance.follow(start, omega_L, distance, dr.opaque(mi.UInt32, body.outside))
        return left if self.inner is None else left * self.inner(P, omega_L, d_L)


def shadows(scene, body, records, sample, sampled):
    """``visibility.Shadows`` of a ``LightSample`` at a boundary, whose triangles are among ``records``;
    ``sampled``: whether what is lit may be judged by samples."""
    centre = dr.opaque(mi.Point3f, body.centre)
    incidence = _incidence(body, sample, centre)
    dr.eval(incidence.light.L)
    emission = sample.emission(centre, visible())
    return Shadows(scene, body, records, incidence, emitter=sample.shape, sampled=sampled, emission=emission)


def illuminate(scene, body, region, sample, shadows, wavelengths=None):
    """``Illumination`` of a boundary by a ``LightSample``; ``region``: that behind it; ``shadows``:
    ``visibility.Shadows`` of such a sample; ``wavelengths``: of the camera segments."""
    centre = dr.opaque(mi.Point3f, body.centre)
    incidence, emission = _incidence(body, sample, centre), sample.emission(centre, wavelengths)
    if scene.through_media(body):
        emission = Arrival(emission, incidence.light, Transmittance(scene, wavelengths), body)
    return Illumination(
        light=incidence.light,
        eta=incidence.eta,
        side=(body.eta > 1) - (body.eta < 1),
        phase=region.phase,
        lit=shadows.lit,
        inside=shadows.inside,
        emission=emission,
        directed=region.directed,
        inner_objects=shadows.inner_objects,
    )


def _incidence(body, sample, centre):
    return optics.Incidence(sample.local(centre), dr.opaque(mi.Float, body.eta))

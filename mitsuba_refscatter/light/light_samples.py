"""Light samples: points and directions that light comes from, exact or drawn, and what they send.

Emitters that are one point or one direction are used as they are. Of the others (areas, environments) points and
directions are drawn: each stands for all, divided by the density with which it was drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..core import arrays
from ..core.sobol import LIGHT
from ..optics import LocalLight
from ..scene.emitters import Emitter, sample_direction
from ..scene.media import visible
from ..scene.support import CONVEX_EMITTERS

BELOW_ONE = 1 - 2.0**-24
"""The largest float32 below 1."""


@dataclass
class LightSample:
    """One point or direction that light comes from, or one for each of several lanes.

    L          the point (Point3f, world), or the unit direction (Vector3f) to it if it is ``distant``
    distant    whether it is infinitely far away
    intensity  of wavelengths: Spectrum, W/sr (and nm in spectral variants), or the irradiance of a distant one, W/m^2
    normal     of a surface that sends it by the cosine law, or None
    profile    Mitsuba's emitter, where that sends different amounts into different directions otherwise, or None
    shape      a convex one that the point lies on, or None
    """

    L: mi.Point3f
    distant: bool
    intensity: Callable
    normal: mi.Vector3f | None = None
    profile: mi.Emitter | None = None
    shape: mi.Shape | None = None

    def of(self, index):
        """The light samples of lanes (indices)."""
        normal = None if self.normal is None else arrays.of(self.normal, index)
        return LightSample(arrays.of(self.L, index), self.distant, self.intensity, normal, self.profile, self.shape)

    def local(self, centre):
        """``LocalLight`` in coordinates relative to ``centre`` (Point3f)."""
        return LocalLight(self.L if self.distant else self.L - centre, self.distant)

    def emission(self, centre, wavelengths):
        """What it sends to points (relative to ``centre``) by direction; None if it is the same everywhere."""
        if self.normal is not None:
            return Cosine(self.normal)
        return None if self.profile is None else IntensityProfile(self.profile, centre, wavelengths)


@dataclass
class Cosine:
    """The cosine at a light's surface; nothing behind its horizon. ``normal``: one, or one per camera segment."""

    normal: mi.Vector3f

    has_rim = False
    """Whether it jumps to zero somewhere."""

    def at(self, segment):
        """That for the camera segments ``segment`` (indices)."""
        return Cosine(arrays.of(self.normal, segment))

    def __call__(self, _P, omega_L, _d_L):
        return dr.maximum(-dr.dot(self.normal, omega_L), 0)


@dataclass
class IntensityProfile:
    """The intensity that an emitter at one point sends to points, by Mitsuba's own evaluation: spots, projectors."""

    mi_emitter: mi.Emitter
    centre: mi.Point3f
    wavelengths: mi.Spectrum

    has_rim = True

    def at(self, segment):
        """That for the camera segments ``segment`` (indices)."""
        return IntensityProfile(self.mi_emitter, self.centre, arrays.of(self.wavelengths, segment))

    def __call__(self, P, _omega_L, d_L):
        _, value = sample_direction(self.mi_emitter, mi.Point3f(P) + self.centre, self.wavelengths, mi.Point2f(0.5))
        return value * dr.square(d_L)


def exact(emitter):
    """The one ``LightSample`` of an ``Emitter`` that is one point or direction."""
    place, mi_emitter = emitter.place, emitter.mi_emitter
    if place.distant:

        def irradiance(wavelengths):
            return sample_direction(mi_emitter, mi.Point3f(0, 0, 0), wavelengths, mi.Point2f(0.5))[1]

        return LightSample(place.L, True, irradiance)
    if mi_emitter.class_name() != "PointLight":
        return LightSample(place.L, False, lambda wavelengths: mi.Spectrum(1), profile=mi_emitter)
    # One power of two away, where Mitsuba divides by its square: far enough to be told from the light in float32.
    away = 2.0 ** np.ceil(np.log2(max(1.0, float(np.abs(np.array(place.L)).max()))))

    def intensity(wavelengths):
        at = place.L + mi.Vector3f(0, 0, dr.opaque(mi.Float, away))
        value = sample_direction(mi_emitter, at, wavelengths, mi.Point2f(0.5))[1]
        return value * dr.opaque(mi.Float, away**2)

    return LightSample(place.L, False, intensity)


def draw(emitter, u, share):
    """``LightSample`` of an ``Emitter`` for random numbers ``u`` (Point2f) in the unit square; ``share``: the
    probability of this emitter."""
    mi_emitter, shape = emitter.mi_emitter, emitter.mi_emitter.get_shape()
    share = dr.opaque(mi.Float, share)
    if shape is None:
        return _direction(mi_emitter, u, share)
    at, weight = mi_emitter.sample_position(mi.Float(0), u)

    def intensity(wavelengths):
        si = mi.SurfaceInteraction3f(at, wavelengths)
        si.wi = mi.Vector3f(0, 0, 1)
        return mi_emitter.eval(si) * (weight / share)

    convex = shape if shape.class_name() in CONVEX_EMITTERS else None
    return LightSample(mi.Point3f(at.p), False, intensity, mi.Vector3f(at.n), None, convex)


def _direction(mi_emitter, u, share):
    """A drawn direction of an environment."""
    origin = mi.Point3f(0)
    drawn, _ = sample_direction(mi_emitter, origin, visible(), u)
    return LightSample(mi.Vector3f(drawn.d), True, lambda w: sample_direction(mi_emitter, origin, w, u)[1] / share)


def at(emitters, u, v):
    """``(emitter, LightSample)`` of those ``emitters`` of which samples must be drawn, for numbers u, v in [0,
    1): u chooses the emitter by its share, and what it leaves of it, with v, a point."""
    drawn, end = [emitter for emitter in emitters if emitter.drawn], 0.0
    for emitter in drawn:
        start, end = end, end + emitter.share
        if u < end or emitter is drawn[-1]:
            u = min(max((u - start) / emitter.share, 0.0), BELOW_ONE)
            return emitter, draw(emitter, dr.opaque(mi.Point2f, [u, min(v, BELOW_ONE)]), emitter.share)
    raise ValueError("no light must be drawn")


def one_each(emitters, u):
    """The same for numbers ``u`` (Point2f) of many camera samples: list of ``(emitter, samples, points)``, where the
    ``points``' lanes are those of ``samples`` (indices)."""
    drawn, out, end = [emitter for emitter in emitters if emitter.drawn], [], 0.0
    for emitter in drawn:
        start, end = end, end + emitter.share
        low, high = dr.opaque(mi.Float, start), dr.opaque(mi.Float, 2.0 if emitter is drawn[-1] else end)
        samples = dr.compress((u.x >= low) & (u.x < high))
        if dr.width(samples) > 0:
            x, y = arrays.gather(u.x, samples), arrays.gather(u.y, samples)
            x = dr.clip((x - low) / dr.opaque(mi.Float, emitter.share), 0, BELOW_ONE)
            out.append((emitter, samples, draw(emitter, mi.Point2f(x, y), emitter.share)))
    return out


@dataclass
class LightShare:
    """A light sample and the camera samples that it is for.

    emitter  whose it is
    sample   one, or one for each of several camera samples
    slot     per camera sample (UInt32): the lane of ``sample`` that is for it, or NONE; None where the one is for
             all of them
    value    the intensities of the samples where these are known, else None
    """

    emitter: Emitter
    sample: LightSample
    slot: mi.UInt32 | None = None
    value: mi.Spectrum | None = None

    def of(self, segments):
        """The ``CameraSegments`` that it is for, their light samples, one or one for each, and the intensities of
        these; None if there are none."""
        if self.slot is None:
            return segments, self.sample, self.sample.intensity(segments.wavelengths)
        slot = dr.gather(mi.UInt32, self.slot, segments.sample)
        lit = dr.compress(slot != arrays.NONE)
        if dr.width(lit) == 0:
            return None
        segments, slot = segments.gather(lit), dr.gather(mi.UInt32, slot, lit)
        if self.value is None:
            return segments, self.sample, self.sample.intensity(segments.wavelengths)
        return segments, self.sample.of(slot), arrays.of(self.value, slot)


def shares(emitters, sequence, shared, batch, n, wavelengths):
    """``LightShare`` of all light samples for a wavefront of camera samples: each emitter that is one point or
    direction is for all of them; of the others each camera sample has one light sample.

    sequence     ``core.sobol.Sequence``, or None where no light must be drawn
    shared       number of light samples that all camera samples share (light beams are made for each); 0: each
                 has its own
    batch, n     ``core.sobol.Batch``, which camera samples these are, and their number
    wavelengths  of the camera samples
    """
    out = [LightShare(emitter, exact(emitter)) for emitter in emitters if not emitter.drawn]
    if sequence is None:
        return out
    if shared:
        numbers, which = sequence.shared(shared, batch, n)
        dr.eval(which)
        for k, (u, v) in enumerate(numbers):
            emitter, sample = at(emitters, u, v)
            dr.eval(sample.L, sample.normal)
            slot = dr.select(which == dr.opaque(mi.UInt32, k), mi.UInt32(0), arrays.NONE)
            out.append(LightShare(emitter, sample, slot))
        return out
    for emitter, samples, sample in one_each(emitters, sequence.own(LIGHT, batch, n)):
        slot = dr.full(mi.UInt32, arrays.NONE, n)
        dr.scatter(slot, dr.arange(mi.UInt32, dr.width(samples)), samples)
        value = sample.intensity(arrays.of(wavelengths, samples))
        dr.eval(sample.L, sample.normal, value, slot)
        out.append(LightShare(emitter, sample, slot, value))
    return out

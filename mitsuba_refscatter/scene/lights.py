"""Emitters as lights: points and directions, exact or drawn, and what they send.

Lights that come from one point or one direction are used as they are. Of the others (areas, environments) points and
directions are drawn: each stands for all, divided by the density with which it was drawn.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import lanes, tolerances
from ..geometry import mesh as mesh_facts
from ..optics import Source
from .errors import SceneError, describe, name_shape
from .media import visible
from .support import CONVEX_EMITTERS, DELTA_EMITTERS, refusal

BELOW_ONE = 1 - 2.0**-24
"""The largest float32 below 1."""


@dataclass
class LightPoint:
    """A light that comes from one point or direction, or one such for each of several lanes.

    ``L``: the point (Point3f, world), or the unit direction to it if it is ``distant``; ``intensity(wavelengths)``: W/sr (and
    nm in spectral variants), or the irradiance of a distant one; ``normal``: of a surface that sends it by the cosine law, or
    None; ``emitter``: that sends different amounts into different directions otherwise, or None; ``shape``: convex one
    that the point lies on, or None.
    """

    L: object
    distant: bool
    intensity: object
    normal: object = None
    emitter: object = None
    shape: object = None

    def of(self, index):
        """The light points of lanes (indices)."""
        normal = None if self.normal is None else lanes.of(self.normal, index)
        return LightPoint(lanes.of(self.L, index), self.distant, self.intensity, normal, self.emitter, self.shape)

    def source(self, eta, centre):
        """``optics.Source`` in coordinates relative to ``centre`` (Point3f)."""
        return Source(self.L if self.distant else self.L - centre, eta, self.distant)

    def emission(self, centre, wavelengths):
        """What it sends to points (relative to ``centre``) by direction; None if it is the same everywhere."""
        if self.normal is not None:
            return Cosine(self.normal)
        return None if self.emitter is None else Profile(self.emitter, centre, wavelengths)


@dataclass
class Cosine:
    """The cosine at a light's surface; nothing behind its horizon. ``normal``: one, or one per camera segment."""

    normal: object

    def at(self, segment):
        """That for the camera segments ``segment`` (indices)."""
        return Cosine(lanes.of(self.normal, segment))

    def __call__(self, _P, omega_L, _d_L):
        return dr.maximum(-dr.dot(self.normal, omega_L), 0)


@dataclass
class Profile:
    """The intensity that an emitter at one point sends to points, by Mitsuba's own evaluation: spots, projectors."""

    emitter: object
    centre: object
    wavelengths: object

    def at(self, segment):
        """That for the camera segments ``segment`` (indices)."""
        return Profile(self.emitter, self.centre, lanes.of(self.wavelengths, segment))

    def __call__(self, P, _omega_L, d_L):
        _, value = _sample(self.emitter, mi.Point3f(P) + self.centre, self.wavelengths, mi.Point2f(0.5))
        return value * dr.square(d_L)


def _sample(emitter, P, wavelengths, u):
    at = dr.zeros(mi.SurfaceInteraction3f)
    at.p, at.wavelengths = P, wavelengths
    return emitter.sample_direction(at, u, True)


@dataclass
class Light:
    """An emitter. ``exact``: its one ``LightPoint``; None where points must be drawn. ``fluence``: how much of the drawn
    lights' power comes from this one (a share); ``box``: of its surface (low, high), or None."""

    name: str
    index: int
    emitter: object
    exact: object
    fluence: float = 0.0
    box: object = None

    def draw(self, u, share):
        """``LightPoint`` for random numbers ``u`` (Point2f) in the unit square; ``share``: the probability of this emitter."""
        emitter, shape = self.emitter, self.emitter.get_shape()
        share = dr.opaque(mi.Float, share)
        if shape is None:
            return _direction(emitter, u, share)
        at, weight = emitter.sample_position(mi.Float(0), u)

        def intensity(wavelengths):
            si = mi.SurfaceInteraction3f(at, wavelengths)
            si.wi = mi.Vector3f(0, 0, 1)
            return emitter.eval(si) * (weight / share)

        convex = shape if shape.class_name() in CONVEX_EMITTERS else None
        return LightPoint(mi.Point3f(at.p), False, intensity, mi.Vector3f(at.n), None, convex)


def _direction(emitter, u, share):
    """A drawn direction of an environment."""
    origin = mi.Point3f(0)
    drawn, _ = _sample(emitter, origin, visible(), u)
    return LightPoint(mi.Vector3f(drawn.d), True, lambda w: _sample(emitter, origin, w, u)[1] / share)


def read(scene, bodies, scatters):
    """``Light`` of each emitter of the scene. Those that are not supported are accepted where nothing scatters their light."""
    if not scene.emitters():
        raise SceneError('the scene has no light: add an emitter, such as <emitter type="point"/>')
    lights = []
    for emitter in scene.emitters():
        kind = emitter.class_name()
        name = describe(emitter, "emitter", f"of type {kind}")
        if emitter.get_shape() is not None:
            name = f"the {kind} emitter of {name_shape(emitter.get_shape())}"
        if not _is_known(emitter, kind):
            if scatters:
                raise refusal("emitter", name)
            continue
        for key, value in mi.traverse(emitter):
            if dr.is_array_v(value) and not np.isfinite(np.array(dr.ravel(value), dtype=float)).all():
                raise SceneError(f"{name} has a value of {key.split('.')[0]} that is not finite: correct it")
        exact = _exact(emitter, kind, name, bodies) if kind in DELTA_EMITTERS else None
        shape = emitter.get_shape()
        box = None if shape is None else tuple(np.array(x).ravel() for x in (shape.bbox().min, shape.bbox().max))
        lights.append(Light(name, len(lights), emitter, exact, box=box))
    _share_out([light for light in lights if light.exact is None], bodies)
    return lights


def _is_known(emitter, kind):
    """Whether an emitter is supported."""
    return kind in DELTA_EMITTERS or kind == "AreaLight" or mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite)


def _exact(emitter, kind, name, bodies):
    """The ``LightPoint`` of an emitter at one point or in one direction."""
    origin = mi.Point3f(0, 0, 0)
    drawn, _ = _sample(emitter, origin, visible(), mi.Point2f(0.5))

    # One power of two away, where Mitsuba divides by its square: far enough to be told from the light in float32.
    away = 2.0 ** np.ceil(np.log2(max(1.0, float(np.abs(np.array(drawn.p)).max()))))

    def value(wavelengths):
        if kind == "DirectionalEmitter":
            return _sample(emitter, origin, wavelengths, mi.Point2f(0.5))[1]
        at = mi.Point3f(drawn.p) + mi.Vector3f(0, 0, dr.opaque(mi.Float, away))
        return _sample(emitter, at, wavelengths, mi.Point2f(0.5))[1] * dr.opaque(mi.Float, away**2)

    if kind == "DirectionalEmitter":
        return LightPoint(dr.opaque(mi.Vector3f, list(np.array(drawn.d).ravel())), True, value)
    position = np.array(drawn.p, dtype=np.float64).ravel()
    for body in bodies:
        if mesh_facts.touches(body.corners, position):
            raise SceneError(
                f"{name} lies on the boundary of {body.name}: move it off, by more than 1e-6 of the body's size"
            )
    L = dr.opaque(mi.Point3f, [float(x) for x in position])
    if kind == "PointLight":
        return LightPoint(L, False, value)
    return LightPoint(L, False, lambda wavelengths: mi.Spectrum(1), emitter=emitter)


def _share_out(drawn, bodies):
    """Sets each drawn light's share: of what they bring to the bodies' centres, and a part of it evenly, since
    what brings nothing to there may still light other places."""
    if not drawn:
        return
    rng = np.random.default_rng(0)
    u = [lanes.array(mi.Float, rng.random(tolerances.LIGHT_NUMBERS)) for _ in range(2)]
    brought = np.zeros(len(drawn))
    for i, light in enumerate(drawn):
        for body in bodies or [None]:
            P = mi.Point3f(0 if body is None else mi.Point3f([float(x) for x in body.centre]))
            _, value = _sample(light.emitter, P, visible(), mi.Point2f(*u))
            # A point of a surface that the body's centre lies on gives no number.
            brought[i] += np.nan_to_num(np.array(value), posinf=0).mean()
    even = np.full(len(drawn), 1 / len(drawn))
    share = brought / brought.sum() if brought.sum() > 0 else even
    share = (1 - tolerances.EVEN_LIGHT) * share + tolerances.EVEN_LIGHT * even
    for light, x in zip(drawn, share):
        light.fluence = float(x)


def at(lights, u, v):
    """``(light, LightPoint)`` of those ``lights`` that must be drawn, for numbers u, v in [0, 1): u chooses the light by its
    share, and what it leaves of it, with v, a point."""
    lights = [light for light in lights if light.exact is None]
    end = 0.0
    for light in lights:
        start, end = end, end + light.fluence
        if u < end or light is lights[-1]:
            u = min(max((u - start) / light.fluence, 0.0), BELOW_ONE)
            return light, light.draw(dr.opaque(mi.Point2f, [u, min(v, BELOW_ONE)]), light.fluence)
    raise ValueError("no light must be drawn")


def one_each(lights, u):
    """The same for numbers ``u`` (Point2f) of many camera samples: list of ``(light, samples, points)``, where the
    ``points``' lanes are those of ``samples`` (indices)."""
    lights = [light for light in lights if light.exact is None]
    out, end = [], 0.0
    for light in lights:
        start, end = end, end + light.fluence
        low, high = dr.opaque(mi.Float, start), dr.opaque(mi.Float, 2.0 if light is lights[-1] else end)
        samples = dr.compress((u.x >= low) & (u.x < high))
        if dr.width(samples) > 0:
            x, y = lanes.gather(u.x, samples), lanes.gather(u.y, samples)
            x = dr.clip((x - low) / dr.opaque(mi.Float, light.fluence), 0, BELOW_ONE)
            out.append((light, samples, light.draw(mi.Point2f(x, y), light.fluence)))
    return out

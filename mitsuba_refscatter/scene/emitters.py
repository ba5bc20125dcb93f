"""Emitters: the lights of a scene as records. Some are one point or one direction; of the others samples must be
drawn."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..geometry import mesh as mesh_facts
from ..optics import LocalLight
from .boundaries import box_of
from .errors import SceneError, describe, name_shape
from .media import visible
from .support import DELTA_EMITTERS, refusal


@dataclass
class Emitter:
    """One emitter of a scene.

    name        how messages call it
    index       its number among those of the scene
    mi_emitter  Mitsuba's
    place       the one point (world) or direction that it is, or None where samples must be drawn
    share       how much of the power of all that must be drawn comes from this one, 0 to 1
    box         of its surface, world (low (3,), high (3,)), or None
    """

    name: str
    index: int
    mi_emitter: mi.Emitter
    place: LocalLight | None
    share: float = 0.0
    box: tuple | None = None

    @property
    def drawn(self):
        """Whether samples of it must be drawn."""
        return self.place is None


def sample_direction(mi_emitter, P, wavelengths, u):
    """``(DirectionSample3f, Spectrum)`` of Mitsuba's emitter for points P (world) and random numbers ``u``
    (Point2f)."""
    at = dr.zeros(mi.SurfaceInteraction3f)
    at.p, at.wavelengths = P, wavelengths
    return mi_emitter.sample_direction(at, u, True)


def read(scene, bodies, scatters):
    """``Emitter`` of each of the scene's. Those that are not supported are accepted where nothing scatters their
    light."""
    if not scene.emitters():
        raise SceneError('the scene has no light: add an emitter, such as <emitter type="point"/>')
    emitters = []
    for mi_emitter in scene.emitters():
        kind, shape = mi_emitter.class_name(), mi_emitter.get_shape()
        name = describe(mi_emitter, "emitter", f"of type {kind}")
        if shape is not None:
            name = f"the {kind} emitter of {name_shape(shape)}"
        if not _is_known(mi_emitter, kind):
            if scatters:
                raise refusal("emitter", name)
            continue
        for key, value in mi.traverse(mi_emitter):
            if dr.is_array_v(value) and not np.isfinite(np.array(dr.ravel(value), dtype=float)).all():
                raise SceneError(f"{name} has a value of {key.split('.')[0]} that is not finite: correct it")
        place = _place(mi_emitter, kind, name, bodies) if kind in DELTA_EMITTERS else None
        box = None if shape is None else box_of(shape)
        emitters.append(Emitter(name, len(emitters), mi_emitter, place, box=box))
    _share_out([emitter for emitter in emitters if emitter.drawn], bodies)
    return emitters


def _is_known(mi_emitter, kind):
    """Whether an emitter is supported."""
    return kind in DELTA_EMITTERS or kind == "AreaLight" or mi.has_flag(mi_emitter.flags(), mi.EmitterFlags.Infinite)


def _place(mi_emitter, kind, name, bodies):
    """The point or direction of an emitter that is one."""
    drawn, _ = sample_direction(mi_emitter, mi.Point3f(0, 0, 0), visible(), mi.Point2f(0.5))
    if kind == "DirectionalEmitter":
        return LocalLight(dr.opaque(mi.Vector3f, list(np.array(drawn.d).ravel())), True)
    position = np.array(drawn.p, dtype=np.float64).ravel()
    for body in bodies:
        if mesh_facts.touches(body.corners, position):
            raise SceneError(
                f"{name} lies on the boundary of {body.name}: move it off, by more than 1e-6 of the body's size"
            )
    return LocalLight(dr.opaque(mi.Point3f, [float(x) for x in position]))


def _share_out(drawn, bodies):
    """Sets the share of each emitter of which samples are drawn: of what they bring to the bodies' centres, and a
    part of it evenly, since what brings nothing to there may still light other places."""
    if not drawn:
        return
    rng = np.random.default_rng(0)
    u = [arrays.array(mi.Float, rng.random(tolerances.LIGHT_NUMBERS)) for _ in range(2)]
    brought = np.zeros(len(drawn))
    for i, emitter in enumerate(drawn):
        for body in bodies or [None]:
            P = mi.Point3f(0 if body is None else mi.Point3f([float(x) for x in body.centre]))
            _, value = sample_direction(emitter.mi_emitter, P, visible(), mi.Point2f(*u))
            # A point of a surface that the body's centre lies on gives no number.
            brought[i] += np.nan_to_num(np.array(value), posinf=0).mean()
    even = np.full(len(drawn), 1 / len(drawn))
    share = brought / brought.sum() if brought.sum() > 0 else even
    share = (1 - tolerances.EVEN_LIGHT) * share + tolerances.EVEN_LIGHT * even
    for emitter, x in zip(drawn, share):
        emitter.share = float(x)

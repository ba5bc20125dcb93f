"""The methods that benchmarks compare: what each renders with, and ``volpath`` restricted to the same light paths.

They are ours; our versions of the published ones, as combinations of estimator and culling; photons; light in a
straight line; and Mitsuba's ``volpath``. How our versions differ from the publications stands at the head of
``estimators.interval``, ``estimators.point`` and ``culling.spindle``.
"""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from ..integrators.hooks import Hooks, takes_hooks

METHODS = {
    "refscatter": {"type": "refscatter"},
    "holzschuch2015": {"type": "refscatter", "estimator": "interval", "culling": "spindle", "samples": 1},
    "walter2009": {"type": "refscatter", "estimator": "point", "culling": "spindle", "samples": 16},
    "photon_points": {"type": "refscatter_photons", "mode": "points", "photons": 200000, "alpha": 0.7},
    "photon_beams": {"type": "refscatter_photons", "mode": "beams", "photons": 10000, "alpha": 0.7},
    "straight_line": {"type": "refscatter_straight"},
    "volpath": {"type": "volpath"},
}
"""Integrators and their properties by the method's name; properties left out are the user's, or the defaults."""

LIGHT_RADIUS = 0.1
"""Radius, in the scene's unit, of the sphere that stands for a point light where ``volpath`` renders."""
NO_ROULETTE = 1000
"""``rr_depth`` of ``volpath``: paths are never ended at random."""


def single_scattering(method: str, internal_bounces: int, tolerance: float) -> dict:
    """Properties of one of this package's methods, for single scattering alone."""
    return {**METHODS[method], "surfaces": False, "internal_bounces": internal_bounces, "tolerance": tolerance}


def depth(sensor: mi.Sensor) -> int:
    """``max_depth`` of ``volpath`` for single scattering without internal reflections.

    It counts the camera, the way into the body if the camera is outside, the scattering, the way out, and the light.
    """
    return 4 if sensor.get_medium() is None else 3


def volpath(sensor: mi.Sensor) -> dict:
    """Properties of ``volpath`` restricted to those light paths."""
    return {**METHODS["volpath"], "max_depth": depth(sensor), "rr_depth": NO_ROULETTE}


def sphere_light(position: Sequence, intensity: Sequence, radius: float) -> dict:
    """Dictionary of a sphere of light in place of a point light of the same power.

    position   of the point light (3,), world
    intensity  of the point light, linear rgb (3,), W/sr
    radius     of the sphere, in the scene's unit

    >>> sphere_light([0, 1, 0], [np.pi, 0, 0], 2.0)["emitter"]["radiance"]["value"]
    [0.25, 0.0, 0.0]
    """
    radiance = [float(x) / (np.pi * radius**2) for x in intensity]
    return {"type": "sphere", "center": [float(x) for x in position], "radius": radius,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}}}  # fmt: skip


def position_and_intensity(light: mi.Emitter) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,), world, and intensity (3,), linear rgb in W/sr, of a point light."""
    parameters = mi.traverse(light)
    position, intensity = (np.array(parameters[key]).ravel() for key in ("position", "intensity.value"))
    return position, intensity


def for_volpath(scene: mi.Scene) -> mi.Scene:
    """The same sensor, shapes and lights with ``volpath``, and spheres in place of point lights.

    ``volpath`` can't connect to a point through a boundary that refracts, and never hits one. Other lights from one
    point or direction stay as they are, and it finds nothing of them.
    """
    sensor = scene.sensors()[0]
    parts = {"type": "scene", "integrator": volpath(sensor), "sensor": sensor}
    for i, shape in enumerate(scene.shapes()):
        parts[f"shape{i}"] = shape
    for i, emitter in enumerate(scene.emitters()):
        if emitter.get_shape() is not None:
            continue  # comes with its shape
        point = emitter.class_name() == "PointLight"
        parts[f"light{i}"] = sphere_light(*position_and_intensity(emitter), LIGHT_RADIUS) if point else emitter
    return mi.load_dict(parts, optimize=False)


def without_scattering(scene: mi.Scene) -> None:
    """Set the albedo of all media of a scene to 0."""
    parameters = mi.traverse(scene)
    for key, value in parameters:
        if "_medium.albedo." in key:
            parameters[key] = 0 * value
    parameters.update()


def quiet(integrator: mi.Integrator) -> dict:
    """Arguments of ``render`` that keep an integrator from warnings: those of this package take some."""
    return {"hooks": Hooks(silent=True)} if takes_hooks(integrator) else {}

"""The methods of comparisons: ours, our versions of the published ones as combinations of estimator and culling (departures:
the heads of ``estimators`` and ``culling.spindle``), photons, the straight line, and Mitsuba's ``volpath``."""

METHODS = {
    "refscatter": {"type": "refscatter"},
    "holzschuch2015": {"type": "refscatter", "estimator": "interval", "culling": "spindle", "samples": 1},
    "walter2009": {"type": "refscatter", "estimator": "point", "culling": "spindle", "samples": 16},
    "photon_points": {"type": "refscatter_photons", "mode": "points", "photons": 200000, "alpha": 0.7},
    "photon_beams": {"type": "refscatter_photons", "mode": "beams", "photons": 10000, "alpha": 0.7},
    "straight_line": {"type": "refscatter_straight"},
    "volpath": {"type": "volpath"},
}
"""Integrators and their properties; those left out are as the user, or the default, has them."""

LIGHT_RADIUS = 0.1
"""Radius of the sphere light that stands for a point light where ``volpath`` renders: it can't connect to a point."""


def depth(sensor):
    """``max_depth`` of ``volpath`` for the direct single scattering alone: camera, into the body if the camera is outside,
    scattering, out of the body, light."""
    return 4 if sensor.get_medium() is None else 3


def for_volpath(scene, **properties):
    """The same sensor, shapes and lights with ``volpath``; spheres of the same power in place of point lights. Other lights
    from one point or direction stay as they are: it finds no way to them through a boundary that refracts."""
    import mitsuba as mi
    import numpy as np

    sensor = scene.sensors()[0]
    integrator = {"type": "volpath", "max_depth": depth(sensor), "rr_depth": 1000, **properties}
    parts = {"type": "scene", "integrator": integrator, "sensor": sensor}
    for i, shape in enumerate(scene.shapes()):
        parts[f"shape{i}"] = shape
    for i, emitter in enumerate(scene.emitters()):
        if emitter.get_shape() is not None:
            continue
        parts[f"light{i}"] = emitter
        if emitter.class_name() == "PointLight":
            parameters = mi.traverse(emitter)
            intensity = np.array(parameters["intensity.value"]).ravel()
            radiance = {"type": "rgb", "value": [float(x) / (np.pi * LIGHT_RADIUS**2) for x in intensity]}
            parts[f"light{i}"] = {
                "type": "sphere", "center": [float(x) for x in np.array(parameters["position"]).ravel()],
                "radius": LIGHT_RADIUS, "emitter": {"type": "area", "radiance": radiance},
            }  # fmt: skip
    return mi.load_dict(parts, optimize=False)


def without_scattering(scene):
    """Sets the albedo of all media of a scene to 0."""
    import mitsuba as mi

    parameters = mi.traverse(scene)
    for key, value in parameters:
        if "_medium.albedo." in key:
            parameters[key] = 0 * value
    parameters.update()

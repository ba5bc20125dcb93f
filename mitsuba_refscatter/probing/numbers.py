"""A probe as numbers that can be read: probe.json."""

import json

import numpy as np

SCHEMA = "refscatter-probe-1"
DIGITS = 7
"""Of float32."""

UNITS = ("distances in the unit of the scene; radiance as it arrives at the camera, without the sensor's own weight, in W/(m^2 sr) for lights "
         "in W/sr, the unit of the scene for m; radiance per unit length per the unit of the scene; rgb is linear")  # fmt: skip


def text_of(probe, name=None):
    """JSON of a ``Probe``: one object, null where a number is not finite. ``name``: of the scene."""
    segments = [{"origin": s.origin, "direction": s.direction, "length": s.length, "weight": s.weight, "region": s.region}
                for s in probe.segments]  # fmt: skip
    of, samples, folded = probe.triangles, probe.samples, np.isfinite(probe.curve.fold)
    of_fold = probe.triangles.of[folded]
    data = {
        "schema": SCHEMA, "units": UNITS, "scene": name, "pixel": list(probe.pixel), "camera": probe.camera, "segments": segments,
        "segment": probe.segment, "integral": probe.integral, "estimated": probe.estimated, "unresolved": probe.unresolved,
        "lights": [{"name": x.name, "direction" if x.distant else "position": x.position} for x in probe.lights],
        "boundaries": [x.name for x in probe.boundaries],
        "triangles": [
            {"light": of.light[k], "boundary": of.boundary[k], "triangle": of.triangle[k], "x_min": of.x_min[k], "x_max": of.x_max[k],
             "integral": of.integral[k]} for k in range(len(of.triangle))
        ],
        "folds": [{"light": of.light[k], "boundary": of.boundary[k], "triangle": of.triangle[k], "distance": t}
                  for t, k in zip(probe.curve.fold[folded], of_fold)],
        "peaks": probe.peaks,
        "point_samples": {"light": samples.light, "distance": samples.distance, "radiance": samples.radiance, "estimate": samples.estimate},
        "total": {"distance": probe.distance, "radiance": probe.radiance, "straight": probe.straight},
    }  # fmt: skip
    lines = (f" {json.dumps(key)}: {json.dumps(_plain(value), allow_nan=False)}" for key, value in data.items())
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _plain(value):
    """Arrays as lists, rounded; what is not finite as None."""
    if isinstance(value, dict):
        return {key: _plain(x) for key, x in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(x) for x in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist())
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None
    return value

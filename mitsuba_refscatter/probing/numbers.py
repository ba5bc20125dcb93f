"""A probe as numbers that can be read: probe.json, and a summary of a few lines."""

from __future__ import annotations

import json

import numpy as np

from .records import Probe

SCHEMA = "refscatter-probe-1"
DIGITS = 7
"""Of float32."""

UNITS = (
    "distances in the unit of the scene; radiance as it arrives at the camera, without the sensor's own weight, in "
    "W/(m^2 sr) for lights in W/sr, the unit of the scene for m; radiance per unit length per the unit of the scene; "
    "rgb is linear"
)


def text_of(probe: Probe, name: str | None = None) -> str:
    """JSON of a probe: one object, null where a number is not finite. ``name``: of the scene."""
    of, folded = probe.triangles, np.isfinite(probe.curve.fold)

    def numbers(k):
        return {"light": of.light[k], "boundary": of.boundary[k], "triangle": of.triangle[k]}

    data = {
        "schema": SCHEMA,
        "units": UNITS,
        "scene": name,
        "pixel": list(probe.pixel),
        "camera": probe.camera,
        "segments": [vars(segment) for segment in probe.segments],
        "segment": probe.segment,
        "integral": probe.integral,
        "estimated": probe.estimated,
        "unresolved": probe.unresolved,
        "lights": [{"name": x.name, "direction" if x.distant else "position": x.position} for x in probe.lights],
        "lights_left_out": probe.left_out,
        "boundaries": [x.name for x in probe.boundaries],
        "triangles": [
            {**numbers(k), "x_min": of.x_min[k], "x_max": of.x_max[k], "integral": of.integral[k]}
            for k in range(len(of.triangle))
        ],
        "folds": [{**numbers(k), "distance": t} for t, k in zip(probe.curve.fold[folded], of.of[folded])],
        "peaks": probe.peaks,
        "point_samples": vars(probe.samples),
        "total": {"distance": probe.distance, "radiance": probe.radiance, "straight": probe.straight},
    }
    return "{\n" + ",\n".join(f" {json.dumps(key)}: {_lines(_plain(value))}" for key, value in data.items()) + "\n}\n"


def summary(probe: Probe) -> str:
    """What was found, in a few lines."""
    segment, folds = probe.segments[probe.segment], int(np.isfinite(probe.curve.fold).sum())
    return (
        f"segment {probe.segment} of {len(probe.segments)} in {segment.region}: "
        f"length {segment.length:.5g}, weight {segment.weight.mean():.3g}\n"
        f"{len(probe.triangles.triangle)} triangles, folds: {folds}, peaks: {len(probe.peaks)}\n"
        f"radiance {_row(probe.integral)}; estimator curve {_row(probe.estimated)}, "
        f"point with {len(probe.samples.distance)} samples {_row(probe.samples.estimate)}"
        + "".join(f"\nleft out, as it is not one point or direction: {name}" for name in probe.left_out)
    )


def _row(values):
    return " ".join(f"{x:.4g}" for x in values)


def _lines(value):
    """JSON of a value, objects of a list on lines of their own."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return "[\n  " + ",\n  ".join(json.dumps(x, allow_nan=False) for x in value) + "\n ]"
    return json.dumps(value, allow_nan=False)


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

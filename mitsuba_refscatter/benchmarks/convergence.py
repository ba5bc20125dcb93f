"""The estimators with more and more samples, against the curve at tolerance 0: ``refscatter convergence``.

All renders of a scene have the same camera rays, one per pixel, and single scattering without internal reflections.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from typing import TYPE_CHECKING

import mitsuba as mi

from .. import example_scenes
from ..integrators.hooks import Hooks
from . import methods, metrics, plotting, results, timing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCENES = {"bumpy_sphere": 1280, "rounded_cube": 1280, "branches": 4000}
"""Scenes and the number of triangles of their bodies, about."""

SAMPLES = {"interval": (1, 4, 16, 64), "point": (16, 64, 256, 1024, 4096, 16384)}
"""Samples per interval and per camera segment."""

CULLING = "spindle"
"""Of the estimators that are compared. The reference has its own, ``beams``, so that both are put to the test."""

FIXED = methods.single_scattering("refscatter", 0, 0.0)
"""What all renders have in common: triangles are cut as finely as for the reference."""


def run(
    scene: str, most: int, report: Callable = lambda row: None, *, variant: str, resolution: int, seed: int = 0
) -> list[dict]:
    """Rows of results for one scene, for each estimator and number of samples.

    scene       one of ``example_scenes.BODIES``
    most        largest number of samples
    report      (row) is called after each
    variant     Mitsuba's
    resolution  pixels on a side
    seed        of the renders

    ``mean_relative_error`` is the relative L1 difference to the image of the curve.
    """
    mi.set_variant(variant)
    with tempfile.TemporaryDirectory() as directory:
        path, triangles = example_scenes.write_scene(scene, directory, SCENES.get(scene))
        loaded = example_scenes.load(path, res=str(resolution))

    def render(**settings):
        integrator = mi.load_dict({**FIXED, **settings})
        image, seconds = timing.image_and_seconds(
            lambda: integrator.render(loaded, seed=seed, spp=1, hooks=Hooks(silent=True))
        )
        return image[..., :3], seconds

    reference, _ = render()
    rows = []
    for estimator, counts in SAMPLES.items():
        render(estimator=estimator, culling=CULLING, samples=counts[0])  # compiles
        for n in (n for n in counts if n <= most):
            settings = {"estimator": estimator, "culling": CULLING, "samples": n}
            image, seconds = render(**settings)
            rows.append(results.row(
                scene=scene, method=estimator, variant=variant, triangles=triangles, samples=n,
                settings={**FIXED, **settings, "resolution": resolution}, wall_seconds=seconds,
                mean_relative_error=metrics.mean_relative_error(image, reference), bias=metrics.bias(image, reference),
            ))  # fmt: skip
            report(rows[-1])
    return rows


def figure(rows: list[dict]) -> Figure:
    """Error over samples, one panel per scene."""
    names = list(dict.fromkeys(row["scene"] for row in rows))
    drawn, (panels,) = plotting.subplots(1, len(names), size=(4, 3.6), sharey=True)
    for name, panel in zip(names, panels):
        triangles = next(row["triangles"] for row in rows if row["scene"] == name)
        plotting.log_axes(panel, title=f"{name}, {triangles} triangles", xlabel="samples")
        for method, marker, unit in (("interval", "o", "interval"), ("point", "s", "camera segment")):
            line = [(row["samples"], row["mean_relative_error"]) for row in rows
                    if (row["scene"], row["method"]) == (name, method)]  # fmt: skip
            panel.plot(*zip(*line), marker=marker, label=f"{method} (per {unit})")
        panel.axhline(0.01, color="0.6", linestyle="--", linewidth=1)
        panel.annotate("1 %", (1, 0.01), xycoords=("axes fraction", "data"), xytext=(-4, 2), textcoords="offset points",
                       ha="right", color="0.4")  # fmt: skip
    panels[0].set_ylabel("relative L1 difference to curve")
    panels[0].legend()
    return drawn

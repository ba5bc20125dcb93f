"""``refscatter convergence``: the estimators with more and more samples, against the curve at tolerance 0.

For each scene the same camera rays, one per pixel; single scattering only, without internal reflections.
"""

import tempfile
import time

from .. import example_scenes as scene_files
from . import results

SCENES = {"bumpy_sphere": 1280, "rounded_cube": 1280, "branches": 4000}
"""Scenes and the number of triangles of their bodies, about."""

SAMPLES = {"interval": (1, 4, 16, 64), "point": (16, 64, 256, 1024, 4096, 16384)}
"""Samples per interval and per camera segment."""

CULLING = "spindle"
"""Of the estimators that are compared; the reference has its own, ``beams``: both are put to the test."""

FIXED = {"surfaces": False, "internal_bounces": 0, "tolerance": 0.0}
"""What all renders have in common: triangles are cut as finely as for the reference."""


def run(scene, most, report=lambda row: None, *, variant, resolution, seed=0):
    """Rows of results for one scene with up to ``most`` samples; ``report(row)`` is called after each.

    ``mean_relative_error`` is the relative L1 difference of the images, sum|a - b| / sum b.
    """
    import mitsuba as mi
    import numpy as np

    mi.set_variant(variant)
    import mitsuba_refscatter  # noqa: F401 - registers the plugin

    with tempfile.TemporaryDirectory() as directory:
        path, triangles = scene_files.write_scene(scene, directory, SCENES.get(scene))
        loaded = scene_files.load(path, res=str(resolution))

    def render(**settings):
        integrator = mi.load_dict({"type": "refscatter", **FIXED, **settings})
        start = time.perf_counter()
        image = np.array(integrator.render(loaded, seed=seed, spp=1), dtype=np.float64)
        return image[..., :3], time.perf_counter() - start

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
                mean_relative_error=np.abs(image - reference).sum() / reference.sum(),
                bias=image.sum() / reference.sum() - 1,
            ))  # fmt: skip
            report(rows[-1])
    return rows


def plot(rows, path):
    """Draws the rows: one panel per scene, error against samples; as PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = list(dict.fromkeys(row["scene"] for row in rows))
    figure, panels = pyplot.subplots(
        1, len(names), figsize=(4 * len(names), 3.6), sharey=True, squeeze=False, layout="constrained"
    )
    for name, panel in zip(names, panels[0]):
        for method, marker, unit in (("interval", "o", "interval"), ("point", "s", "camera segment")):
            line = [(row["samples"], row["mean_relative_error"]) for row in rows
                    if (row["scene"], row["method"]) == (name, method)]  # fmt: skip
            panel.loglog(*zip(*line), marker=marker, label=f"{method} (per {unit})")
        panel.axhline(0.01, color="0.6", linestyle="--", linewidth=1)
        panel.annotate("1 %", (1, 0.01), xycoords=("axes fraction", "data"), xytext=(-4, 2), textcoords="offset points",
                       ha="right", color="0.4")  # fmt: skip
        triangles = next(row["triangles"] for row in rows if row["scene"] == name)
        panel.set(title=f"{name}, {triangles} triangles", xlabel="samples")
        panel.grid(alpha=0.3)
    panels[0][0].set_ylabel("relative L1 difference to curve")
    panels[0][0].legend()
    figure.savefig(path, dpi=120)
    pyplot.close(figure)

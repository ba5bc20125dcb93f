"""``refscatter tradeoff``: what the tolerance buys. Error and time of one scene over the tolerance, and with each of the choices that it
makes switched singly.

Light points, places in the pixels and camera paths are the same in all renders: the error is that of single scattering alone,
against a render at ``REFERENCE``.
"""

import itertools
import statistics
import time
from dataclasses import dataclass

from .. import tolerances
from . import metrics, results
from .scaling import clock

TOLERANCES = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4)
DEFAULT = 0.01
REFERENCE = 0.0
IN_ROW = 3
"""Panels side by side: readable at 1280 pixels."""
CHOICES = {
    "mesh": ("coarse",),
    "visibility": ("samples_visibility",),
    "Newton": ("newton",),
    "quadrature": ("points", "guest_points"),
    "subdivision": ("bend", "linear"),
    "clipping": ("clip",),
    "weak paths": ("weight",),
}
"""What the tolerance decides, and the fields of ``tolerances.Accuracy`` that say so."""


@dataclass(frozen=True)
class Setup:
    """One measurement: ``repeats`` renders of each setting in turn after one that compiles. ``choices``: whether those of
    ``CHOICES`` are switched, too."""

    variant: str
    tolerances: tuple = TOLERANCES
    choices: bool = True
    internal_bounces: int = 4
    samples: int = 1
    repeats: int = 3


def settings(setup):
    """(name, tolerance, changes to its ``Accuracy``) of all renders: the tolerances; then the default with each choice as at
    ``REFERENCE``, and as at the loosest tolerance, where that is another one."""
    out = [(f"{tolerance:g}", tolerance, {}) for tolerance in setup.tolerances]
    if not setup.choices:
        return out
    default = tolerances.accuracy(DEFAULT)
    for other, what in ((REFERENCE, "exact"), (TOLERANCES[0], "loose")):
        accuracy = tolerances.accuracy(other)
        for choice, names in CHOICES.items():
            changes = {name: getattr(accuracy, name) for name in names}
            if any(getattr(default, name) != value for name, value in changes.items()):
                out.append((f"{choice} {what}", DEFAULT, changes))
    return out


def run(name, scene, setup, report=lambda row: None, progress=lambda fraction: None):
    """Rows of results for a loaded scene, ``report(row)`` is called with each when all of it is known, ``progress(fraction)`` after
    each render."""
    import mitsuba as mi
    import numpy as np

    from ..integrators.hooks import Hooks

    common = {
        "type": "refscatter",
        "surfaces": False,
        "internal_bounces": setup.internal_bounces,
        "aovs": "single_scatter",
    }

    def prepared(tolerance, changes):
        integrator = mi.load_dict({**common, "tolerance": tolerance})
        return lambda: integrator.render(scene, seed=0, spp=setup.samples, hooks=Hooks(accuracy=changes))

    def image(render):
        return np.array(render(), dtype=np.float64)[..., -3:]

    every = settings(setup)
    renders = [prepared(tolerance, changes) for _, tolerance, changes in every]
    first, images, done = [], [], itertools.count(1)
    total = 1 + len(every) * (1 + setup.repeats)
    reference = image(prepared(REFERENCE, {}))
    progress(next(done) / total)
    for render in renders:
        start = time.perf_counter()
        images.append(image(render))
        first.append(time.perf_counter() - start)
        progress(next(done) / total)
    times = [[] for _ in every]
    for _ in range(setup.repeats):
        for render, measured in zip(renders, times):
            measured.append(clock(render))
            progress(next(done) / total)
    rows = []
    for (what, tolerance, changes), found, measured, begin in zip(every, images, times, first):
        wall, cpu = (statistics.median(x) for x in zip(*measured))
        rows.append(results.row(
            scene=name, method=what, variant=setup.variant, samples=setup.samples, wall_seconds=wall, cpu_seconds=cpu,
            settings={**common, "tolerance": tolerance, "changes": changes}, first_seconds=begin, tolerance=tolerance,
            switched=bool(changes), **metrics.all_of(found, reference),
        ))  # fmt: skip
        report(rows[-1])
    return rows


def plot(rows, path):
    """Draws error against time: the curve over the tolerance, the default marked, and the switched choices; as PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = list(dict.fromkeys(row["scene"] for row in rows))
    across = min(len(names), IN_ROW)
    down = -(-len(names) // across)
    figure, panels = pyplot.subplots(
        down, across, figsize=(6.4 * across, 4.8 * down), squeeze=False, layout="constrained"
    )
    for panel in panels.flat[len(names) :]:
        panel.remove()
    for name, panel in zip(names, panels.flat):
        own = [row for row in rows if row["scene"] == name]
        line = [row for row in own if not row["switched"]]
        panel.loglog(*zip(*((row["wall_seconds"], row["mean_relative_error"]) for row in line)), "o-", color="C0")
        for row in line:
            _label(panel, row, row["method"], "C0")
            if row["tolerance"] == DEFAULT:
                panel.plot(row["wall_seconds"], row["mean_relative_error"], "o", color="C3", markersize=12, zorder=0)
        for k, row in enumerate(row for row in own if row["switched"]):
            panel.plot(row["wall_seconds"], row["mean_relative_error"], "x", color="0.45")
            _label(panel, row, row["method"], "0.35", -9 if k % 2 else 4)
        panel.set(title=name, xlabel="wall seconds", ylabel="relative L1 error")
        panel.grid(alpha=0.3, which="both")
    figure.suptitle("tolerances (red: the default), and the default with one choice switched", fontsize=10)
    figure.savefig(path, dpi=120, format="png")
    pyplot.close(figure)


def _label(panel, row, text, color, below=4):
    panel.annotate(text, (row["wall_seconds"], row["mean_relative_error"]), textcoords="offset points", xytext=(5, below),
                   fontsize=7, color=color)  # fmt: skip

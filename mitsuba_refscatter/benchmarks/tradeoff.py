"""What the tolerance buys: ``refscatter tradeoff``.

Error and time of one scene are measured over the tolerance, and with each of the choices that it makes switched
singly. Light points, places in the pixels and camera paths are the same in all renders. So the error is that of
single scattering alone, against a render at ``REFERENCE``.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mitsuba as mi

from .. import tolerances
from ..integrators.hooks import Hooks
from . import methods, metrics, plotting, results, timing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TOLERANCES = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4)
DEFAULT = 0.01
REFERENCE = 0.0
IN_ROW = 3
"""Panels side by side: readable at 1280 pixels."""
CHOICES = {
    "beams": ("cells",),
    "quadrature": ("along", "uneven"),
    "clipping": ("clip",),
    "weak paths": ("weight",),
}
"""What the tolerance decides, and the fields of ``tolerances.Accuracy`` that say so."""


@dataclass(frozen=True)
class Setup:
    """One measurement.

    variant           Mitsuba's
    tolerances        that are measured
    choices           whether those of ``CHOICES`` are switched, too
    internal_bounces  internal reflections of the camera ray
    samples           per pixel
    repeats           renders of each setting in turn, after one that compiles
    """

    variant: str
    tolerances: tuple[float, ...] = TOLERANCES
    choices: bool = True
    internal_bounces: int = 4
    samples: int = 1
    repeats: int = 3

    def properties(self, tolerance: float) -> dict:
        """Properties of the integrator."""
        return {**methods.single_scattering("refscatter", self.internal_bounces, tolerance), "aovs": "single_scatter"}


def settings(setup: Setup) -> list[tuple[str, float, dict]]:
    """All settings that are rendered: name, tolerance, and changes to its ``Accuracy``.

    First come the tolerances. Then comes the default, with each choice as at ``REFERENCE``, and as at the loosest
    tolerance, where that makes a difference.
    """
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


def run(
    name: str,
    scene: mi.Scene,
    setup: Setup,
    report: Callable = lambda row: None,
    progress: Callable = lambda fraction: None,
) -> list[dict]:
    """Rows of results for one scene.

    name      of the scene
    scene     loaded
    setup     what is measured
    report    (row) is called when all of a row is known
    progress  (share done) is called after each render
    """

    def prepared(integrator, changes):
        return lambda: integrator.render(scene, seed=0, spp=setup.samples, hooks=Hooks(accuracy=changes, silent=True))

    every = settings(setup)
    exact, *integrators = (mi.load_dict(setup.properties(x)) for x in (REFERENCE, *(one[1] for one in every)))
    renders = [prepared(integrator, changes) for integrator, (_, _, changes) in zip(integrators, every)]
    done, total = itertools.count(1), 1 + len(every) * (1 + setup.repeats)

    def image(render):
        found, seconds = timing.image_and_seconds(render)
        progress(next(done) / total)
        return found[..., -3:], seconds

    reference, _ = image(prepared(exact, {}))
    firsts = [image(render) for render in renders]
    times = timing.medians(renders, setup.repeats, lambda: progress(next(done) / total))
    rows = []
    for (what, tolerance, changes), integrator, (found, first), (wall, cpu) in zip(every, integrators, firsts, times):
        rows.append(results.row(
            scene=name, method=what, variant=setup.variant, samples=setup.samples, wall_seconds=wall, cpu_seconds=cpu,
            settings={**setup.properties(tolerance), "changes": changes}, first_seconds=first, tolerance=tolerance,
            switched=bool(changes), estimated_error=integrator.estimated_error, **metrics.all_of(found, reference),
        ))  # fmt: skip
        report(rows[-1])
    return rows


def figure(rows: list[dict]) -> Figure:
    """Error over time, one panel per scene: the curve over the tolerance, and the switched choices of the default."""
    names = list(dict.fromkeys(row["scene"] for row in rows))
    across = min(len(names), IN_ROW)
    drawn, panels = plotting.subplots(-(-len(names) // across), across, size=(6.4, 4.8))
    for panel in panels.flat[len(names) :]:
        panel.remove()
    for name, panel in zip(names, panels.flat):
        own = [row for row in rows if row["scene"] == name]
        line = [row for row in own if not row["switched"]]
        plotting.log_axes(panel, "both", title=name, xlabel="wall seconds", ylabel="relative L1 error")
        panel.plot(*zip(*(_place(row) for row in line)), "o-", color="C0")
        for row in line:
            _label(panel, row, "C0")
            if row["tolerance"] == DEFAULT:
                panel.plot(*_place(row), "o", color="C3", markersize=12, zorder=0)
        for k, row in enumerate(row for row in own if row["switched"]):
            panel.plot(*_place(row), "x", color="0.45")
            _label(panel, row, "0.35", -9 if k % 2 else 4)
    drawn.suptitle("tolerances (red: the default), and the default with one choice switched", fontsize=10)
    return drawn


def _place(row):
    """Where a row stands in its panel."""
    return row["wall_seconds"], row["mean_relative_error"]


def _label(panel, row, colour, above=4):
    """Write a row's name beside its mark, so many points above it."""
    panel.annotate(row["method"], _place(row), textcoords="offset points", xytext=(5, above), fontsize=7, color=colour)

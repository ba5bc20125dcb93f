"""A probe as a picture: the luminance of radiance per unit length over the distance along the segment."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..benchmarks import plotting
from ..image_io import luminance
from .colours import colours
from .records import Probe

SIZE = 12.8, 10.0
"""Width and height, inches."""

DPI = 100
"""Pixels per inch."""

ROOM = 1.25
"""Height of the picture relative to the largest mean of the total."""

DECADES = 1e-4, 10.0
"""What is shown of single triangles relative to that; their poles go beyond."""


def draw(probe: Probe, path: str | Path) -> None:
    """Draw a probe as PNG of 1280 x 1000 pixels.

    From above: the total with its peaks and the samples of the estimator ``point``; each triangle's part with its
    folds; the triangles' intervals.
    """
    size = SIZE[0], SIZE[1] / 3
    figure, panels = plotting.subplots(3, size=size, sharex=True, height_ratios=(3, 3, 1.6))
    total, triangles, intervals = panels[:, 0]
    top = ROOM * max(luminance(probe.radiance).max(), 1e-30)
    _total(total, probe, top)
    _triangles(triangles, probe, top)
    _intervals(intervals, probe)
    segment = probe.segments[probe.segment]
    intervals.set(xlim=(0, segment.length), xlabel="distance along the segment (unit of the scene)")
    figure.suptitle(
        f"pixel ({probe.pixel[0]}, {probe.pixel[1]}), segment {probe.segment} of {len(probe.segments)} in "
        f"{segment.region}: length {segment.length:.4g}, weight {segment.weight.mean():.3g}, "
        f"radiance {luminance(probe.integral):.4g} (estimator curve: {luminance(probe.estimated):.4g})",
        fontsize=11,
    )
    plotting.save(figure, path, DPI)


def _total(panel, probe, top):
    """The total, its peaks, and what the estimator ``point`` finds where it samples."""
    y = luminance(probe.radiance)
    edges = np.linspace(0, probe.segments[probe.segment].length, len(y) + 1)
    panel.stairs(y, edges, fill=True, color="0.85")
    panel.stairs(y, edges, color="black", linewidth=1, label=f"total, mean over each of {len(y)} parts", baseline=None)
    if probe.straight.any():
        panel.plot(probe.distance, luminance(probe.straight), color="C2", label="of this light that is not refracted")
    samples = probe.samples
    each = "" if len(probe.lights) == 1 else ", each of one light"
    panel.plot(samples.distance, np.minimum(luminance(samples.radiance), 0.985 * top), ".", color="C0", markersize=7,
               label=f"samples of the estimator point ({len(samples.distance)}){each}")  # fmt: skip
    panel.plot(samples.distance, np.full(len(samples.distance), -0.03 * top), "|", color="C0", markersize=7)
    height = np.interp(probe.peaks, probe.distance, y)
    panel.plot(probe.peaks, height + 0.03 * top, "v", color="C3", markersize=6, label=f"peaks ({len(probe.peaks)})")
    panel.set(ylim=(-0.06 * top, top), ylabel="radiance per unit length\n(luminance, at the camera)")
    panel.legend(fontsize=9, loc="upper right")


def _triangles(panel, probe, top):
    """Each triangle's part in its own colour, broken where its curve is, on a logarithmic scale; folds dashed."""
    curve, number = probe.curve, len(probe.triangles.triangle)
    y = luminance(curve.radiance)
    y = np.where(np.isfinite(y), y, DECADES[1] * top)
    for k, colour in enumerate(colours(number)):
        cells = np.flatnonzero(probe.triangles.of == k)
        x, z = (np.column_stack([v[cells], np.full(len(cells), np.nan)]) for v in (curve.distance, y))
        panel.plot(x.ravel(), z.ravel(), color=colour, linewidth=1.3)
    folds = curve.fold[np.isfinite(curve.fold)]
    for i, t in enumerate(folds):
        panel.axvline(t, color="0.3", linestyle="--", linewidth=0.8, label=f"folds ({len(folds)})" if i == 0 else None)
    panel.plot(folds, np.full(len(folds), 0.8 * DECADES[1] * top), "v", color="0.3", markersize=5)
    low = max(DECADES[0] * top, 0.5 * y[y > 0].min(initial=top))
    panel.set(yscale="log", ylim=(low, DECADES[1] * top), ylabel=f"the same of each of\n{number} triangles")
    if len(folds):
        panel.legend(fontsize=9, loc="upper right")


def _intervals(panel, probe):
    """The intervals, one above the other by where they begin."""
    of = probe.triangles
    order = np.argsort(of.x_min)
    tint = colours(len(order))
    panel.hlines(np.arange(len(order)), of.x_min[order], of.x_max[order], colors=[tint[k] for k in order], linewidth=2)
    panel.set(ylabel="intervals\n[x_min, x_max]", yticks=[])

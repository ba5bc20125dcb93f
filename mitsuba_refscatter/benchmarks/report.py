"""The report of comparisons: one HTML file that holds its pictures and needs nothing else."""

from __future__ import annotations

import base64
import html
from pathlib import Path

import numpy as np

from .. import image_io
from . import metrics, plotting
from .duel import Outcome

INSET = 4
"""Edge of the image relative to that of its inset."""
ERRORS = (1e-3, 1.0)
"""Ends of the logarithmic scale of error maps."""
DPI = 110
"""Pixels per inch of plots."""

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 24px auto; max-width: 1240px; padding: 0 20px; color: #222; }
h1 { font-size: 24px; } h2 { font-size: 19px; margin-top: 40px; border-top: 1px solid #ccc; padding-top: 16px; }
table { border-collapse: collapse; margin: 12px 0; font-variant-numeric: tabular-nums; font-size: 14px; }
th, td { text-align: right; padding: 3px 8px; border-bottom: 1px solid #e3e3e3; } td { white-space: nowrap; }
th { vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; }
.grid { display: grid; gap: 6px; margin: 12px 0; }
.grid div { font-size: 12px; overflow-wrap: anywhere; }
.grid img { width: 100%; image-rendering: pixelated; display: block; background: #000; }
figure { margin: 12px 0; } figure img { max-width: 100%; } p.note { color: #555; }
"""

COLUMNS = (
    ("method", "method", "{}"),
    ("samples", "samples", "{:,}"),
    ("s", "wall_seconds", "{:.2f}"),
    ("CPU s", "cpu_seconds", "{:.2f}"),
    ("warm-up s", "warm_up_seconds", "{:.1f}"),
    ("relMSE", "relmse", "{:.2e}"),
    ("L1", "mean_relative_error", "{:.2e}"),
    ("p99", "p99_relative_error", "{:.2e}"),
    ("bias", "bias", "{:+.1e}"),
    ("FLIP", "flip", "{:.3f}"),
)
"""Of the table of one scene: heading, key of the row, and format."""

EXPLANATION = (
    "<p class='note'>Each method had the same wall time after a warm-up, single scattering alone. relMSE: mean of "
    "((a - b) / max(b, 0.01 mean b))&sup2;; L1: sum |a - b| / sum b; p99: 99th percentile of |a - b| / max(b, "
    "0.01 mean b); bias: sum a / sum b - 1; FLIP: HDR-FLIP. Time to the quality of the first: &dagger; "
    "extrapolated by the power of time with which the error fell (of <code>volpath</code>: inversely with time, "
    "since its samples are independent); &mdash; where it hardly falls, or samples were too few to tell. "
    "Bidirectional path tracing has no strategy for these paths (each edge ends in a specular vertex, so that no "
    "connection exists): <code>volpath</code> stands in its place, with small spheres for points.</p>"
)


def write(path: str | Path, outcomes: list[Outcome], machine: dict, summary: str = "") -> None:
    """Write the report.

    path      of the HTML file
    outcomes  of one or more scenes
    machine   as ``results.machine`` tells it
    summary   HTML that stands before the scenes
    """
    parts = [_section(outcome) for outcome in outcomes]
    text = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>refscatter compare</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head><body>'
        f"<h1>Equal time, equal quality</h1><p>{html.escape(_machine(machine))}</p>"
        f"{EXPLANATION}{summary}{''.join(parts)}</body></html>\n"
    )
    image_io.write_file(path, lambda unfinished: unfinished.write_text(text, encoding="utf-8"))


def _machine(machine):
    return f"{machine['processor']}, {machine['cores']} cores, {machine['system']}"


def _section(outcome):
    """What the report says of one scene."""
    subject, setup = outcome.subject, outcome.setup
    about = (
        f"{subject.triangles:,} triangles, {setup.seconds:g} s per method, "
        f"{setup.internal_bounces} internal reflections, tolerance {setup.tolerance:g}, {setup.variant}. "
        f"Reference: {outcome.about}."
    )
    cells = [[*(form.format(row[key]) for _, key, form in COLUMNS), told_time(row)] for row in outcome.rows]
    heads = [head for head, _, _ in COLUMNS] + [f"s to the quality of {outcome.rows[0]['method']}"]
    return (
        f"<h2>{html.escape(subject.name)}</h2><p>{html.escape(about)}</p>{table(heads, cells)}{_pictures(outcome)}"
        f"<figure>{image_tag(plotting.png_of(_curves(outcome), DPI))}</figure>"
    )


def table(heads: list[str], rows: list[list[str]]) -> str:
    """An HTML table of cells."""
    lines = ["<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows]
    return f"<table><tr>{''.join(f'<th>{head}</th>' for head in heads)}</tr>{''.join(lines)}</table>"


def told_time(row: dict) -> str:
    """Time to the quality of the first method, as it is shown."""
    if row["seconds_to_first"] is None:
        return "&mdash;"
    return f"{row['seconds_to_first']:,.3g}" + ("&dagger;" if row["extrapolated"] else "")


def _pictures(outcome):
    """Images at one exposure, their insets, and maps of their errors."""
    images = [("reference", outcome.reference)] + [(run.method, run.image) for run in outcome.runs]
    factor, (y, x, size) = image_io.exposure(outcome.reference), _interesting(outcome.reference)
    insets = [image[y : y + size, x : x + size] for _, image in images]
    cells = [f"<b>{name}</b>{_shown(image_io.tone_map(image, factor))}" for name, image in images]
    cells += [_shown(image_io.tone_map(inset, factor)) for inset in insets]
    cells += [image_tag(plotting.png_of(plotting.colour_scale(ERRORS, "relative error"), DPI))]
    errors = [metrics.relative_error(image, outcome.reference) for _, image in images[1:]]
    cells += [_shown(plotting.false_colours(error, ERRORS)) for error in errors]
    grid = "".join(f"<div>{cell}</div>" for cell in cells)
    return f"<div class='grid' style='grid-template-columns: repeat({len(images)}, 1fr)'>{grid}</div>"


def _interesting(image):
    """Place and edge of a square inset: of those that are lit the most, the one with the strongest contrast."""
    size = max(1, min(image.shape[:2]) // INSET)
    step = max(1, size // 4)
    brightness = image.mean(axis=-1) + metrics.DARK * image.mean()
    lit, edges = brightness > 0.1 * image.mean(), np.zeros(brightness.shape)
    for axis in range(2):
        edges += np.abs(np.gradient(np.log(brightness), axis=axis)) if brightness.shape[axis] > 1 else 0
    places = [
        (y, x) for y in range(0, image.shape[0] - size + 1, step) for x in range(0, image.shape[1] - size + 1, step)
    ]

    def window(of, place):
        return of[place[0] : place[0] + size, place[1] : place[1] + size].mean()

    return (*max(places, key=lambda place: (window(lit, place), window(edges, place))), size)


def _curves(outcome):
    """Figure of relMSE over time."""
    figure, ((panel,),) = plotting.subplots(size=(8, 4.6))
    plotting.log_axes(panel, xlabel="wall seconds", ylabel="relMSE")
    for run in outcome.runs:
        panel.plot(*zip(*run.curve), marker=".", label=run.method)
    figure.legend(loc="outside right upper")
    return figure


def _shown(pixels):
    """An image of 8 bits (H, W, 3) as HTML that holds it."""
    return image_tag(plotting.png_of_pixels(pixels))


def image_tag(png: bytes) -> str:
    """A PNG as HTML that holds it."""
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(png).decode()}">'

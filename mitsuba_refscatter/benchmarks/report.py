"""The report of comparisons: one HTML file that holds its pictures and needs nothing else."""

import base64
import html
import io

from .. import image_io
from . import metrics

INSET = 4
"""Edge of the image relative to that of its inset."""
ERRORS = (1e-3, 1.0)
"""Ends of the logarithmic scale of error maps."""

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
    ("method", "method", "{}"), ("samples", "samples", "{:,}"), ("s", "wall_seconds", "{:.2f}"), ("CPU s", "cpu_seconds", "{:.2f}"),
    ("warm-up s", "warm_up_seconds", "{:.1f}"), ("relMSE", "relmse", "{:.2e}"), ("L1", "mean_relative_error", "{:.2e}"),
    ("p99", "p99_relative_error", "{:.2e}"), ("bias", "bias", "{:+.1e}"), ("FLIP", "flip", "{:.3f}"),
)  # fmt: skip


def pyplot():
    """matplotlib's, without a display."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def write(path, outcomes, machine, summary=""):
    """Writes the report on ``duel.Outcome``s. ``summary``: HTML that stands before them."""
    parts = [_section(outcome) for outcome in outcomes]
    text = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>refscatter compare</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head><body>'
        f"<h1>Equal time, equal quality</h1><p>{html.escape(_machine(machine))}</p>{EXPLANATION}{summary}{''.join(parts)}</body></html>\n"
    )
    image_io.write_file(path, lambda unfinished: unfinished.write_text(text, encoding="utf-8"))


EXPLANATION = (
    "<p class='note'>Each method had the same wall time after a warm-up, single scattering alone. relMSE: mean of ((a - b) / max(b, "
    "0.01 mean b))&sup2;; L1: sum |a - b| / sum b; p99: 99th percentile of |a - b| / max(b, 0.01 mean b); bias: sum a / sum b - 1; "
    "FLIP: HDR-FLIP. Time to the quality of the first: &dagger; extrapolated by the power of time with which the error fell (of "
    "<code>volpath</code>: inversely with time, since its samples are independent); &mdash; where it hardly falls, or samples were too few to tell. Bidirectional path tracing has no strategy for these paths (each edge ends in a "
    "specular vertex, so that no connection exists): <code>volpath</code> stands in its place, with small spheres for points.</p>"
)


def _machine(machine):
    return f"{machine['processor']}, {machine['cores']} cores, {machine['system']}"


def _section(outcome):
    subject, setup = outcome.subject, outcome.setup
    about = (f"{subject.triangles:,} triangles, {setup.seconds:g} s per method, {setup.internal_bounces} internal reflections, tolerance "
             f"{setup.tolerance:g}, {setup.variant}. Reference: {outcome.about}.")  # fmt: skip
    return (
        f"<h2>{html.escape(subject.name)}</h2><p>{html.escape(about)}</p>{table(outcome.rows)}{_pictures(outcome)}"
        f"<figure>{image_tag(_curves(outcome))}</figure>"
    )


def table(rows):
    """The rows of one scene as an HTML table."""
    lines = []
    for row in rows:
        cells = [form.format(row[key]) for _, key, form in COLUMNS]
        lines.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in [*cells, told_time(row)]) + "</tr>")
    heads = [head for head, _, _ in COLUMNS] + [f"s to the quality of {rows[0]['method']}"]
    return f"<table><tr>{''.join(f'<th>{head}</th>' for head in heads)}</tr>{''.join(lines)}</table>"


def told_time(row):
    """Time to the quality of the first method, as it is shown."""
    if row["seconds_to_first"] is None:
        return "&mdash;"
    return f"{row['seconds_to_first']:,.3g}" + ("&dagger;" if row["extrapolated"] else "")


def _pictures(outcome):
    """Images at one exposure, their insets, and maps of their errors."""
    images = [("reference", outcome.reference)] + [(run.method, run.image) for run in outcome.runs]
    factor, (y, x, size) = image_io.exposure(outcome.reference), _interesting(outcome.reference)
    cells = [f"<div><b>{name}</b>{image_tag(_png(image_io.tone_map(image, factor)))}</div>" for name, image in images]
    cells += [
        f"<div>{image_tag(_png(image_io.tone_map(image[y : y + size, x : x + size], factor)))}</div>"
        for _, image in images
    ]
    cells += [f"<div>{image_tag(_scale())}</div>"]
    cells += [f"<div>{image_tag(_png(_false_colour(image, outcome.reference)))}</div>" for _, image in images[1:]]
    return f"<div class='grid' style='grid-template-columns: repeat({len(images)}, 1fr)'>{''.join(cells)}</div>"


def _interesting(image):
    """Place and edge of the square with the strongest contrast between neighbours, of those that are lit as far as any is."""
    import numpy as np

    size = max(1, min(image.shape[:2]) // INSET)
    step = max(1, size // 4)
    light = image.mean(axis=-1) + metrics.DARK * image.mean()
    lit, edges = light > 0.1 * image.mean(), np.zeros(light.shape)
    for axis in range(2):
        edges += np.abs(np.gradient(np.log(light), axis=axis)) if light.shape[axis] > 1 else 0
    places = [
        (y, x) for y in range(0, image.shape[0] - size + 1, step) for x in range(0, image.shape[1] - size + 1, step)
    ]

    def window(of, place):
        return of[place[0] : place[0] + size, place[1] : place[1] + size].mean()

    return (*max(places, key=lambda place: (window(lit, place), window(edges, place))), size)


def _false_colour(image, reference):
    import numpy as np
    from matplotlib import colormaps

    low, high = np.log(ERRORS)
    level = (np.log(np.maximum(metrics.relative_error(image, reference), ERRORS[0])) - low) / (high - low)
    return np.round(255 * colormaps["inferno"](np.clip(level, 0, 1))[..., :3]).astype(np.uint8)


def _scale():
    """The scale of the error maps."""
    from matplotlib import cm, colors

    plots = pyplot()
    figure, panel = plots.subplots(figsize=(2, 2), layout="constrained")
    panel.axis("off")
    bar = figure.colorbar(cm.ScalarMappable(colors.LogNorm(*ERRORS), "inferno"), ax=panel, fraction=0.9, aspect=7)
    bar.set_label("relative error", fontsize=13)
    bar.ax.tick_params(labelsize=12)
    return _saved(figure)


def _curves(outcome):
    """relMSE over time."""
    plots = pyplot()
    figure, panel = plots.subplots(figsize=(8, 4.6), layout="constrained")
    for run in outcome.runs:
        panel.loglog(*zip(*run.curve), marker=".", label=run.method)
    panel.set(xlabel="wall seconds", ylabel="relMSE")
    panel.grid(alpha=0.3)
    figure.legend(loc="outside right upper")
    return _saved(figure)


def _saved(figure):
    """PNG of a figure, as bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=110, format="png")
    pyplot().close(figure)
    return buffer.getvalue()


def _png(pixels):
    """PNG of 8-bit pixels, as bytes."""
    from matplotlib import image

    buffer = io.BytesIO()
    image.imsave(buffer, pixels, format="png")
    return buffer.getvalue()


def image_tag(png):
    """A PNG (bytes) as HTML that holds it."""
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(png).decode()}">'

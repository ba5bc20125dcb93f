"""All plots of the tools: figures without a display, their look, false colours, and PNG to a file or as bytes."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 120
"""Pixels per inch of plots that are files of their own."""
GRID = 0.3
"""Opacity of grid lines."""
COLOURS = "inferno"
"""Colour map of error maps."""


def _pyplot():
    """matplotlib's, without a display; imported late, as matplotlib is an extra."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def subplots(rows: int = 1, columns: int = 1, *, size: tuple[float, float], **more) -> tuple[Figure, np.ndarray]:
    """Make a figure; return it and its panels, an array (rows, columns).

    rows     panels one above the other
    columns  panels side by side
    size     width and height of each panel, inches
    more     what else ``pyplot.subplots`` takes
    """
    inches = size[0] * columns, size[1] * rows
    return _pyplot().subplots(rows, columns, figsize=inches, squeeze=False, layout="constrained", **more)


def log_axes(panel: Axes, which: str = "major", **labels) -> None:
    """Make both axes of a panel logarithmic, with a grid.

    which   grid lines: "major", or "both" for the minor ones, too
    labels  what ``Axes.set`` takes: title, xlabel, ylabel
    """
    panel.set(xscale="log", yscale="log", **labels)
    panel.grid(which=which, alpha=GRID)


def save(figure: Figure, path: str | Path | BinaryIO, dpi: int = DPI) -> None:
    """Write a figure as PNG to a path or an open file, and close it."""
    figure.savefig(path, dpi=dpi, format="png")
    _pyplot().close(figure)


def png_of(figure: Figure, dpi: int) -> bytes:
    """The PNG of a figure, which is closed."""
    buffer = io.BytesIO()
    save(figure, buffer, dpi)
    return buffer.getvalue()


def png_of_pixels(pixels: np.ndarray) -> bytes:
    """The PNG of an image of 8 bits (H, W, 3)."""
    from matplotlib import image

    buffer = io.BytesIO()
    image.imsave(buffer, pixels, format="png")
    return buffer.getvalue()


def false_colours(values: np.ndarray, ends: tuple[float, float]) -> np.ndarray:
    """An image of 8 bits (H, W, 3) of positive ``values`` (H, W), on a logarithmic scale between ``ends``."""
    from matplotlib import colormaps

    low, high = np.log(ends)
    level = (np.log(np.maximum(values, ends[0])) - low) / (high - low)
    return np.round(255 * colormaps[COLOURS](np.clip(level, 0, 1))[..., :3]).astype(np.uint8)


def colour_scale(ends: tuple[float, float], label: str) -> Figure:
    """The scale of ``false_colours`` between the same ``ends``, as a small figure."""
    from matplotlib import cm, colors

    figure, ((panel,),) = subplots(size=(2, 2))
    panel.axis("off")
    bar = figure.colorbar(cm.ScalarMappable(colors.LogNorm(*ends), COLOURS), ax=panel, fraction=0.9, aspect=7)
    bar.set_label(label, fontsize=13)
    bar.ax.tick_params(labelsize=12)
    return figure

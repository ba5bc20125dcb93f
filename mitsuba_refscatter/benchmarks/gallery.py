"""The pictures of scenes in the READMEs, as strips of square tiles: ``refscatter gallery``."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import mitsuba as mi
import numpy as np

from .. import example_scenes, image_io
from ..integrators.hooks import Hooks
from . import duel, race
from .methods import METHODS
from .suite import Case

SCENES = ("bumpy_sphere", "branches", "underwater", "amber")
DENSITIES = (2, 8, 32, 128)
TRIANGLES = 20480
GAP = 4
"""White pixels between tiles."""


def scenes(size: int, samples: int) -> list[list[np.ndarray]]:
    """One row of tiles, of ``size`` pixels on a side: scenes of this package, with so many samples per pixel."""
    row = []
    for name in SCENES:
        with tempfile.TemporaryDirectory() as files:
            scene = example_scenes.load(example_scenes.write_scene(name, files)[0], res=str(size))
        row.append(
            image_io.tone_map(
                np.array(scene.integrator().render(scene, spp=samples, hooks=Hooks(silent=True)))[..., :3]
            )
        )
    return [row]


def densities(size: int, samples: int) -> list[list[np.ndarray]]:
    """Two rows of tiles: single scattering for growing density, by ours and below by light in a straight line.

    Each pair is shown at one exposure.
    """
    rows = [], []
    for density in DENSITIES:
        case = Case(f"density_{density}", "bumpy_sphere", TRIANGLES, density=density)
        with tempfile.TemporaryDirectory() as files:
            scene = case.subject(files, size).load()
        integrators = [mi.load_dict({**METHODS[name], "surfaces": False}) for name in ("refscatter", "straight_line")]
        images = [
            np.array(x.render(scene, spp=samples, hooks=Hooks(silent=True)), dtype=np.float64)[..., :3]
            for x in integrators
        ]
        for row, image in zip(rows, images):
            row.append(image_io.tone_map(image, image_io.exposure(images[0])))
    return list(rows)


def methods(size: int, setup: race.Setup) -> list[list[np.ndarray]]:
    """One row of tiles: single scattering by all methods in the same time, at the same exposure."""
    with tempfile.TemporaryDirectory() as files:
        subject = Case("methods", "bumpy_sphere", TRIANGLES).subject(files, size)
        outcome = duel.compare(subject, list(METHODS), setup)
    factor = image_io.exposure(outcome.reference)
    return [[image_io.tone_map(run.image, factor) for run in outcome.runs]]


def strip(rows: list[list[np.ndarray]]) -> np.ndarray:
    """Rows of tiles (H, W, 3), 8 bits each, as one image."""

    def spaced(tiles, axis):
        gap = np.full([GAP if k == axis else n for k, n in enumerate(tiles[0].shape)], 255, dtype=np.uint8)
        return np.concatenate([part for tile in tiles for part in (gap, tile)][1:], axis=axis)

    return spaced([spaced(row, 1) for row in rows], 0)


def write(
    directory: str | Path, size: int, samples: int, setup: race.Setup, report: Callable = lambda name: None
) -> list[Path]:
    """Write ``scenes.png``, ``densities.png`` and ``methods.png``; return their paths.

    directory  where they go
    size       pixels on a side of a tile
    samples    per pixel, of ours
    setup      of the strip of methods
    report     (name) is called before each
    """
    strips = {
        "scenes": lambda: scenes(size, samples),
        "densities": lambda: densities(size, samples),
        "methods": lambda: methods(size, setup),
    }
    paths = []
    for name, make in strips.items():
        report(name)
        path = image_io.directory(directory) / f"{name}.png"
        image = mi.Bitmap(strip(make()))
        image_io.write_file(path, lambda unfinished, image=image: image.write(str(unfinished)))
        paths.append(path)
    return paths

"""``refscatter gallery``: the pictures of the README, as strips of square tiles."""

import tempfile
from pathlib import Path

from .. import example_scenes as scene_files
from .. import image_io
from . import duel, race
from .methods import METHODS
from .suite import Case

SCENES = ("bumpy_sphere", "branches", "underwater", "amber")
DENSITIES = (2, 8, 32, 128)
GAP = 4
"""White pixels between tiles."""


def scenes(size, samples):
    """The scenes of this package, one row."""
    import numpy as np

    row = []
    for name in SCENES:
        with tempfile.TemporaryDirectory() as files:
            scene = scene_files.load(scene_files.write_scene(name, files)[0], res=str(size))
        row.append(image_io.tone_map(np.array(scene.integrator().render(scene, spp=samples))[..., :3]))
    return [row]


def densities(size, samples):
    """Single scattering for growing density: ours, and below it by light in a straight line, each pair at one exposure."""
    import mitsuba as mi
    import numpy as np

    ours, straight = [], []
    for density in DENSITIES:
        with tempfile.TemporaryDirectory() as files:
            scene = Case(f"density_{density}", "bumpy_sphere", 20480, density=density).subject(Path(files), size).load()
        a, b = (
            np.array(mi.load_dict({**METHODS[name], "surfaces": False}).render(scene, spp=samples), dtype=np.float64)[
                ..., :3
            ]
            for name in ("refscatter", "straight_line")
        )
        factor = image_io.exposure(a)
        ours.append(image_io.tone_map(a, factor))
        straight.append(image_io.tone_map(b, factor))
    return [ours, straight]


def methods(size, setup):
    """Single scattering by all methods in the same time (``race.Setup``), at the same exposure, one row."""
    with tempfile.TemporaryDirectory() as files:
        outcome = duel.compare(Case("methods", "bumpy_sphere", 20480).subject(Path(files), size), list(METHODS), setup)
    factor = image_io.exposure(outcome.reference)
    return [[image_io.tone_map(run.image, factor) for run in outcome.runs]]


def strip(rows):
    """Rows of tiles (H, W, 3), 8 bits each, as one image."""
    import numpy as np

    def spaced(tiles, axis):
        gap = np.full([GAP if k == axis else n for k, n in enumerate(tiles[0].shape)], 255, dtype=np.uint8)
        return np.concatenate([part for tile in tiles for part in (gap, tile)][1:], axis=axis)

    return spaced([spaced(row, 1) for row in rows], 0)


def write(directory, size, samples, variant, seconds, report=lambda name: None):
    """Writes ``scenes.png``, ``densities.png`` and ``methods.png``; returns their paths. ``report(name)`` is called before each."""
    import mitsuba as mi

    setup, paths = race.Setup(variant, seconds), []
    for name, make in (("scenes", lambda: scenes(size, samples)), ("densities", lambda: densities(size, samples)),
                       ("methods", lambda: methods(size, setup))):  # fmt: skip
        report(name)
        path = image_io.directory(directory) / f"{name}.png"
        image = mi.Bitmap(strip(make()))
        image_io.write_file(path, lambda unfinished, image=image: image.write(str(unfinished)))
        paths.append(path)
    return paths

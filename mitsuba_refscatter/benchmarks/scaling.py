"""Cost over the number of triangles, in samples of ``volpath``: ``refscatter scaling``.

Each size runs in a process of its own, so that peak memory is its own. There all methods render the same body, view and
size of image, once to compile and then ``repeats`` times in turn. Medians are reported.
"""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import resource
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mitsuba as mi
import numpy as np

from .. import example_scenes
from ..integrators.hooks import Hooks
from . import methods, metrics, plotting, results, timing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZES = (1280, 5120, 20480, 81920, 327680, 1310720)
EXACT_MESH = "refscatter_exact_mesh"
"""``refscatter`` with the body's own triangles as first cells, at the same tolerance."""
OURS = ("refscatter", EXACT_MESH, *(method for method in methods.METHODS if method not in ("refscatter", "volpath")))
NO_PAIRS = {"rays": None, "candidates_per_ray": None, "contributing_per_ray": None}
"""In the rows of methods that have no pairs of ray and triangle."""


@dataclass(frozen=True)
class Setup:
    """One measurement.

    scene             one of ``example_scenes.BODIES``
    triangles         of its body, about
    variant           Mitsuba's
    resolution        pixels on a side
    samples           of ``volpath``, per pixel; ours have one
    repeats           renders of each method that count
    internal_bounces  internal reflections of ours; ``volpath`` has none
    tolerance         of ``refscatter``
    methods           names of ours
    """

    scene: str = "bumpy_sphere"
    triangles: int = 20480
    variant: str = "llvm_ad_rgb"
    resolution: int = 256
    samples: int = 64
    repeats: int = 5
    internal_bounces: int = 0
    tolerance: float = 0.01
    methods: tuple[str, ...] = OURS

    def settings(self, method: str) -> dict:
        """Properties of a method's integrator."""
        name = "refscatter" if method == EXACT_MESH else method
        return methods.single_scattering(name, self.internal_bounces, self.tolerance)

    def integrator(self, method: str, **properties) -> mi.Integrator:
        """A method's integrator, with other ``properties`` in place of its own."""
        return mi.load_dict({**self.settings(method), **properties})

    def hooks(self, method: str) -> Hooks:
        """Those of a method's renders."""
        return Hooks(accuracy={"coarse": False} if method == EXACT_MESH else {}, silent=True)


def measure(setup: Setup) -> list[dict]:
    """Measure one size in this process; return a row of results for each method, ``volpath`` last.

    ``mean_relative_error`` is the relative L1 difference to the image by ``curve`` at tolerance 0.
    """
    mi.set_variant(setup.variant)
    with tempfile.TemporaryDirectory() as directory:
        path, triangles = example_scenes.write_scene(setup.scene, directory, setup.triangles)
        scene = example_scenes.load(path, res=str(setup.resolution))
    rows, renders, images = [], {}, {}
    for method in setup.methods:
        settings, integrator, hooks = setup.settings(method), setup.integrator(method), setup.hooks(method)
        renders[method] = lambda integrator=integrator, hooks=hooks: integrator.render(scene, spp=1, hooks=hooks)
        images[method], first = timing.image_and_seconds(renders[method])
        # The first method's peak is its own; the others' are hidden behind it.
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 if not rows else None
        pairs = _pairs(scene, setup, method, integrator.cache) if settings["type"] == "refscatter" else NO_PAIRS
        own = {"first_seconds": first, "peak_memory_bytes": memory}
        rows.append({**_row(setup, triangles, method, settings), **pairs, **own})
    exact = setup.integrator("refscatter", tolerance=0.0)
    truth = np.array(exact.render(scene, spp=1, hooks=Hooks(silent=True)), dtype=np.float64)
    for row in rows:
        row["mean_relative_error"] = metrics.mean_relative_error(images[row["method"]], truth)
    with_volpath = methods.for_volpath(scene)
    renders["volpath"] = lambda: with_volpath.integrator().render(with_volpath, spp=setup.samples)
    renders["volpath"]()
    settings = {
        "type": "volpath", "max_depth": methods.depth(scene.sensors()[0]), "light_radius": methods.LIGHT_RADIUS,
    }  # fmt: skip
    rows.append({**_row(setup, triangles, "volpath", settings), "samples": setup.samples})
    for row, (wall, cpu) in zip(rows, timing.medians(renders.values(), setup.repeats)):
        row["wall_seconds"], row["cpu_seconds"] = wall, cpu
    volpath = rows[-1]
    for row in rows[:-1]:
        for kind in ("wall", "cpu"):
            ratio = row[f"{kind}_seconds"] / volpath[f"{kind}_seconds"]
            row[f"volpath_samples_of_same_{kind}_time"] = ratio * setup.samples
    return rows


def _row(setup, triangles, method, settings):
    """A row of results, of one sample per pixel."""
    return results.row(scene=setup.scene, method=method, variant=setup.variant, triangles=triangles, samples=1,
                       settings={**settings, "resolution": setup.resolution})  # fmt: skip


def _pairs(scene, setup, method, cache):
    """Rays that enter the body, and how many candidate and contributing pairs each has in the mean.

    cache  the ``Cache`` of an integrator that has rendered the scene
    """
    integrator, hooks = setup.integrator(method, aovs="candidates,contributions"), setup.hooks(method)
    integrator.cache = cache
    image = np.array(integrator.render(scene, spp=1, hooks=hooks), dtype=np.float64)
    rays = max(hooks.counts.segments, 1)
    candidates, contributions = image[..., -2].sum() / rays, image[..., -1].sum() / rays
    return {"rays": rays, "candidates_per_ray": candidates, "contributing_per_ray": contributions}


def run(sizes: Iterable[int], **setup) -> Iterator[list[dict]]:
    """Measure numbers of triangles, each in a fresh process; yield the rows of each. ``setup``: fields of ``Setup``."""
    context = multiprocessing.get_context("spawn")
    for triangles in sizes:
        with concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as pool:
            yield pool.submit(measure, Setup(triangles=triangles, **setup)).result()


def exponents(rows: list[dict]) -> dict[tuple[str, str], float]:
    """The power of the number of triangles with which costs grow, from two sizes on, by method and kind of cost.

    The kinds are wall time per sample, and candidate and contributing pairs per ray.

    >>> rows = [{"method": "x", "triangles": n, "samples": 1, "wall_seconds": 0.01 * n**0.5} for n in (80, 320, 1280)]
    >>> {key: round(power, 3) for key, power in exponents(rows).items()}
    {('x', 'wall_seconds'): 0.5}
    """
    out = {}
    for method in dict.fromkeys(row["method"] for row in rows):
        of_method = [row for row in rows if row["method"] == method]
        for key in ("wall_seconds", "candidates_per_ray", "contributing_per_ray"):
            points = [
                (row["triangles"], row[key] / (row["samples"] if key == "wall_seconds" else 1))
                for row in of_method
                if row.get(key)
            ]
            if len({x for x, _ in points}) > 1:
                out[method, key] = float(np.polyfit(*np.log(np.array(points).T), 1)[0])
    return out


def _pixels(row):
    """Pixels of an image: its settings hold the edge, or width and height."""
    resolution = row["settings"]["resolution"]
    return resolution**2 if isinstance(resolution, int) else resolution[0] * resolution[1]


def figure(rows: list[dict]) -> Figure:
    """Wall time per pixel sample over the number of triangles, with each method's exponent."""
    powers = exponents(rows)
    drawn, ((panel,),) = plotting.subplots(size=(7, 4.5))
    plotting.log_axes(panel, xlabel="triangles", ylabel="wall seconds per pixel sample")
    for method in dict.fromkeys(row["method"] for row in rows):
        line = sorted(
            (row["triangles"], row["wall_seconds"] / row["samples"] / _pixels(row))
            for row in rows
            if row["method"] == method
        )
        power = powers.get((method, "wall_seconds"))
        panel.plot(*zip(*line), marker="o", label=method if power is None else f"{method}: {power:.2f}")
    drawn.legend(loc="outside right upper", title="exponent")
    return drawn

"""``refscatter scaling``: cost against the number of triangles, in samples of ``volpath``.

Each size runs in a process of its own, so that peak memory is its own. In that process all methods render the
same body, view and size of image, once to compile and then ``repeats`` times in turn; medians are reported.
"""

import concurrent.futures
import multiprocessing
import resource
import statistics
import tempfile
import time
from dataclasses import dataclass

from .. import example_scenes as scene_files
from .. import missing
from . import results
from .methods import LIGHT_RADIUS, METHODS, depth, for_volpath

SIZES = (1280, 5120, 20480, 81920, 327680, 1310720)
EXACT_MESH = "refscatter_exact_mesh"
"""``refscatter`` by the body's own mesh, none coarser; else as at the same tolerance."""
OURS = ("refscatter", EXACT_MESH, *(method for method in METHODS if method not in ("refscatter", "volpath")))


@dataclass(frozen=True)
class Setup:
    """One measurement: ``methods`` of ours against ``volpath`` with ``samples`` per pixel."""

    scene: str = "bumpy_sphere"
    triangles: int = 20480
    variant: str = "llvm_ad_rgb"
    resolution: int = 256
    samples: int = 64
    repeats: int = 5
    internal_bounces: int = 0
    tolerance: float = 0.01
    methods: tuple = OURS

    def settings(self, method):
        """Properties of a method's integrator."""
        common = {"surfaces": False, "internal_bounces": self.internal_bounces, "tolerance": self.tolerance}
        return {**common, **METHODS["refscatter" if method == EXACT_MESH else method]}

    def integrator(self, method, **properties):
        """A method's integrator, with other ``properties`` in place of its own."""
        import mitsuba as mi

        return mi.load_dict({**self.settings(method), **properties})

    def hooks(self, method):
        """``Hooks`` of a method's renders."""
        from ..integrators.hooks import Hooks

        return Hooks(accuracy={"coarse": 0.0} if method == EXACT_MESH else {})


def measure(setup):
    """Measures one size in this process; returns a row of results for each method, ``volpath`` last.

    ``mean_relative_error``: relative L1 difference to the image by ``curve`` at tolerance 0.
    """
    import mitsuba as mi
    import numpy as np

    mi.set_variant(setup.variant)
    import mitsuba_refscatter  # noqa: F401 - registers the plugin

    missing.silent = True  # in this process
    with tempfile.TemporaryDirectory() as directory:
        path, triangles = scene_files.write_scene(setup.scene, directory, setup.triangles)
        scene = scene_files.load(path, res=str(setup.resolution))
    rows, render, images = [], {}, {}
    for method in setup.methods:
        settings, integrator, hooks = setup.settings(method), setup.integrator(method), setup.hooks(method)
        render[method] = lambda integrator=integrator, hooks=hooks: integrator.render(scene, spp=1, hooks=hooks)
        start = time.perf_counter()
        images[method] = np.array(render[method](), dtype=np.float64)
        first = time.perf_counter() - start
        # The first method's peak is its own; the others' are hidden behind it.
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 if not rows else None
        pairs = _pairs(scene, setup, method, integrator.cache) if settings["type"] == "refscatter" else NO_PAIRS
        own = {"first_seconds": first, "peak_memory_bytes": memory}
        rows.append({**_row(setup, triangles, method, settings, 1), **pairs, **own})
    exact = setup.integrator("refscatter", tolerance=0.0)
    truth = np.array(exact.render(scene, spp=1), dtype=np.float64)
    for row in rows:
        row["mean_relative_error"] = np.abs(images[row["method"]] - truth).sum() / truth.sum()
    reference = for_volpath(scene)
    render["volpath"] = lambda: reference.integrator().render(reference, spp=setup.samples)
    render["volpath"]()
    settings = {"type": "volpath", "max_depth": depth(scene.sensors()[0]), "light_radius": LIGHT_RADIUS}
    rows.append(_row(setup, triangles, "volpath", settings, setup.samples))
    times = {method: [] for method in render}
    for _ in range(setup.repeats):
        for method, work in render.items():
            times[method].append(clock(work))
    for row in rows:
        row["wall_seconds"], row["cpu_seconds"] = (statistics.median(x) for x in zip(*times[row["method"]]))
    volpath = rows[-1]
    for row in rows[:-1]:
        for kind in ("wall", "cpu"):
            ratio = row[f"{kind}_seconds"] / volpath[f"{kind}_seconds"]
            row[f"volpath_samples_of_same_{kind}_time"] = ratio * setup.samples
    return rows


def _row(setup, triangles, method, settings, samples):
    return results.row(scene=setup.scene, method=method, variant=setup.variant, triangles=triangles,
                       settings={**settings, "resolution": setup.resolution}, samples=samples)  # fmt: skip


def run(sizes, **setup):
    """Measures all sizes, each in a fresh process; yields the rows of each."""
    context = multiprocessing.get_context("spawn")
    for triangles in sizes:
        with concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as pool:
            yield pool.submit(measure, Setup(triangles=triangles, **setup)).result()


NO_PAIRS = {"rays": None, "candidates_per_ray": None, "contributing_per_ray": None}


def _pairs(scene, setup, method, cache):
    """Rays that enter the body, and the candidate and contributing pairs that each has in the mean. ``cache``: of the scene."""
    import numpy as np

    integrator, hooks = setup.integrator(method, aovs="candidates,contributions"), setup.hooks(method)
    integrator.cache = cache
    image = np.array(integrator.render(scene, spp=1, hooks=hooks), dtype=np.float64)
    rays = max(hooks.counts.segments, 1)
    candidates, contributions = image[..., -2].sum() / rays, image[..., -1].sum() / rays
    return {"rays": rays, "candidates_per_ray": candidates, "contributing_per_ray": contributions}


def clock(work):
    """Wall and CPU seconds of a render, to the last kernel."""
    import drjit as dr

    wall, cpu = time.perf_counter(), time.process_time()
    dr.eval(work())
    dr.sync_thread()
    return time.perf_counter() - wall, time.process_time() - cpu


def exponents(rows):
    """Per method the power of the number of triangles with which wall time per sample grows, from two sizes on; and per kind
    of pair that ``refscatter`` has.

    >>> rows = [{"method": "x", "triangles": n, "samples": 1, "wall_seconds": 0.01 * n**0.5} for n in (80, 320, 1280)]
    >>> {key: round(power, 3) for key, power in exponents(rows).items()}
    {('x', 'wall_seconds'): 0.5}
    """
    import numpy as np

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


def plot(rows, path):
    """Draws wall time per pixel sample against the number of triangles, with each method's exponent; as PNG, to a path or
    an open file."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    powers = exponents(rows)
    figure, panel = pyplot.subplots(figsize=(7, 4.5), layout="constrained")
    for method in dict.fromkeys(row["method"] for row in rows):
        line = sorted(
            (row["triangles"], row["wall_seconds"] / row["samples"] / _pixels(row))
            for row in rows
            if row["method"] == method
        )
        power = powers.get((method, "wall_seconds"))
        panel.loglog(*zip(*line), marker="o", label=method if power is None else f"{method}: {power:.2f}")
    panel.set(xlabel="triangles", ylabel="wall seconds per pixel sample")
    panel.grid(alpha=0.3)
    figure.legend(loc="outside right upper", title="exponent")
    figure.savefig(path, dpi=120, format="png")
    pyplot.close(figure)

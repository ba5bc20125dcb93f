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

from .. import scenes as scene_files
from . import results
from .methods import METHODS

SIZES = (1280, 5120, 20480, 81920, 327680)
LIGHT_RADIUS = 0.1
"""Radius of the sphere light that stands for the point light where ``volpath`` renders: it can't connect to a point."""


@dataclass(frozen=True)
class Setup:
    """One measurement: ``methods`` of ours against ``volpath`` with ``samples`` per pixel."""

    scene: str = "bumpy_sphere"
    triangles: int = 20480
    variant: str = "llvm_ad_rgb"
    resolution: int = 256
    samples: int = 64
    repeats: int = 3
    internal_bounces: int = 0
    tolerance: float = 0.01
    methods: tuple = tuple(METHODS)

    def settings(self, method):
        common = {"surfaces": False, "internal_bounces": self.internal_bounces, "tolerance": self.tolerance}
        return {**common, **METHODS[method]}


def measure(setup):
    """Measures one size in this process; returns a row of results for each method, ``volpath`` last.

    ``mean_relative_error``: relative L1 difference to the image by ``curve`` at tolerance 0.
    """
    import mitsuba as mi
    import numpy as np

    mi.set_variant(setup.variant)
    import mitsuba_refscatter  # noqa: F401 - registers the plugin

    with tempfile.TemporaryDirectory() as directory:
        path, triangles = scene_files.write_scene(setup.scene, directory, setup.triangles)
        scene = mi.load_file(str(path), optimize=False, res=str(setup.resolution))
    rows, render, images = [], {}, {}
    for method in setup.methods:
        settings = setup.settings(method)
        integrator = mi.load_dict({"type": "refscatter", **settings})
        render[method] = lambda integrator=integrator: integrator.render(scene, spp=1)
        images[method] = np.array(render[method](), dtype=np.float64)
        # The first method's peak is its own; the others' are hidden behind it.
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 if not rows else None
        candidates, contributions, rays = _pairs(scene, settings)
        rows.append(_row(setup, triangles, method, settings, 1, rays=rays, candidates_per_ray=candidates / rays,
                         contributing_per_ray=contributions / rays, peak_memory_bytes=memory))  # fmt: skip
    exact = mi.load_dict({"type": "refscatter", **setup.settings("refscatter"), "tolerance": 0.0})
    truth = np.array(exact.render(scene, spp=1), dtype=np.float64)
    for row in rows:
        row["mean_relative_error"] = np.abs(images[row["method"]] - truth).sum() / truth.sum()
    reference = _volpath_scene(scene)
    render["volpath"] = lambda: reference.integrator().render(reference, spp=setup.samples)
    render["volpath"]()
    rows.append(_row(setup, triangles, "volpath", {"max_depth": 4, "light_radius": LIGHT_RADIUS}, setup.samples))
    times = {method: [] for method in render}
    for _ in range(setup.repeats):
        for method, work in render.items():
            times[method].append(_clock(work))
    for row in rows:
        row["wall_seconds"], row["cpu_seconds"] = (statistics.median(x) for x in zip(*times[row["method"]]))
    volpath = rows[-1]
    for row in rows[:-1]:
        for kind in ("wall", "cpu"):
            ratio = row[f"{kind}_seconds"] / volpath[f"{kind}_seconds"]
            row[f"volpath_samples_of_same_{kind}_time"] = ratio * setup.samples
    return rows


def _row(setup, triangles, method, settings, samples, **more):
    return {
        **results.row(scene=setup.scene, method=method, variant=setup.variant, triangles=triangles,
                      settings={**settings, "resolution": setup.resolution}, samples=samples),
        **more,
    }  # fmt: skip


def run(sizes, report=lambda rows: None, **setup):
    """Measures all sizes, each in a fresh process; ``report(rows)`` is called after each. Returns all rows."""
    rows, context = [], multiprocessing.get_context("spawn")
    for triangles in sizes:
        with concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as pool:
            found = pool.submit(measure, Setup(triangles=triangles, **setup)).result()
        rows += found
        report(found)
    return rows


def _pairs(scene, settings):
    """Sums of candidate and of contributing pairs over the image, and the rays that enter the body."""
    import mitsuba as mi
    import numpy as np

    integrator = mi.load_dict({"type": "refscatter", "aovs": "candidates,contributions", **settings})
    image = np.array(integrator.render(scene, spp=1), dtype=np.float64)
    return image[..., -2].sum(), image[..., -1].sum(), max(integrator.counts.segments, 1)


def _volpath_scene(scene):
    """The same sensor and shapes, the point lights as small spheres of the same power, ``volpath``."""
    import mitsuba as mi
    import numpy as np

    parts = {"type": "scene", "integrator": {"type": "volpath", "max_depth": 4}, "sensor": scene.sensors()[0]}
    for i, shape in enumerate(scene.shapes()):
        parts[f"shape{i}"] = shape
    for i, emitter in enumerate(scene.emitters()):
        parameters = mi.traverse(emitter)
        intensity = np.array(parameters["intensity.value"]).ravel()
        radiance = {"type": "rgb", "value": [float(x) / (np.pi * LIGHT_RADIUS**2) for x in intensity]}
        parts[f"light{i}"] = {
            "type": "sphere", "center": [float(x) for x in np.array(parameters["position"]).ravel()],
            "radius": LIGHT_RADIUS, "emitter": {"type": "area", "radiance": radiance},
        }  # fmt: skip
    return mi.load_dict(parts)


def _clock(work):
    """Wall and CPU seconds of a render, to the last kernel."""
    import drjit as dr

    wall, cpu = time.perf_counter(), time.process_time()
    dr.eval(work())
    dr.sync_thread()
    return time.perf_counter() - wall, time.process_time() - cpu

"""Time to a given error of the image, for lights that are neither points nor directions: ``refscatter equal-error``.

The body of ``bumpy_sphere`` and its view are lit by a sphere in place of the point light, of several radii and the same
power. They are also lit by the environment map of ``amber``. The error of an image has two parts, added as squares. One
is the relative L1 difference, sum |a - b| / sum b, to the mean over many seeds. The other is the bias.

Ours is rendered with more and more samples until the error is reached. ``volpath``, restricted to the same light
paths, would take days, so its time is computed from the variances between shorter renders. Its error falls with the
square root of its samples. Once pixels hold many paths it is sqrt(2 / pi) times the standard deviation.

For smaller radii that time is extrapolated from the smallest that was rendered. A path meets the light with a
probability that falls with the square of its radius, and then brings as much more. So variance and time grow with 1 /
radius^2.
"""

from __future__ import annotations

import math
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import mitsuba as mi
import numpy as np

from .. import example_scenes
from . import methods, metrics, plotting, results, timing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BODY, STUDIO_SCENE = "bumpy_sphere", "amber"
BIAS_TOLERANCE = 1e-4
"""Tolerance of the image that ours is compared with, at the same light points, to tell its bias."""
SAMPLES = [16, 48, 64, 80, 144, 224, 256, 288, 400, 576, 784, 1024, 1600, 2304, 4096, 9216, 16384]
"""Samples per pixel of ours: products of two numbers that are nearly equal, as the sampler wants them. They are
multiples of 16, since a pass then has 16 in each of 128 x 128 pixels."""
BLOCK = 8
"""Edge in pixels of blocks over which the variance of ``volpath`` relative to the image is averaged."""
FEWEST = 8
"""Renders of ``volpath`` from which its variance is told, at least."""
RATE = 0.75
"""Power of the number of samples with which our error falls, about; decides which number is tried next."""
SAMPLER = "multijitter"
"""Of all renders of ``volpath``: stratified in the pixels."""
OTHER_ROWS = 4
"""Rows besides one for each of the ``Setup.radii``: ``volpath`` and ours, at ``Setup.radius`` and under the sky."""


@dataclass(frozen=True)
class Setup:
    """What is measured.

    variant     Mitsuba's
    triangles   of the body, about
    resolution  pixels on a side
    error       that is wanted
    tolerance   of ours
    radii       of sphere lights for which ``volpath`` is rendered, in the scene's unit
    radius      of the sphere light for which it is extrapolated
    seconds     for which ``volpath`` renders each light
    replicates  renders of ours for each light
    samples     per pixel, of one render of ``volpath``
    """

    variant: str
    triangles: int = 5120
    resolution: int = 128
    error: float = 0.01
    tolerance: float = 0.01
    radii: tuple[float, ...] = (0.4, 0.2, 0.1)
    radius: float = 0.05
    seconds: float = 40.0
    replicates: int = 2
    samples: int = 64


def run(setup: Setup, report: Callable = lambda row: None) -> list[dict]:
    """Rows of results, ``volpath`` and ``refscatter`` for each light; ``report(row)`` is called after each.

    Rows have keys of their own: ``light``, ``radius`` (None: the environment map), ``error``, ``seconds_to_error``,
    ``extrapolated``; and ``speedup``, of ours.
    """
    mi.set_variant(setup.variant)
    rows = []

    def add(method, radius, measured):
        rows.append(_row(setup, scenes, method, radius, measured))
        report(rows[-1])

    with tempfile.TemporaryDirectory() as directory:
        scenes = _Scenes(setup, Path(directory))
        for radius in sorted(setup.radii, reverse=True):
            add("volpath", radius, _volpath(setup, scenes, radius))
        for radius in (setup.radius, None):
            theirs = _volpath(setup, scenes, radius) if radius is None else _extrapolated(rows, radius)
            add("volpath", radius, theirs)
            ours = _refscatter(setup, scenes, radius)
            if ours["seconds_to_error"] is not None:
                ours["speedup"] = theirs["seconds_to_error"] / ours["seconds_to_error"]
            add("refscatter", radius, ours)
    return rows


class _Scenes:
    """The body and its view under some light, made in a directory that must stay."""

    def __init__(self, setup: Setup, directory: Path):
        path, self.triangles = example_scenes.write_scene(BODY, directory / BODY, setup.triangles)
        example_scenes.write_scene(STUDIO_SCENE, directory / STUDIO_SCENE, 20)
        self._studio = directory / STUDIO_SCENE / example_scenes.STUDIO
        path.write_text(path.read_text().replace('sampler type="independent"', f'sampler type="{SAMPLER}"'))
        base, clear = (example_scenes.load(path, res=str(setup.resolution)) for _ in range(2))
        methods.without_scattering(clear)
        self.tolerance, self.sensor = setup.tolerance, base.sensors()[0]
        self._point = methods.position_and_intensity(base.emitters()[0])
        self._bodies = [next(s for s in scene.shapes() if s.id() == "body") for scene in (base, clear)]

    def light(self, radius: float | None) -> dict:
        """A sphere of a radius, or without one the environment map."""
        if radius is None:
            return {"type": "envmap", "filename": str(self._studio)}
        return methods.sphere_light(*self._point, radius)

    def load(self, radius: float | None, integrator: dict, scatters: bool = True) -> mi.Scene:
        """The scene under a light; with albedo 0 unless it ``scatters``."""
        parts = {"type": "scene", "integrator": integrator, "sensor": self.sensor}
        return mi.load_dict({**parts, "body": self._bodies[not scatters], "light": self.light(radius)}, optimize=False)

    def ours(self, radius: float | None, tolerance: float | None = None) -> mi.Scene:
        """The scene under a light, with ``refscatter`` at a tolerance, or at that of the setup."""
        tolerance = self.tolerance if tolerance is None else tolerance
        return self.load(radius, methods.single_scattering("refscatter", 0, tolerance))


def _image(scene, seed, samples):
    """Image (H, W, 3) in float64, and the seconds that it took."""
    hooks = methods.quiet(scene.integrator())
    image, seconds = timing.image_and_seconds(lambda: scene.integrator().render(scene, seed=seed, spp=samples, **hooks))
    return image[..., :3], seconds


def _spread(images):
    """Mean relative L1 difference of each image from the mean of the others, but for the noise of that mean."""
    n = len(images)
    others = (images.sum(axis=0) - images) / (n - 1)
    return metrics.mean_relative_error(images, others) * ((n - 1) / n) ** 0.5


def _volpath(setup, scenes, radius):
    """Error and time of ``volpath``.

    Its unscattered light is rendered with the same seeds, with which it is the same, and subtracted. Only the render
    with scattering is timed. The ``bias`` is that of the image means, against ours; it is told in standard errors,
    too.
    """
    integrator = methods.volpath(scenes.sensor)
    scene, clear = scenes.load(radius, integrator), scenes.load(radius, integrator, scatters=False)
    for warm_up in (scene, clear):
        _image(warm_up, 0, setup.samples)
    images, times, start = [], [], time.perf_counter()
    while len(images) < FEWEST or time.perf_counter() - start < setup.seconds:
        seed = 1 + len(images)
        image, seconds = _image(scene, seed, setup.samples)
        images.append(image - _image(clear, seed, setup.samples)[0])
        times.append(seconds)
    images, seconds = np.array(images), statistics.median(times)
    ours = scenes.ours(radius)
    images_of_ours = np.array([_image(ours, 1 + k, SAMPLES[0])[0] for k in range(setup.replicates)])
    truth = images_of_ours.mean(axis=(1, 2, 3))
    means = images.mean(axis=(1, 2, 3))
    noise = (means.var(ddof=1) / len(means) + truth.var(ddof=1) / len(truth)) ** 0.5
    deviation = _deviation(images.var(axis=0, ddof=1), images_of_ours.mean(axis=0))
    error = float((2 / np.pi) ** 0.5 * deviation.mean() / truth.mean())
    return dict(
        samples=setup.samples, wall_seconds=seconds, mean_relative_error=error,
        bias=float(means.mean() / truth.mean() - 1),
        bias_in_standard_errors=float((means.mean() - truth.mean()) / noise),
        seconds_to_error=seconds * (error / setup.error) ** 2, extrapolated=False,
    )  # fmt: skip


def _deviation(variance, truth):
    """Standard deviation of each pixel from noisy variances (H, W, 3).

    Variances are taken to be proportional to the image in a block of pixels, as is the number of paths that find the
    light. Those of single pixels with few paths are mostly too small, and their roots even more.
    """
    height, width, _ = truth.shape
    y, x = np.indices((height, width))
    block = (y // BLOCK * width + x // BLOCK).ravel()
    out = np.empty_like(variance)
    for k in range(variance.shape[-1]):
        sums = [np.bincount(block, image[..., k].ravel()) for image in (variance, truth)]
        ratio = sums[0] / np.maximum(sums[1], 1e-30)
        out[..., k] = np.sqrt(ratio[block].reshape(height, width) * truth[..., k])
    return out


def _extrapolated(rows, radius):
    """The time of ``volpath`` at a smaller radius than those that it was rendered for."""
    known = min((row for row in rows if row["method"] == "volpath"), key=lambda row: row["radius"])
    return dict(seconds_to_error=known["seconds_to_error"] * (known["radius"] / radius) ** 2, extrapolated=True)


def _refscatter(setup, scenes, radius):
    """Error and time of ours, with more and more samples until the error is reached."""
    usual, exact = scenes.ours(radius), scenes.ours(radius, BIAS_TOLERANCE)
    for _ in range(2):  # the first compiles
        a, b = (_image(scene, 0, 1)[0] for scene in (usual, exact))
    difference = metrics.mean_relative_error(a, b)
    samples = SAMPLES[0]
    while True:
        images, times = zip(*(_image(usual, 1 + k, samples) for k in range(setup.replicates)))
        error = math.hypot(_spread(np.array(images)), difference)
        more = [n for n in SAMPLES if n > samples]
        if error <= setup.error or not more:
            break
        wanted = samples * (error / setup.error) ** (1 / RATE)
        samples = next((n for n in more if n >= 0.9 * wanted), more[-1])
    seconds = statistics.median(times)
    return dict(
        samples=samples, wall_seconds=seconds, mean_relative_error=error, bias=metrics.bias(a, b),
        seconds_to_error=seconds if error <= setup.error else None, extrapolated=False,
    )  # fmt: skip


def _row(setup, scenes, method, radius, measured):
    """A row of results, of what was measured of a method under a light."""
    settings = methods.single_scattering("refscatter", 0, setup.tolerance)
    if method == "volpath":
        settings = {"type": "volpath", "max_depth": methods.depth(scenes.sensor)}
    return {
        **results.row(scene=BODY, method=method, variant=setup.variant, triangles=scenes.triangles,
                      settings={**settings, "resolution": setup.resolution}),
        "light": "envmap" if radius is None else "sphere", "radius": radius, "error": setup.error, **measured,
    }  # fmt: skip


def figure(rows: list[dict]) -> Figure:
    """Seconds to the error over the radius of the sphere light."""
    drawn, ((panel,),) = plotting.subplots(size=(5.5, 4))
    plotting.log_axes(
        panel,
        title=f"{BODY}, hollow mark: extrapolated",
        xlabel="radius of the sphere light",
        ylabel=f"seconds to {rows[0]['error']:.0%} error",
    )
    for method, marker in (("volpath", "s"), ("refscatter", "o")):
        spheres = [row for row in rows if row["method"] == method and row["radius"] and row["seconds_to_error"]]
        spheres.sort(key=lambda row: row["radius"])
        places = [(row["radius"], row["seconds_to_error"]) for row in spheres]
        (line,) = panel.plot([x for x, _ in places], [y for _, y in places], label=method)
        for row, place in zip(spheres, places):
            face = "white" if row["extrapolated"] else line.get_color()
            panel.plot(*place, marker=marker, color=line.get_color(), markerfacecolor=face)
    panel.legend()
    return drawn

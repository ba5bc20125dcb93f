"""``refscatter equal-error``: time to a given error of the image for lights that are neither points nor directions.

The body of ``bumpy_sphere`` and its view, lit by a sphere of several radii in place of the point light, all of the same
power, and by the environment map of ``amber``. Error of an image: the relative L1 difference sum|a - b| / sum b to its mean
over many seeds, and its bias, added as squares. Ours is rendered with more and more samples until the error is reached.
``volpath``, restricted to the same light paths, would take days: its error falls with the square root of its samples, and
once pixels hold many paths it is sqrt(2 / pi) times the standard deviation. So its time is computed from the variances
between shorter renders. For smaller radii it is extrapolated from the smallest that was rendered: a path meets the light with
a probability that falls with the square of its radius and then brings as much more, so variance and time grow with 1 / radius^2.
"""

import math
import statistics
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from .. import example_scenes as scene_files
from . import results

BODY, STUDIO_SCENE = "bumpy_sphere", "amber"
DEPTH = 4
"""``max_depth`` of ``volpath``: camera, into the body, scattering, out of the body, light."""
BIAS_TOLERANCE = 1e-4
"""Tolerance of the image that ours is compared with, at the same light points, to tell its bias."""
SAMPLES = [16, 48, 64, 80, 144, 224, 256, 288, 400, 576, 784, 1024, 1600, 2304, 4096, 9216, 16384]
"""Samples per pixel of ours: products of two numbers that are nearly equal, as the sampler wants them, and multiples of 16, since
a pass then has 16 in each of 128 x 128 pixels."""
BLOCK = 8
"""Edge in pixels of blocks over which the variance of ``volpath`` relative to the image is averaged."""
RATE = 0.75
"""Power of the number of samples with which our error falls, about; decides which number is tried next."""
OURS = {"surfaces": False, "internal_bounces": 0}
"""The light paths that ``volpath`` with ``DEPTH`` has."""
SAMPLER = "multijitter"
"""Of ``volpath``: stratified in the pixels."""


OTHER_ROWS = 4
"""Of results, besides one for each of the ``Setup.radii``: ``volpath`` and ours at ``Setup.radius`` and under the sky."""


@dataclass(frozen=True)
class Setup:
    """What is measured. ``radii``: of sphere lights for which ``volpath`` is rendered; ``radius``: of the one for which it is
    extrapolated; ``seconds``: for which ``volpath`` renders each light; ``replicates``: of our renders."""

    variant: str
    triangles: int = 5120
    resolution: int = 128
    error: float = 0.01
    tolerance: float = 0.01
    radii: tuple = (0.4, 0.2, 0.1)
    radius: float = 0.05
    seconds: float = 40.0
    replicates: int = 2
    samples: int = 64


def run(setup, report=lambda row: None):
    """Rows of results, ``volpath`` and ``refscatter`` for each light; ``report(row)`` is called after each.

    Own keys: ``light``, ``radius``, ``error``, ``seconds_to_error``, ``extrapolated``; and ``speedup`` of ours.
    """
    import mitsuba as mi

    mi.set_variant(setup.variant)
    import mitsuba_refscatter  # noqa: F401 - registers the plugin

    rows = []

    def add(row):
        rows.append(row)
        report(row)

    with tempfile.TemporaryDirectory() as directory:
        scenes = _Scenes(setup, Path(directory))
        for radius in sorted(setup.radii, reverse=True):
            add(_row(setup, scenes, "volpath", radius, **_volpath(setup, scenes, radius)))
        for radius in (setup.radius, None):
            theirs = _volpath(setup, scenes, radius) if radius is None else _extrapolated(rows, radius)
            add(_row(setup, scenes, "volpath", radius, **theirs))
            ours = _refscatter(setup, scenes, radius)
            if ours["seconds_to_error"] is not None:
                ours["speedup"] = theirs["seconds_to_error"] / ours["seconds_to_error"]
            add(_row(setup, scenes, "refscatter", radius, **ours))
    return rows


class _Scenes:
    """The body and its view under some light."""

    def __init__(self, setup, directory):
        import mitsuba as mi
        import numpy as np

        path, self.triangles = scene_files.write_scene(BODY, directory / BODY, setup.triangles)
        scene_files.write_scene(STUDIO_SCENE, directory / STUDIO_SCENE, 20)
        self._studio = directory / STUDIO_SCENE / scene_files.STUDIO
        path.write_text(path.read_text().replace('sampler type="independent"', f'sampler type="{SAMPLER}"'))
        base, clear = (scene_files.load(path, res=str(setup.resolution)) for _ in range(2))
        self._sensor, point = base.sensors()[0], mi.traverse(base.emitters()[0])
        self._position, self._intensity = (np.array(point[key]).ravel() for key in ("position", "intensity.value"))
        parameters = mi.traverse(clear)
        parameters["body.interior_medium.albedo.value.value"] = mi.Color3f(0)
        parameters.update()
        self._bodies = [next(s for s in scene.shapes() if s.id() == "body") for scene in (base, clear)]

    def light(self, radius):
        """A sphere of a radius, or without one the environment map."""
        if radius is None:
            return {"type": "envmap", "filename": str(self._studio)}
        radiance = self._intensity / (math.pi * radius**2)
        return {"type": "sphere", "center": self._position.tolist(), "radius": radius,
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance.tolist()}}}  # fmt: skip

    def load(self, radius, integrator, scatters=True):
        """``mi.Scene``; ``scatters``: False for the same with albedo 0."""
        import mitsuba as mi

        parts = {"type": "scene", "integrator": integrator, "sensor": self._sensor}
        return mi.load_dict({**parts, "body": self._bodies[not scatters], "light": self.light(radius)}, optimize=False)

    def ours(self, setup, radius, **options):
        return self.load(radius, {"type": "refscatter", **OURS, "tolerance": setup.tolerance, **options})


def _image(scene, seed, samples):
    """Image (H, W, 3) in float64, and the seconds that it took."""
    import numpy as np

    start = time.perf_counter()
    image = np.array(scene.integrator().render(scene, seed=seed, spp=samples), dtype=np.float64)[..., :3]
    return image, time.perf_counter() - start


def _spread(images):
    """Mean relative L1 difference of each image from the mean of the others, but for the noise of that mean."""
    import numpy as np

    n = len(images)
    others = (images.sum(axis=0) - images) / (n - 1)
    return float(np.abs(images - others).sum() / images.sum() * ((n - 1) / n) ** 0.5)


def _volpath(setup, scenes, radius):
    """Error and time of ``volpath``. Its unscattered light is subtracted with the same seeds, where it is the same; only the
    render with scattering is timed. ``bias``: of the image means, against ours, and that in standard errors."""
    import numpy as np

    integrator = {"type": "volpath", "max_depth": DEPTH, "rr_depth": 1000}
    scene, clear = scenes.load(radius, integrator), scenes.load(radius, integrator, scatters=False)
    for warm_up in (scene, clear):
        _image(warm_up, 0, setup.samples)
    images, times, start = [], [], time.perf_counter()
    while len(images) < 8 or time.perf_counter() - start < setup.seconds:
        seed = 1 + len(images)
        image, seconds = _image(scene, seed, setup.samples)
        images.append(image - _image(clear, seed, setup.samples)[0])
        times.append(seconds)
    images, seconds = np.array(images), statistics.median(times)
    ours = scenes.ours(setup, radius)
    images_of_ours = np.array([_image(ours, 1 + k, SAMPLES[0])[0] for k in range(setup.replicates)])
    truth = images_of_ours.mean(axis=(1, 2, 3))
    means = images.mean(axis=(1, 2, 3))
    noise = (means.var(ddof=1) / len(means) + truth.var(ddof=1) / len(truth)) ** 0.5
    deviation = _deviation(images.var(axis=0, ddof=1), images_of_ours.mean(axis=0))
    error = float((2 / np.pi) ** 0.5 * deviation.mean() / truth.mean())
    return dict(
        samples=setup.samples, wall_seconds=seconds, mean_relative_error=error, bias=float(means.mean() / truth.mean() - 1),
        bias_in_standard_errors=float((means.mean() - truth.mean()) / noise),
        seconds_to_error=seconds * (error / setup.error) ** 2, extrapolated=False,
    )  # fmt: skip


def _deviation(variance, truth):
    """Standard deviation of each pixel from noisy variances: in a block of pixels they are taken to be proportional to the
    image, as those of the number of paths that find the light are. Those of single pixels with few paths are mostly too
    small, and their roots even more."""
    import numpy as np

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
    import numpy as np

    usual, exact = scenes.ours(setup, radius), scenes.ours(setup, radius, tolerance=BIAS_TOLERANCE)
    for _ in range(2):  # the first compiles
        a, b = (_image(scene, 0, 1)[0] for scene in (usual, exact))
    bias = float(np.abs(a - b).sum() / b.sum())
    samples = SAMPLES[0]
    while True:
        images, times = zip(*(_image(usual, 1 + k, samples) for k in range(setup.replicates)))
        error = math.hypot(_spread(np.array(images)), bias)
        more = [n for n in SAMPLES if n > samples]
        if error <= setup.error or not more:
            break
        wanted = samples * (error / setup.error) ** (1 / RATE)
        samples = next((n for n in more if n >= 0.9 * wanted), more[-1])
    seconds = statistics.median(times)
    return dict(
        samples=samples, wall_seconds=seconds, mean_relative_error=error, bias=float(a.sum() / b.sum() - 1),
        seconds_to_error=seconds if error <= setup.error else None, extrapolated=False,
    )  # fmt: skip


def _row(setup, scenes, method, radius, **measured):
    settings = {**OURS, "resolution": setup.resolution, "tolerance": setup.tolerance}
    return {
        **results.row(scene=BODY, method=method, variant=setup.variant, triangles=scenes.triangles,
                      settings=settings if method == "refscatter" else {"max_depth": DEPTH, "resolution": setup.resolution}),
        "light": "envmap" if radius is None else "sphere", "radius": radius, "error": setup.error, **measured,
    }  # fmt: skip


def plot(rows, path):
    """Seconds to the error against the radius of the sphere light; as PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, panel = pyplot.subplots(figsize=(5.5, 4), layout="constrained")
    for method, marker in (("volpath", "s"), ("refscatter", "o")):
        spheres = [row for row in rows if row["method"] == method and row["radius"] and row["seconds_to_error"]]
        spheres.sort(key=lambda row: row["radius"])
        (line,) = panel.loglog(
            [row["radius"] for row in spheres], [row["seconds_to_error"] for row in spheres], label=method
        )
        for row in spheres:
            face = "white" if row["extrapolated"] else line.get_color()
            panel.plot(
                row["radius"], row["seconds_to_error"], marker=marker, color=line.get_color(), markerfacecolor=face
            )
    panel.set(xlabel="radius of the sphere light", ylabel=f"seconds to {rows[0]['error']:.0%} error",
              title="bumpy_sphere, hollow mark: extrapolated")  # fmt: skip
    panel.grid(alpha=0.3)
    panel.legend()
    figure.savefig(path, dpi=120)
    pyplot.close(figure)

"""Methods side by side on one scene: each renders for the same time, and its error is followed on the way.

All but ``volpath`` render at the same places in the pixels, in passes that double their samples while the time allows; the photon
methods send new photons for each sample. ``volpath`` renders with other seeds again and again; the same render with albedo 0 is subtracted (what is
not scattered in the media), and not timed. Clocks stand still while images are compared.
"""

import hashlib
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Optional

from . import methods, metrics

REFERENCE_TOLERANCE = 1e-3
REFERENCE_TIME = 8.0
"""Time of the reference relative to that of a method."""
REFERENCE_SEED = 1000
"""Other places in the pixels than those of the methods."""
LONGEST = 8.0
"""Time relative to the given one that a method gets to reach the quality of the first, before it is extrapolated."""
STEPS = 32
"""Renders of ``volpath`` in the given time, about."""
GROWTH = 1.1
"""Factor of time between two errors of a curve."""
ENDLESS = 1 << 20
"""Samples per pixel that no run comes to."""
MOST = 1024
"""Samples per pixel in one render of ``volpath``."""
FLAT = 0.25
"""Least power of time with which an error must fall for its curve to be extrapolated."""


@dataclass(frozen=True)
class Checked:
    """What a reference without internal reflections is within on one scene: ``l1``, of a float64 oracle along camera rays; ``bias``,
    of long photon beams. ``files``: ``fingerprint`` of the scene and its mesh."""

    l1: float
    bias: float
    files: str


CHECKED = {
    "bumpy_sphere": Checked(3e-4, 7e-3, "efe2f0e15246e09e"),
    "sphere": Checked(5e-5, 1e-3, "3b8e62781ef3ffda"),
    "rounded_cube": Checked(5e-4, 4e-3, "9ed43edd710df579"),
    "branches": Checked(3e-3, 8e-3, "01923662c9165ae5"),
}
"""Of shipped scenes; ``tests/test_reference.py`` measures that."""


def fingerprint(*files):
    """A hash of what is in files."""
    return hashlib.sha256(b"".join(Path(file).read_bytes() for file in files)).hexdigest()[:16]


def checked(path):
    """The ``Checked`` of a scene file; None where it or its mesh differs in a byte from what was checked."""
    for name, known in CHECKED.items():
        mesh = Path(path).parent / "meshes" / f"{name}.ply"
        if mesh.is_file() and fingerprint(path, mesh) == known.files:
            return known
    return None


@dataclass(frozen=True)
class Setup:
    """What all methods have in common. ``seconds``: wall time of each; ``variant``: Mitsuba's."""

    variant: str
    seconds: float = 10.0
    internal_bounces: int = 0
    tolerance: float = 0.01
    equal_quality: bool = False

    @property
    def common(self):
        """Properties of all integrators of this package here."""
        return {"surfaces": False, "internal_bounces": self.internal_bounces, "tolerance": self.tolerance}


@dataclass
class Run:
    """What a method did. ``curve``: (wall seconds, relMSE) on the way; ``image`` after the time was up; ``seed``: None where it is
    made with many."""

    method: str
    settings: dict
    image: object = None
    seed: Optional[int] = None
    samples: int = 0
    wall_seconds: float = 0.0
    cpu_seconds: float = 0.0
    warm_up_seconds: float = 0.0
    curve: list = field(default_factory=list)


class _Clock:
    """Wall and CPU time, but for pauses."""

    def __init__(self):
        self.wall = self.cpu = 0.0
        self._since = 0.0, 0.0

    def go_on(self):
        self._since = time.perf_counter(), time.process_time()

    def pause(self):
        import drjit as dr

        dr.sync_thread()
        self.wall += time.perf_counter() - self._since[0]
        self.cpu += time.process_time() - self._since[1]


class _Follower:
    """Follows a run: notes errors as often as a logarithmic plot shows, keeps the image that there is when the ``seconds`` are
    over, and ends it there; or, where an error is ``wanted``, once that is reached or ``LONGEST`` is over."""

    def __init__(self, run, reference, seconds, wanted, report, grows=False):
        self.run, self.reference, self.seconds, self.wanted = run, reference, seconds, wanted
        self.report, self.grows = report, grows
        self.clock, self.next, self.error = _Clock(), 0.0, float("inf")
        self.clock.go_on()

    def __call__(self, samples, image):
        """Takes the image after ``samples``; how many to take next, 0 to end. Where it ``grows`` as many as there are or, before
        the time is up, as are then left."""
        run, clock = self.run, self.clock
        clock.pause()
        over, kept = clock.wall >= self.seconds, run.wall_seconds >= self.seconds
        if clock.wall >= self.next or (over and not kept):
            array = _array(image)
            if self.reference is not None:
                self.error = metrics.relmse(array, self.reference)
                run.curve.append((clock.wall, self.error))
            if not kept:
                run.image, run.samples, run.wall_seconds, run.cpu_seconds = array, samples, clock.wall, clock.cpu
            self.next = clock.wall * GROWTH
        self.report(min(clock.wall / self.seconds, 1.0))
        reached = self.wanted is None or self.error <= self.wanted or clock.wall >= LONGEST * self.seconds
        clock.go_on()
        if over and reached:
            return 0
        end = self.seconds if not over else LONGEST * self.seconds
        return max(1, min(samples, int((end - clock.wall) / clock.wall * samples))) if self.grows else 1


def _array(image):
    import numpy as np

    return np.array(image, dtype=np.float64)[..., :3]


def reference(scene, setup, report):
    """The image that errors are measured against: a long run of ``curve``. Returns a ``Run``."""
    settings = {**methods.METHODS["refscatter"], **setup.common, "tolerance": REFERENCE_TOLERANCE}
    return _ours(scene, Run("reference", settings), None, REFERENCE_TIME * setup.seconds, None, report, REFERENCE_SEED)


def run(scene, clear, method, setup, truth, wanted=None, report=lambda fraction: None):
    """One method. ``clear``: the same scene without scattering, for ``volpath``; ``truth``: the reference's image; ``wanted``:
    relMSE to go on to. Returns a ``Run``."""
    if method == "volpath":
        return _volpath(scene, clear, setup, truth, wanted, report)
    settings = {**methods.METHODS[method], **setup.common}
    return _ours(scene, Run(method, settings), truth, setup.seconds, wanted, report)


def _ours(scene, run, truth, seconds, wanted, report, seed=1):
    """A method of this package."""
    import mitsuba as mi

    from ..integrators.hooks import Hooks

    integrator, start, run.seed = mi.load_dict(run.settings), time.perf_counter(), seed
    two = Hooks(watch=lambda samples, image: 1 if samples < 2 else 0)
    integrator.render(scene, seed=0, spp=ENDLESS, hooks=two)
    run.warm_up_seconds = time.perf_counter() - start
    follower = _Follower(run, truth, seconds, wanted, report, grows="photons" not in run.settings)
    integrator.render(scene, seed=seed, spp=ENDLESS, hooks=Hooks(watch=follower))
    return run


def _volpath(scene, clear, setup, truth, wanted, report):
    """``volpath``, in renders of as many samples as make about ``STEPS`` in the given time."""
    integrator = scene.integrator()
    run = Run(
        "volpath",
        {"type": "volpath", "max_depth": methods.depth(scene.sensors()[0]), "light_radius": methods.LIGHT_RADIUS},
    )
    start = time.perf_counter()
    for warm_up in (scene, clear):
        integrator.render(warm_up, seed=0, spp=1)
    run.warm_up_seconds, samples = time.perf_counter() - start, 1
    _timed(integrator, scene, 2)  # what is compiled for several samples
    while _timed(integrator, scene, samples) < setup.seconds / STEPS and samples < MOST:
        samples *= 2
    follower, total, seed, more = _Follower(run, truth, setup.seconds, wanted, report), 0.0, 1, 1
    while more:
        image = integrator.render(scene, seed=seed, spp=samples)
        follower.clock.pause()
        total = total + _array(image) - _array(integrator.render(clear, seed=seed, spp=samples))
        follower.clock.go_on()
        more = follower(seed * samples, total / seed)
        seed += 1
    return run


def _timed(integrator, scene, samples):
    import drjit as dr

    start = time.perf_counter()
    integrator.render(scene, seed=0, spp=samples)
    dr.sync_thread()
    return time.perf_counter() - start


POWERS = {"volpath": 1.0}
"""Powers of time by which a method's relMSE falls that are known: independent samples. What a noisy curve shows may be anything."""


def seconds_to(curve, error, power=None):
    """When a curve of (seconds, error) is at an error for good, and whether that was extrapolated: with a known ``power`` of time,
    or that by which it fell over the last eighth of the time onwards. ``(None, True)`` where it hardly falls.

    >>> curve = [(1.0, 0.4), (2.0, 0.2), (4.0, 0.1), (8.0, 0.05)]
    >>> seconds_to(curve, 0.1), seconds_to(curve, 0.025, power=1.0)
    ((4.0, False), (16.0, True))
    """
    import numpy as np

    t, e = np.array(curve).T
    above = np.flatnonzero(e > error)
    if len(above) == 0:
        return float(t[0]), False
    k = above[-1]
    if k + 1 < len(t):
        share = np.log(e[k] / error) / np.log(e[k] / e[k + 1])
        return float(t[k] * (t[k + 1] / t[k]) ** share), False
    late = t >= t[-1] / 8
    if power is None:
        if late.sum() < 3:
            return None, True
        power = -np.polyfit(np.log(t[late]), np.log(e[late]), 1)[0]
    return (float(t[-1] * (e[-1] / error) ** (1 / power)) if power > FLAT else None), True

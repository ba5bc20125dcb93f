"""One method on one scene against the clock: it renders for a given time, and its error is followed on the way.

All methods but ``volpath`` render at the same places in the pixels, in passes that double their samples while the time
allows. The photon methods send new photons for each sample. ``volpath`` renders with other seeds again and again. What
it finds that has not scattered in media is rendered with albedo 0 and the same seeds, not timed, and subtracted. The
clock stands still while images are compared.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import mitsuba as mi
import numpy as np

from ..integrators.hooks import Hooks
from . import methods, metrics, timing

REFERENCE_TOLERANCE = 1e-3
REFERENCE_TIME = 8.0
"""Time of the reference relative to that of a method."""
REFERENCE_SEED = 1000
"""The reference has other places in the pixels than the methods."""
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
POWERS = {"volpath": 1.0}
"""Powers of time by which a method's relMSE is known to fall, as its samples are independent."""


@dataclass(frozen=True)
class Checked:
    """How near the reference is to the truth on one scene without internal reflections.

    l1     relative L1 difference to a float64 oracle along camera rays, at most
    bias   relative difference to the sum of long photon beams, at most
    files  ``fingerprint`` of the scene and its mesh
    """

    l1: float
    bias: float
    files: str


CHECKED = {
    "bumpy_sphere": Checked(3e-4, 7e-3, "efe2f0e15246e09e"),
    "sphere": Checked(5e-5, 1e-3, "3b8e62781ef3ffda"),
    "rounded_cube": Checked(5e-4, 4e-3, "9ed43edd710df579"),
    "branches": Checked(3e-3, 8e-3, "01923662c9165ae5"),
}
"""Of shipped scenes; ``tests/test_references_of_compare.py`` measures that."""


def fingerprint(*files: str | Path) -> str:
    """A hash of what is in files."""
    return hashlib.sha256(b"".join(Path(file).read_bytes() for file in files)).hexdigest()[:16]


def checked(path: str | Path) -> Checked | None:
    """The ``Checked`` of a scene file; None where it or its mesh differs in a byte from what was checked."""
    for name, known in CHECKED.items():
        mesh = Path(path).parent / "meshes" / f"{name}.ply"
        if mesh.is_file() and fingerprint(path, mesh) == known.files:
            return known
    return None


@dataclass(frozen=True)
class Setup:
    """What all methods have in common.

    variant           Mitsuba's
    seconds           wall time of each method
    internal_bounces  internal reflections of the camera ray; ``volpath`` has none
    tolerance         of ``refscatter``
    equal_quality     whether methods go on until they reach the relMSE of the first, or ``LONGEST``
    """

    variant: str
    seconds: float = 10.0
    internal_bounces: int = 0
    tolerance: float = 0.01
    equal_quality: bool = False

    def properties(self, method: str) -> dict:
        """Properties of the integrator of a method of this package."""
        return methods.single_scattering(method, self.internal_bounces, self.tolerance)


@dataclass(frozen=True)
class Goal:
    """How long a run goes on, and what its images are compared with.

    seconds    wall time, after which its image is kept
    reference  image (H, W, 3) that errors are measured against, or None
    relmse     error to go on to after that time, or None
    report     (share of the time) is called on the way
    """

    seconds: float
    reference: np.ndarray | None = None
    relmse: float | None = None
    report: Callable = lambda fraction: None


@dataclass
class Run:
    """What a method did.

    method           its name
    settings         properties of its integrator
    image            (H, W, 3), when the time was up
    seed             of the image; None where it is made with many
    samples          per pixel, of the image
    wall_seconds     until then, without the warm-up
    cpu_seconds      the same of all cores
    warm_up_seconds  wall time of a first render, which compiles
    curve            (wall seconds, relMSE) on the way
    """

    method: str
    settings: dict
    image: np.ndarray | None = None
    seed: int | None = None
    samples: int = 0
    wall_seconds: float = 0.0
    cpu_seconds: float = 0.0
    warm_up_seconds: float = 0.0
    curve: list[tuple[float, float]] = field(default_factory=list)


class _Follower:
    """Follows a run, as the ``watch`` of its renders.

    It notes errors as often as a logarithmic plot shows them. It keeps the image that there is when the time of the
    ``Goal`` is over, and ends the run there. With an error to go on to, it ends the run once that is reached or
    ``LONGEST`` is over.
    """

    def __init__(self, run: Run, goal: Goal, grows: bool = False):
        self.run, self.goal, self.grows = run, goal, grows
        self.clock, self.next, self.error = timing.Stopwatch(), 0.0, float("inf")
        self.clock.go_on()

    def __call__(self, samples, image):
        """Take the image after ``samples``; return how many to take next, 0 to end.

        Where the run ``grows`` these are as many as there are, or as the time that is left allows.
        """
        run, goal, clock = self.run, self.goal, self.clock
        clock.pause()
        over, kept = clock.wall >= goal.seconds, run.wall_seconds >= goal.seconds
        if clock.wall >= self.next or (over and not kept):
            array = _rgb(image)
            if goal.reference is not None:
                self.error = metrics.relmse(array, goal.reference)
                run.curve.append((clock.wall, self.error))
            if not kept:
                run.image, run.samples, run.wall_seconds, run.cpu_seconds = array, samples, clock.wall, clock.cpu
            self.next = clock.wall * GROWTH
        goal.report(min(clock.wall / goal.seconds, 1.0))
        longest = LONGEST * goal.seconds
        reached = goal.relmse is None or self.error <= goal.relmse or clock.wall >= longest
        clock.go_on()
        if over and reached:
            return 0
        left = (longest if over else goal.seconds) - clock.wall
        return max(1, min(samples, int(left / clock.wall * samples))) if self.grows else 1


def _rgb(image):
    """The first three channels of an image, float64."""
    return np.array(image, dtype=np.float64)[..., :3]


def reference(scene: mi.Scene, setup: Setup, report: Callable = lambda fraction: None) -> Run:
    """A long run of ``curve``, whose image errors are measured against."""
    settings = {**setup.properties("refscatter"), "tolerance": REFERENCE_TOLERANCE}
    goal = Goal(REFERENCE_TIME * setup.seconds, report=report)
    return _ours(scene, Run("reference", settings, seed=REFERENCE_SEED), goal)


def run(scene: mi.Scene, method: str, setup: Setup, goal: Goal, clear: mi.Scene | None = None) -> Run:
    """One method on a scene.

    scene  as ``methods.for_volpath`` makes it for ``volpath``
    clear  the same without scattering, for ``volpath``
    """
    if method == "volpath":
        return _volpath(scene, clear, setup, goal)
    return _ours(scene, Run(method, setup.properties(method), seed=1), goal)


def _ours(scene, run, goal):
    """A method of this package: the ``Run``, once its warm-up and its renders are done."""
    integrator, start = mi.load_dict(run.settings), time.perf_counter()
    two = Hooks(watch=lambda samples, image: 1 if samples < 2 else 0, silent=True)
    integrator.render(scene, seed=0, spp=ENDLESS, hooks=two)
    run.warm_up_seconds = time.perf_counter() - start
    follower = _Follower(run, goal, grows="photons" not in run.settings)
    integrator.render(scene, seed=run.seed, spp=ENDLESS, hooks=Hooks(watch=follower, silent=True))
    return run


def _volpath(scene, clear, setup, goal):
    """``volpath``, in renders of as many samples as make about ``STEPS`` in the given time."""
    integrator, start = scene.integrator(), time.perf_counter()
    settings = {"type": "volpath", "max_depth": methods.depth(scene.sensors()[0]), "light_radius": methods.LIGHT_RADIUS}
    run = Run("volpath", settings)
    for warm_up in (scene, clear):
        integrator.render(warm_up, seed=0, spp=1)
    run.warm_up_seconds, samples = time.perf_counter() - start, 1

    def seconds(samples):
        return timing.clock(lambda: integrator.render(scene, seed=0, spp=samples))[0]

    seconds(2)  # what is compiled for several samples
    while seconds(samples) < setup.seconds / STEPS and samples < MOST:
        samples *= 2
    follower, total, seed, more = _Follower(run, goal), 0.0, 1, 1
    while more:
        image = integrator.render(scene, seed=seed, spp=samples)
        follower.clock.pause()
        total = total + _rgb(image) - _rgb(integrator.render(clear, seed=seed, spp=samples))
        follower.clock.go_on()
        more = follower(seed * samples, total / seed)
        seed += 1
    return run


def seconds_to(curve: list[tuple[float, float]], error: float, power: float | None = None) -> tuple[float | None, bool]:
    """When a curve is below an error for good, and whether that was extrapolated.

    curve  (seconds, error)
    error  that is wanted
    power  of time with which the error is known to fall; None: as it fell over the last eighth of the curve

    It is ``(None, True)`` where the error hardly falls, or where there are too few points to tell.

    >>> curve = [(1.0, 0.4), (2.0, 0.2), (4.0, 0.1), (8.0, 0.05)]
    >>> seconds_to(curve, 0.1), seconds_to(curve, 0.025, power=1.0)
    ((4.0, False), (16.0, True))
    """
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
        power = -float(np.polyfit(np.log(t[late]), np.log(e[late]), 1)[0])
    return (float(t[-1] * (e[-1] / error) ** (1 / power)) if power > FLAT else None), True

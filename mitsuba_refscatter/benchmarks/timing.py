"""Clocks of the benchmarks. A render counts as done when its last kernel is."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable

import drjit as dr
import numpy as np


def clock(work: Callable) -> tuple[float, float]:
    """Wall and CPU seconds of ``work()``, which returns a Dr.Jit array."""
    wall, cpu = time.perf_counter(), time.process_time()
    dr.eval(work())
    dr.sync_thread()
    return time.perf_counter() - wall, time.process_time() - cpu


def image_and_seconds(render: Callable) -> tuple[np.ndarray, float]:
    """The image (H, W, C) that ``render()`` returns, in float64, and the wall seconds that it took."""
    start = time.perf_counter()
    image = np.array(render(), dtype=np.float64)
    return image, time.perf_counter() - start


def medians(works: Iterable[Callable], repeats: int, done: Callable = lambda: None) -> list[tuple[float, float]]:
    """Medians of the wall and CPU seconds of each of several works, which take turns.

    works    functions without arguments, as ``clock`` takes them
    repeats  turns of each
    done     called after every one
    """
    works = list(works)
    times = [[] for _ in works]
    for _ in range(repeats):
        for work, measured in zip(works, times):
            measured.append(clock(work))
            done()
    return [tuple(statistics.median(x) for x in zip(*measured)) for measured in times]


class Stopwatch:
    """Wall and CPU seconds, without the pauses.

    wall, cpu  seconds up to the last pause
    """

    def __init__(self):
        self.wall = self.cpu = 0.0
        self._since = 0.0, 0.0

    def go_on(self):
        """Start, or end a pause."""
        self._since = time.perf_counter(), time.process_time()

    def pause(self):
        """Count what has passed, up to the last kernel."""
        dr.sync_thread()
        self.wall += time.perf_counter() - self._since[0]
        self.cpu += time.process_time() - self._since[1]

"""One scene, several methods, the same time for each: ``refscatter compare``.

What is measured comes as rows of results, images, and curves of error over time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..core.cache import Cache
from ..options import Options
from ..scene import read
from . import methods, metrics, race, results


@dataclass
class Subject:
    """A scene to compare methods on.

    name       as reports show it
    load       () -> ``mi.Scene``, made anew
    triangles  of its boundaries
    checked    what is known of references on this very scene and mesh, or None
    """

    name: str
    load: Callable
    triangles: int
    checked: race.Checked | None = None

    @classmethod
    def of(cls, name: str, load: Callable) -> Subject:
        """A scene of the user's, loaded once to count triangles."""
        bodies = read(load(), Options().tolerance, Cache()).bodies
        return cls(name, load, sum(body.triangle_count for body in bodies))


@dataclass
class Outcome:
    """All runs on a scene.

    subject    the scene
    setup      what all runs have in common
    reference  linear image (H, W, 3)
    about      where the reference comes from, in words
    runs       one for each method
    rows       of results, one for each method
    """

    subject: Subject
    setup: race.Setup
    reference: np.ndarray
    about: str
    runs: list[race.Run]
    rows: list[dict]


def compare(
    subject: Subject,
    names: list[str],
    setup: race.Setup,
    reference: np.ndarray | None = None,
    report: Callable = lambda stage, fraction: None,
) -> Outcome:
    """Run several methods on a scene.

    subject    the scene
    names      of the methods; the first sets the quality
    setup      what all of them have in common
    reference  image (H, W, 3), or None for a long run of ``curve``
    report     (stage, share done) is called on the way

    Rows have keys of their own: the ``seconds`` that were given, ``warm_up_seconds``, ``curve``, ``seconds_to_first``
    and ``extrapolated``. The last two are the time until the relMSE of the first method is reached, and whether that is
    extrapolated. The time is None where that never will be reached.
    """
    scene, about = subject.load(), "as given"
    size = tuple(scene.sensors()[0].film().crop_size())
    if reference is not None and reference.shape[1::-1] != size:
        raise ValueError(
            f"the reference has {reference.shape[1]} x {reference.shape[0]} pixels, the film {size[0]} x {size[1]}"
        )
    if reference is None:
        found = race.reference(scene, setup, lambda x: report("reference", x))
        reference = found.image
        known = None if setup.internal_bounces else subject.checked
        about = (f"curve at tolerance {race.REFERENCE_TOLERANCE:g}, {found.samples} samples per pixel, "
                 f"{found.wall_seconds:.1f} s; {checked_words(known)}")  # fmt: skip
    bad = int((~np.isfinite(reference)).sum())
    if bad:
        raise ValueError(f"the reference holds {bad} numbers that are not finite: give another one")
    if not reference.mean() > 0:
        raise ValueError(
            "the reference is black, so nothing can be compared with it: choose a scene in which light scatters"
        )
    runs, relmse = [], None
    for name in names:
        loaded, clear = scene, None
        if name == "volpath":
            clear = subject.load()
            methods.without_scattering(clear)
            loaded, clear = methods.for_volpath(scene), methods.for_volpath(clear)
        goal = race.Goal(setup.seconds, reference, relmse, lambda x: report(name, x))
        runs.append(race.run(loaded, name, setup, goal, clear))
        if setup.equal_quality and relmse is None:
            relmse = metrics.relmse(runs[0].image, reference)
    return Outcome(subject, setup, reference, about, runs, _rows(subject, setup, reference, runs))


def checked_words(known: race.Checked | None) -> str:
    """What a report says of its reference, of which this is known, or nothing."""
    if known is None:
        return "on this scene it was not checked itself"
    return (f"along camera rays into this scene it is within {known.l1:g} (L1) of a float64 oracle, "
            f"and within {known.bias:g} (bias) of long photon beams")  # fmt: skip


def _rows(subject, setup, reference, runs):
    rows = []
    for run in runs:
        found = metrics.all_of(run.image, reference)
        wanted = rows[0]["relmse"] if rows else found["relmse"]
        seconds, extrapolated = run.wall_seconds, False
        if rows:
            seconds, extrapolated = race.seconds_to(run.curve, wanted, race.POWERS.get(run.method))
        rows.append({
            **results.row(scene=subject.name, method=run.method, variant=setup.variant, triangles=subject.triangles,
                          settings={**run.settings, "resolution": list(reference.shape[1::-1])}, samples=run.samples,
                          wall_seconds=run.wall_seconds, cpu_seconds=run.cpu_seconds, **found),
            "seconds": setup.seconds, "warm_up_seconds": run.warm_up_seconds, "seconds_to_first": seconds,
            "extrapolated": extrapolated, "curve": run.curve,
        })  # fmt: skip
    return rows

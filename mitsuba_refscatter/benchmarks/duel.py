"""``refscatter compare``: one scene, several methods, the same time. What is measured, as rows, images and curves."""

from dataclasses import dataclass

from . import methods, metrics, race, results


@dataclass
class Subject:
    """A scene to compare on. ``load()``: makes it anew, as ``mi.Scene``; ``triangles``: of its boundaries; ``checked``: the
    ``race.Checked`` of this very scene and mesh, or None."""

    name: str
    load: object
    triangles: int
    checked: object = None

    @classmethod
    def of(cls, name, load):
        """A scene of the user's, loaded once to count triangles."""
        from ..core.cache import Cache
        from ..options import Options
        from ..scene import read

        bodies = read(load(), Options().tolerance, Cache()).bodies
        return cls(name, load, sum(body.triangle_count for body in bodies))


@dataclass
class Outcome:
    """All runs on a scene. ``reference``: linear image (H, W, 3); ``about``: in words, where it comes from."""

    subject: Subject
    setup: race.Setup
    reference: object
    about: str
    runs: list
    rows: list


def compare(subject, names, setup, reference=None, report=lambda stage, fraction: None):
    """Runs the methods ``names`` on a ``Subject``. ``reference``: image (H, W, 3), or None for a long run of ``curve``;
    ``report(stage, fraction)`` is called on the way. Returns an ``Outcome``.

    Own keys of rows: ``seconds`` that were given, ``warm_up_seconds``, ``seconds_to_first`` (until the relMSE of the first method is reached;
    None where it never will be), ``extrapolated``, ``curve``.
    """
    import numpy as np

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
    runs, wanted = [], None
    for name in names:
        loaded, clear = scene, None
        if name == "volpath":
            clear = subject.load()
            methods.without_scattering(clear)
            loaded, clear = methods.for_volpath(scene), methods.for_volpath(clear)
        run = race.run(loaded, clear, name, setup, reference, wanted, lambda x: report(name, x))
        runs.append(run)
        if setup.equal_quality and wanted is None:
            wanted = metrics.relmse(run.image, reference)
    return Outcome(subject, setup, reference, about, runs, _rows(subject, setup, reference, runs))


def checked_words(known):
    """What a report says of its reference, of which a ``race.Checked`` or nothing (None) is known."""
    if known is None:
        return "on this scene it was not checked itself"
    return (f"along camera rays into this scene it is within {known.l1:g} (L1) of a float64 oracle, and within {known.bias:g} (bias) "
            "of long photon beams")  # fmt: skip


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

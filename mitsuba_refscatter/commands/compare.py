"""The commands that put methods side by side: ``refscatter compare`` and ``refscatter gallery``."""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Optional

import mitsuba as mi
import numpy as np
import typer

from .. import image_io
from ..benchmarks import duel, race, report, results
from ..benchmarks import gallery as galleries
from ..benchmarks import suite as suites
from ..benchmarks.methods import METHODS
from .console import (
    DEFINE,
    QUIET,
    Failure,
    defines,
    load,
    measurable,
    name_of,
    out,
    plainly,
    progress,
    require,
    require_known,
    table,
    told_by_mitsuba,
)

app = typer.Typer()


@app.command()
@plainly
def compare(
    scene: Optional[Path] = typer.Argument(None, metavar="SCENE", help="Scene file in Mitsuba's XML."),
    directory: Path = typer.Option(..., "-o", "--output", help="Directory for report.html, results.json and images."),
    names: str = typer.Option(
        ",".join(METHODS),
        "--methods",
        help="Comma-separated; the first sets the quality.",
        show_default=", ".join(METHODS),
    ),
    seconds: float = typer.Option(10.0, "--seconds", min=0.1, help="Wall time of each method, after its warm-up."),
    reference: Optional[Path] = typer.Option(
        None, "--reference", help="EXR of single scattering alone. [default: a long run]"
    ),
    equal_quality: bool = typer.Option(
        False,
        "--equal-quality",
        help=f"Run on, up to {race.LONGEST:g} times as long, to the quality of the first method.",
    ),
    bounces: int = typer.Option(0, "--internal-bounces", min=0, help="Internal reflections; volpath has none here."),
    tolerance: float = typer.Option(0.01, "--tolerance", min=0.0, max=1.0, help="Of refscatter."),
    suite: bool = typer.Option(
        False, "--suite", help="Instead of a scene: all that the literature measures on, one report."
    ),
    resolution: int = typer.Option(128, "--resolution", min=1, help="Pixels on a side, of the suite's scenes."),
    variant: Optional[str] = typer.Option(None, "-m", "--mode", help="Mitsuba variant (rgb)."),
    define: list[str] = DEFINE,
    quiet: bool = QUIET,
):
    """Compare methods on a scene at equal time.

    Example: refscatter compare sphere/scene.xml --seconds 5 -o out
    """
    if suite == (scene is not None):
        raise typer.BadParameter("give a scene file or --suite", param_hint="SCENE")
    methods = require_known([name.strip() for name in names.split(",")], METHODS, "--methods", "method")
    require("matplotlib", "flip_evaluator")
    variant = measurable(variant, directory)
    if not variant.endswith("_rgb"):
        raise typer.BadParameter(f"errors are those of rgb images, not of {variant}", param_hint="-m")
    mi.set_variant(variant)
    values, setup = defines(define), race.Setup(variant, seconds, bounces, tolerance, equal_quality)
    if scene is None:
        _suite(directory, methods, setup, resolution, quiet)
        return
    with told_by_mitsuba():
        subject = replace(duel.Subject.of(name_of(scene), lambda: load(scene, values)), checked=race.checked(scene))
        outcome = _run(subject, methods, setup, quiet, None if reference is None else _image_at(reference))
    _write(directory, [outcome], quiet)


@app.command()
@plainly
def gallery(
    directory: Path = typer.Option(..., "-o", "--output", help="Directory for the three strips, as PNG."),
    size: int = typer.Option(200, "--resolution", min=1, help="Pixels on a side of each tile."),
    samples: int = typer.Option(4, "--samples", min=1, help="Samples per pixel."),
    seconds: float = typer.Option(5.0, "--seconds", min=0.1, help="Wall time of each method, in the strip of methods."),
    variant: Optional[str] = typer.Option(None, "-m", "--mode", help="Mitsuba variant (rgb)."),
    quiet: bool = QUIET,
):
    """Make the pictures of the README's gallery.

    Example: refscatter gallery -o out
    """
    require("matplotlib", "flip_evaluator")
    variant = measurable(variant, directory)
    mi.set_variant(variant)
    with progress("gallery", None, quiet) as tell:
        setup = race.Setup(variant, seconds)
        for path in galleries.write(directory, size, samples, setup, lambda name: tell(0, f"gallery: {name}")):
            if not quiet:
                out.print(str(path), markup=False)


def _suite(directory, methods, setup, resolution, quiet):
    """All cases, of each those of the ``methods`` that it is for."""
    outcomes = []
    with tempfile.TemporaryDirectory() as files:
        for case in suites.CASES:
            wanted = [name for name in methods if name in case.methods]
            if methods[0] in wanted:  # which sets the quality
                of_case = replace(setup, internal_bounces=case.internal_bounces)
                outcomes.append(_run(case.subject(files, resolution), wanted, of_case, quiet))
                _write(directory, outcomes, quiet, suites.summary(outcomes))


def _image_at(path):
    """The main image (H, W, 3) of an EXR."""
    try:
        bitmap = mi.Bitmap(str(path))
    except RuntimeError as error:
        raise Failure(f"{path} cannot be read as an image") from error
    found = image_io.rgb_of(bitmap)
    if found is None:
        raise Failure(f"{path} has no red, green and blue channels")
    return np.asarray(found, dtype=np.float64)


def _run(subject, methods, setup, quiet, reference=None):
    """``duel.compare`` with a progress bar, and its table."""
    total = len(methods) + (race.REFERENCE_TIME if reference is None else 0)
    with progress(subject.name, total, quiet) as tell:
        done, weight = {}, {"reference": race.REFERENCE_TIME}

        def report(stage, fraction):
            done[stage] = weight.get(stage, 1.0) * fraction
            tell(sum(done.values()), f"{subject.name}: {stage}")

        outcome = duel.compare(subject, methods, setup, reference, report)
    if not quiet:
        _show(outcome, methods)
    return outcome


def _show(outcome, methods):
    """Prints the table of an outcome."""
    shown = table(
        "method", "samples", "wall s", "warm-up s", "relMSE", "L1", "p99", "bias", "FLIP", f"s to {methods[0]}"
    )
    for row in outcome.rows:
        to_first = (
            "-"
            if row["seconds_to_first"] is None
            else f"{row['seconds_to_first']:.3g}{' (extrapolated)' if row['extrapolated'] else ''}"
        )
        shown.add_row(row["method"], str(row["samples"]), f"{row['wall_seconds']:.2f}", f"{row['warm_up_seconds']:.1f}",
                      *(f"{row[key]:.2e}" for key in ("relmse", "mean_relative_error", "p99_relative_error")),
                      f"{row['bias']:+.1e}", f"{row['flip']:.3f}", to_first)  # fmt: skip
    subject = outcome.subject
    out.print(f"{subject.name}, {subject.triangles} triangles; reference: {outcome.about}", markup=False)
    out.print(shown)


def _write(directory, outcomes, quiet, summary=""):
    """Images of the last outcome, results and report of all."""
    for outcome in outcomes[-1:]:
        factor = image_io.exposure(outcome.reference)
        where = directory / outcome.subject.name if summary else directory
        image_io.directory(where)
        header = image_io.about(outcome.about, outcome.subject.name)
        image_io.write_image(where / "reference.exr", outcome.reference, factor, header)
        for run in outcome.runs:
            header = image_io.about(json.dumps(run.settings), outcome.subject.name, run.samples, run.seed)
            image_io.write_image(where / f"{run.method}.exr", run.image, factor, header)
    rows = [row for outcome in outcomes for row in outcome.rows]
    path = results.write(directory, rows)
    report.write(directory / "report.html", outcomes, results.machine(), summary)
    if not quiet:
        out.print(str(directory / "report.html"), str(path), sep="\n", markup=False)

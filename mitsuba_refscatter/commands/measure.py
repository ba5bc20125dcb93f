"""The commands that measure one thing: scaling, convergence, equal-error, tradeoff and, along one camera ray, probe."""

from __future__ import annotations

from pathlib import Path
from typing import Optional

import mitsuba as mi
import typer

from .. import example_scenes, image_io
from ..benchmarks import convergence as convergence_runs
from ..benchmarks import equal_error as equal_error_runs
from ..benchmarks import plotting, results
from ..benchmarks import scaling as scaling_runs
from ..benchmarks import tradeoff as tradeoff_runs
from ..culling import CULLINGS
from ..probing import numbers, picture, view
from ..probing import probe as probe_ray
from .console import (
    DEFINE,
    QUIET,
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


def _write(directory, name, figure, rows):
    """Write a plot and ``results.json`` of all rows so far to a directory; return both paths."""
    plot = directory / name
    image_io.write_file(plot, lambda unfinished: plotting.save(figure(rows), unfinished))
    return [plot, results.write(directory, rows)]


def _show(quiet, shown, lines):
    """Print a table and lines below it, unless ``quiet``."""
    if not quiet:
        out.print(shown)
        out.print(*lines, sep="\n", markup=False)


@app.command()
@plainly
def scaling(
    directory: Optional[Path] = typer.Option(
        None, "-o", "--output", help="Directory for scaling.png and results.json. [default: print only]"
    ),
    triangles: list[int] = typer.Option(
        list(scaling_runs.SIZES), "--triangles", min=1, help="Triangles of the body; repeatable."
    ),
    scene: str = typer.Option("bumpy_sphere", "--scene", help="One of the scenes made by code."),
    resolution: int = typer.Option(256, "--resolution", min=1, help="Pixels on a side."),
    samples: int = typer.Option(64, "--samples", min=1, help="Samples per pixel of volpath."),
    bounces: int = typer.Option(
        0, "--internal-bounces", min=0, help="Of refscatter; volpath has none in this comparison."
    ),
    tolerance: float = typer.Option(0.01, "--tolerance", min=0.0, max=1.0, help="Of refscatter."),
    methods: list[str] = typer.Option(
        list(scaling_runs.OURS), "--method", help="Method to compare with volpath; repeatable."
    ),
    variant: Optional[str] = typer.Option(None, "-m", "--mode", help="Mitsuba variant."),
    quiet: bool = QUIET,
):
    """Measure cost against triangles, in samples of volpath.

    Example: refscatter scaling --triangles 1280 --triangles 5120 -o out
    """
    if quiet and directory is None:
        raise typer.BadParameter("without -o nothing would be left of the results", param_hint="--quiet")
    require_known([scene], example_scenes.BODIES, "--scene", "scene")
    methods = require_known(methods, scaling_runs.OURS, "--method", "method")
    if directory is not None:
        require("matplotlib")
    variant = measurable(variant, directory)
    shown = table("triangles", "method", "wall s", "CPU s", "volpath spp, same wall", "same CPU", "candidates/ray",
                  "contributing/ray", "L1 error", "first s", "peak MiB")  # fmt: skip
    rows, written = [], []
    with progress("scaling", len(triangles), quiet) as tell:
        runs = scaling_runs.run(
            triangles, scene=scene, resolution=resolution, samples=samples, internal_bounces=bounces,
            tolerance=tolerance, methods=tuple(methods), variant=variant,
        )  # fmt: skip
        for number, found in enumerate(runs, 1):
            rows += found
            for row in found[:-1]:
                shown.add_row(*_scaling_cells(row))
            if directory is not None:
                written = _write(directory, "scaling.png", scaling_runs.figure, rows)
            tell(number)
    grows = [f"{method}: {key} grows with triangles^{power:.2f}"
             for (method, key), power in scaling_runs.exponents(rows).items()]  # fmt: skip
    _show(quiet, shown, [*grows, *written])


def _scaling_cells(row):
    """What the table of ``scaling`` shows of a row of results."""
    memory = row["peak_memory_bytes"]
    return (
        str(row["triangles"]), row["method"], f"{row['wall_seconds']:.2f}", f"{row['cpu_seconds']:.2f}",
        *(f"{row[f'volpath_samples_of_same_{kind}_time']:.0f}" for kind in ("wall", "cpu")),
        *("" if row[key] is None else f"{row[key]:.0f}" for key in ("candidates_per_ray", "contributing_per_ray")),
        f"{row['mean_relative_error']:.1e}", f"{row['first_seconds']:.1f}",
        "" if memory is None else f"{memory / 2**20:.0f}",
    )  # fmt: skip


@app.command()
@plainly
def convergence(
    directory: Path = typer.Option(..., "-o", "--output", help="Directory for convergence.png and results.json."),
    scenes: list[str] = typer.Option(
        list(convergence_runs.SCENES), "--scene", help="One of the scenes made by code; repeatable."
    ),
    resolution: int = typer.Option(32, "--resolution", min=1, help="Pixels on a side."),
    most: int = typer.Option(16384, "--most", min=16, help="Largest number of samples."),
    variant: Optional[str] = typer.Option(None, "-m", "--mode", help="Mitsuba variant."),
    quiet: bool = QUIET,
):
    """Plot how interval and point come to what the curve finds.

    Example: refscatter convergence --scene bumpy_sphere --most 1024 -o out
    """
    scenes = require_known(scenes, example_scenes.BODIES, "--scene", "scene")
    require("matplotlib")
    variant = measurable(variant, directory)
    shown, rows = table("scene", "estimator", "samples", "L1 difference", "bias", "wall s"), []

    def add(row):
        shown.add_row(row["scene"], row["method"], str(row["samples"]), f"{row['mean_relative_error']:.1e}",
                      f"{row['bias']:+.1e}", f"{row['wall_seconds']:.2f}")  # fmt: skip
        rows.append(row)
        tell(len(rows), row["scene"])

    counts = [n for samples in convergence_runs.SAMPLES.values() for n in samples if n <= most]
    with progress("convergence", len(scenes) * len(counts), quiet) as tell:
        for name in scenes:
            convergence_runs.run(name, most, add, variant=variant, resolution=resolution)
    _show(quiet, shown, _write(directory, "convergence.png", convergence_runs.figure, rows))


@app.command()
@plainly
def equal_error(
    directory: Path = typer.Option(..., "-o", "--output", help="Directory for equal_error.png and results.json."),
    error: float = typer.Option(0.01, "--error", min=1e-4, max=1.0, help="Relative error of the image that is wanted."),
    triangles: int = typer.Option(5120, "--triangles", min=20, help="Triangles of the body."),
    resolution: int = typer.Option(128, "--resolution", min=1, help="Pixels on a side."),
    radius: float = typer.Option(
        0.05, "--radius", min=1e-4, help="Radius of the light that volpath is extrapolated to."
    ),
    radii: list[float] = typer.Option(
        [0.4, 0.2, 0.1], "--volpath-radius", help="Radius that volpath renders; repeatable."
    ),
    seconds: float = typer.Option(40.0, "--seconds", min=0.0, help="Time for which volpath renders each light."),
    variant: Optional[str] = typer.Option(None, "-m", "--mode", help="Mitsuba variant."),
    quiet: bool = QUIET,
):
    """Measure the time to an error under lights that are no points.

    Example: refscatter equal-error --error 0.05 --resolution 64 -o out
    """
    require("matplotlib")
    variant = measurable(variant, directory)
    shown = table("light", "method", "samples", "wall s", "error", f"s to {error:.2g}", "times faster")

    def add(row):
        time_to = "" if row["seconds_to_error"] is None else f"{row['seconds_to_error']:.3g}"
        shown.add_row(
            row["light"] if row["radius"] is None else f"{row['light']} {row['radius']:g}", row["method"],
            "" if row["samples"] is None else str(row["samples"]),
            "" if row["wall_seconds"] is None else f"{row['wall_seconds']:.2f}",
            "" if row["mean_relative_error"] is None else f"{row['mean_relative_error']:.2g}",
            time_to + (" (extrapolated)" if row["extrapolated"] else ""),
            f"{row['speedup']:.3g}" if "speedup" in row else "",
        )  # fmt: skip
        rows.append(row)
        tell(len(rows), f"{row['light']} {row['method']}")

    rows = []
    setup = equal_error_runs.Setup(
        variant=variant, error=error, triangles=triangles, resolution=resolution, radius=radius, radii=tuple(radii),
        seconds=seconds,
    )  # fmt: skip
    with progress("equal-error", len(radii) + equal_error_runs.OTHER_ROWS, quiet) as tell:
        equal_error_runs.run(setup, add)
    _show(quiet, shown, _write(directory, "equal_error.png", equal_error_runs.figure, rows))


@app.command()
@plainly
def tradeoff(
    scene: list[Path] = typer.Argument(..., metavar="SCENE...", help="Scene files in Mitsuba's XML."),
    directory: Path = typer.Option(..., "-o", "--output", help="Directory for tradeoff.png and results.json."),
    bounces: int = typer.Option(4, "--internal-bounces", min=0, help="Internal reflections."),
    samples: int = typer.Option(1, "--samples", min=1, help="Samples per pixel."),
    tolerance: list[float] = typer.Option(
        list(tradeoff_runs.TOLERANCES), "--tolerance", min=0.0, max=1.0, help="Tolerance; repeatable."
    ),
    choices: bool = typer.Option(True, help="Switch what the tolerance decides singly, too."),
    variant: Optional[str] = typer.Option(None, "-m", "--mode", help="Mitsuba variant (rgb)."),
    define: list[str] = DEFINE,
    quiet: bool = QUIET,
):
    """Measure error and time over the tolerance and its choices.

    Example: refscatter tradeoff sphere/scene.xml -D res=128 -o out
    """
    require("matplotlib", "flip_evaluator")
    variant = measurable(variant, directory)
    mi.set_variant(variant)
    shown = table(
        "scene", "tolerance or choice", "expected", "L1 error", "bias", "p99", "FLIP", "wall s", "CPU s", "first s"
    )

    def add(row):
        shown.add_row(
            row["scene"], row["method"], *(f"{row[key]:{form}}" for key, form in (
                ("estimated_error", ".1e"), ("mean_relative_error", ".1e"), ("bias", "+.1e"),
                ("p99_relative_error", ".1e"), ("flip", ".4f"), ("wall_seconds", ".2f"), ("cpu_seconds", ".2f"),
                ("first_seconds", ".1f"))),
        )  # fmt: skip

    rows, setup = [], tradeoff_runs.Setup(variant, tuple(tolerance), choices, bounces, samples)
    for path in scene:
        name = name_of(path)
        with progress(name, 1.0, quiet) as tell:
            rows += tradeoff_runs.run(name, load(path, defines(define)), setup, add, tell)
        written = _write(directory, "tradeoff.png", tradeoff_runs.figure, rows)
    _show(quiet, shown, written)


@app.command()
@plainly
def probe(
    scene: Path = typer.Argument(..., metavar="SCENE", help="Scene file in Mitsuba's XML."),
    pixel: tuple[int, int] = typer.Option(..., "--pixel", metavar="X Y", help="Pixel, from the upper left corner."),
    directory: Path = typer.Option(..., "-o", "--output", help="Directory for probe.png, probe.html and probe.json."),
    segment: int = typer.Option(0, "--segment", min=0, help="Segment of the ray inside bodies, by weight."),
    parts: int = typer.Option(512, "--parts", min=2, help="Parts of it over which the total is averaged."),
    samples: int = typer.Option(64, "--samples", min=1, help="Samples of the estimator point."),
    bounces: int = typer.Option(4, "--internal-bounces", min=0, help="Internal reflections."),
    tolerance: float = typer.Option(0.001, "--tolerance", min=0.0, max=1.0, help="Relative error aimed at."),
    culling: str = typer.Option("beams", "--culling", help="How triangles are found: beams or spindle."),
    variant: Optional[str] = typer.Option(None, "-m", "--mode", help="Mitsuba variant (rgb or mono)."),
    define: list[str] = DEFINE,
):
    """Show what is added up along one camera ray.

    Example: refscatter probe sphere/scene.xml --pixel 40 30 -D res=64 -o out
    """
    require_known([culling], CULLINGS, "--culling", "culling")
    require("matplotlib", "plotly")
    variant = measurable(variant, directory)
    mi.set_variant(variant)
    loaded = load(scene, defines(define))
    with told_by_mitsuba():
        found = probe_ray(loaded, *pixel, segment=segment, parts=parts, samples=samples, tolerance=tolerance,
                          internal_bounces=bounces, culling=culling)  # fmt: skip
    name = str(scene)
    image_io.write_file(
        directory / "probe.json", lambda path: path.write_text(numbers.text_of(found, name), encoding="utf-8")
    )
    image_io.write_file(directory / "probe.png", lambda path: picture.draw(found, path))
    image_io.write_file(directory / "probe.html", lambda path: view.write(found, path))
    out.print(numbers.summary(found), markup=False)
    for end in ("png", "html", "json"):
        out.print(str(directory / f"probe.{end}"), markup=False)

"""The command ``refscatter``: here are render, check, supported and scenes, in ``compare`` and ``measure`` the others.

Errors are one sentence on stderr; the exit codes stand at the end of ``refscatter --help``.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Optional

import mitsuba as mi
import typer
from rich.table import Table

from .. import example_scenes, image_io, platform
from ..integrators.hooks import Hooks, takes_hooks
from ..scene import support
from . import compare, console, measure
from .console import (
    DEFINE,
    QUIET,
    Failure,
    UsageError,
    defines,
    err,
    load,
    logged_on_stderr,
    out,
    plainly,
    progress,
    stop_on_sigterm,
    tell_usage,
    told_by_mitsuba,
)

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    epilog="Exit codes: 0 done, 1 error, 2 wrong usage, 130 Ctrl-C, 143 SIGTERM.",
)
_OURS = ("RefscatterIntegrator[", "StraightIntegrator[", "PhotonIntegrator[")
_WRAPPERS = ("AOVIntegrator", "MomentIntegrator")
SEED = 0


def _is_ours(integrator) -> bool:
    """Whether a plugin of this package renders, by itself or as the child of ``aov`` or ``moment``."""
    if takes_hooks(integrator):
        return True
    return integrator is not None and integrator.class_name() in _WRAPPERS and any(x in str(integrator) for x in _OURS)


def _integrator(scene, say):
    """The scene's integrator if it is one of ours, otherwise a new ``refscatter``."""
    found = scene.integrator()
    if _is_ours(found):
        return found
    name = "no integrator" if found is None else f"the integrator {found.class_name()}"
    say(f"The scene has {name}: rendering with refscatter instead.")
    return mi.load_dict({"type": "refscatter"})


def _render(scene, integrator, spp: int, quiet: bool):
    """Render and return the film's bitmap, all channels."""
    sensor, ours = scene.sensors()[0], takes_hooks(integrator)
    with progress("rendering", 1.0 if ours else None, quiet) as tell:
        # Not mi.render: it hides what an integrator raises, Ctrl-C included, behind its own error.
        told = {"hooks": Hooks(progress=tell)} if ours else {}
        integrator.render(scene, sensor=sensor, seed=SEED, spp=spp, develop=False, **told)
        return sensor.film().bitmap()


@app.callback(invoke_without_command=True)
def shared(
    context: typer.Context,
    debug: bool = typer.Option(False, "--debug", help="Show tracebacks of errors; stands before the command."),
):
    """Volume caustics without noise, for Mitsuba 3.

    Example: refscatter scenes sphere; refscatter render sphere/scene.xml
    """
    console.debug = debug
    if context.invoked_subcommand is None:
        print(context.get_help())
        raise typer.Exit(2)


@app.command()
@plainly
def render(
    scene: Path = typer.Argument(..., metavar="SCENE", help="Scene file in Mitsuba's XML."),
    file: Optional[Path] = typer.Option(
        None, "-o", "--output", help="EXR file to write, a PNG goes beside it. [default: SCENE's name, here]"
    ),
    variant: Optional[str] = typer.Option(
        None, "-m", "--mode", help=f"Mitsuba variant. [default: the first usable of {', '.join(platform.PREFERRED)}]"
    ),
    spp: int = typer.Option(0, "-s", "--spp", "--samples", min=0, help="Samples per pixel; 0 leaves it to the scene."),
    define: list[str] = DEFINE,
    quiet: bool = QUIET,
):
    """Render a scene file to an EXR and a tone-mapped PNG.

    The scene's own integrator is used if it is refscatter, otherwise refscatter takes its place.

    Example: refscatter render sphere/scene.xml -s 16 -D res=256 -o sphere.exr
    """
    values = defines(define)
    # Before Mitsuba touches LLVM: an unsuitable one can end the process.
    variant = variant or platform.default_variant()
    platform.require_usable(variant)
    path = image_io.target(file if file is not None else Path(scene.stem + ".exr"))
    mi.set_variant(variant)
    if quiet:
        mi.set_log_level(mi.LogLevel.Error)
    say = (lambda text: None) if quiet else (lambda text: err.print(text, markup=False))
    start = time.perf_counter()
    with logged_on_stderr():
        loaded = load(scene, values)
        integrator = _integrator(loaded, say)
        say(f"Rendering {scene} in {variant} ...")
        if variant.startswith("cuda"):
            say(f"Check the picture: {platform.GPU_REMARK}.")
        with told_by_mitsuba():
            bitmap = _render(loaded, integrator, spp, quiet)
    header = image_io.about(integrator, scene.name, spp or loaded.sensors()[0].sampler().sample_count(), SEED)
    written = image_io.write_image(path, bitmap, header=header)
    if not quiet:
        err.print(f"Done in {time.perf_counter() - start:.1f} s:")
        for name in written:
            if name is not None:
                out.print(str(name), markup=False)


@app.command()
@plainly
def check():
    """Say what is installed, what is usable and what to do.

    Example: refscatter check
    """
    report = platform.report()
    table = Table.grid(padding=(0, 2))
    table.add_row("Mitsuba", report.mitsuba)
    table.add_row("Dr.Jit", report.drjit)
    table.add_row("LLVM", report.llvm.text + (f"  ({report.llvm.path})" if report.llvm.path else ""))
    table.add_row("GPU", f"usable, but {platform.GPU_REMARK}" if report.gpu_problem is None else "none")
    out.print(table)
    usable = [name for name, problem in report.variants.items() if problem is None]
    out.print(f"\nUsable variants: {', '.join(usable) or 'none'}")
    for problem in dict.fromkeys(problem for problem in report.variants.values() if problem is not None):
        names = ", ".join(name for name, p in report.variants.items() if p == problem)
        out.print(f"Not usable: {names}\n  {problem}", markup=False)
    if report.default is None:
        raise Failure(f"nothing can be rendered on this machine: {report.problem}")
    out.print(f"Renders use {report.default} unless told otherwise.")


@app.command()
@plainly
def supported():
    """Print what a scene may hold and what is refused.

    Example: refscatter supported > table.md
    """
    print(support.table())


@app.command()
@plainly
def scenes(
    name: Optional[str] = typer.Argument(None, metavar="NAME", help="Scene to write; none lists them."),
    triangles: Optional[int] = typer.Option(
        None, "--triangles", min=1, help="Triangles of the body; the nearest possible number is taken."
    ),
    directory: Optional[Path] = typer.Option(
        None, "-o", "--output", help="Directory for scene.xml and meshes/. [default: NAME, here]"
    ),
):
    """List the scenes made by code, or write one as XML and mesh.

    Example: refscatter scenes bumpy_sphere --triangles 5120 -o out
    """
    if name is None:
        for key, scene in example_scenes.SCENES.items():
            out.print(f"{key:13} {scene.triangles:6} triangles  {' '.join(scene.comment.split())}", markup=False)
        return
    directory = Path(name) if directory is None else directory
    try:
        with progress("writing", None):
            path, count = example_scenes.write_scene(name, directory, triangles)
    except OSError as error:
        raise Failure(f"nothing can be written in {directory}: {error.strerror}") from error
    out.print(f"{path}  ({count} triangles)", markup=False)


app.registered_commands += compare.app.registered_commands + measure.app.registered_commands


def main() -> None:
    """Run the command and leave the process with its exit code."""
    stop_on_sigterm()
    try:
        code = app(prog_name="refscatter", standalone_mode=False)
    except UsageError as error:
        tell_usage(error)
        code = 2
    sys.exit(code)

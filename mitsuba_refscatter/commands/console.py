"""What all commands share: consoles, tables, progress bars, options, loading scenes, errors told in one sentence."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import re
import signal
import sys
import traceback
from collections.abc import Collection
from pathlib import Path
from typing import Optional

import mitsuba as mi
import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from .. import example_scenes, image_io, platform
from ..core.spelling import advice, near
from . import meshcheck

WIDE = 160  # columns of tables that go to a file
out = Console(highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() else WIDE)
err = Console(stderr=True, highlight=False, soft_wrap=True)
debug = False
"""Whether errors are shown with their tracebacks: the option ``--debug``."""
UsageError = typer.BadParameter.__bases__[0]
"""Click's, or that of the copy of it that newer versions of typer hold."""
QUIET = typer.Option(False, "--quiet", help="Print errors only.")
DEFINE = typer.Option([], "-D", "--define", metavar="NAME=VALUE", help="Set a parameter of the scene.")


class Failure(Exception):
    """An error that is told to the user in one sentence."""


class Terminated(KeyboardInterrupt):
    """SIGTERM came."""


def stop_on_sigterm() -> None:
    """Let SIGTERM end a command as Ctrl-C does: what is unfinished is removed."""

    def stop(_number, _frame):
        raise Terminated

    signal.signal(signal.SIGTERM, stop)


@contextlib.contextmanager
def logged_on_stderr():
    """Let what Mitsuba logs meanwhile go to stderr, as it is said; its own log is on stdout, where results are."""

    class Stderr(mi.Appender):
        def append(self, level, text):
            if level == mi.LogLevel.Warn:
                text = f"Warning: {text.removeprefix('refscatter: ')}"
            err.print(text, markup=False, highlight=False)

        def log_progress(self, *_):
            pass

    class Plain(mi.Formatter):
        def format(self, *known):
            return re.sub(r"^\w+\(\): ", "", known[-1])  # without the name of the function that said it

    logger, ours, formatter = mi.logger(), Stderr(), Plain()
    others, usual = [logger.appender(i) for i in range(logger.appender_count())], logger.formatter()
    logger.clear_appenders()
    logger.add_appender(ours)
    logger.set_formatter(formatter)
    try:
        yield
    finally:
        logger.clear_appenders()
        for appender in others:
            logger.add_appender(appender)
        logger.set_formatter(usual)


_EXPECTED = (
    Failure,
    platform.PlatformError,
    image_io.OutputError,
    meshcheck.MeshError,
    example_scenes.BodyError,
)
"""Errors whose message is all that a user needs."""


def plainly(command):
    """Let a command end with one sentence and an exit code; a traceback comes before only with ``--debug``."""

    @functools.wraps(command)
    def wrapped(*args, **kwargs):
        try:
            return command(*args, **kwargs)
        except KeyboardInterrupt as stop:
            err.print("refscatter: stopped; no file is left unfinished")
            raise typer.Exit(143 if isinstance(stop, Terminated) else 130) from None
        except (typer.Exit, UsageError, BrokenPipeError):
            raise
        except Exception as error:
            if debug:
                err.print("".join(traceback.format_exception(type(error), error, error.__traceback__)), markup=False)
            if isinstance(error, _EXPECTED):
                err.print(f"refscatter: {error}", markup=False)
            else:
                err.print(f"refscatter: {type(error).__name__}, which should not happen: {cause(error)}", markup=False)
                err.print("Where it came from: refscatter --debug ...")
            raise typer.Exit(1) from None

    return wrapped


def tell_usage(error) -> None:
    """Say in one line what is wrong with the arguments of a command, and in another where its help is."""
    text = " ".join(error.format_message().split()).rstrip(".")
    context = error.ctx
    if context is not None and hasattr(error, "option_name") and hasattr(error, "possibilities"):
        known = [name for option in context.command.get_params(context) for name in option.opts if name.startswith("-")]
        text = f"there is no option {error.option_name}: {near(error.option_name, known)}".rstrip(": ")
    err.print(f"refscatter: {text[:1].lower()}{text[1:]}", markup=False)
    err.print(f"Try: {context.command_path if context is not None else 'refscatter'} --help", markup=False)


def require(*modules: str) -> None:
    """``Failure`` with what to install where some of these are missing.

    The advice fits a checkout and an installed wheel alike. pip takes the names of modules here, as an underscore is a
    hyphen to it.
    """
    absent = [name for name in modules if importlib.util.find_spec(name) is None]
    if absent:
        raise Failure(f"this needs {' and '.join(absent)}: {sys.executable} -m pip install {' '.join(absent)}")


def require_known(names: list[str], known: Collection[str], option: str, kind: str) -> list[str]:
    """The names that an option was given, each once, if all of them are known; ``kind``: what they are names of."""
    for name in names:
        if name not in known:
            raise typer.BadParameter(f"there is no {kind} '{name}': {advice(name, known)}", param_hint=option)
    return list(dict.fromkeys(names))


def measurable(variant: Optional[str], directory: Optional[Path]) -> str:
    """The variant to measure in, once it is certain that it runs and that results can be written."""
    variant = variant or platform.default_variant()
    platform.require_usable(variant)
    if directory is not None:
        image_io.directory(directory)
    return variant


def table(*headings: str) -> Table:
    """A plain table: names to the left, numbers to the right."""
    out = Table(box=None, pad_edge=False)
    for heading in headings:
        out.add_column(heading, justify="left" if heading in ("light", "method", "scene", "estimator") else "right")
    return out


@contextlib.contextmanager
def progress(what: str, total: Optional[float] = 1.0, quiet: bool = False):
    """Show a bar on stderr with the time left, gone at the end; none where that is no terminal.

    what   that is done, as the bar shows it
    total  work that there is, None if that is not known
    quiet  whether there is no bar

    Gives ``tell(completed, what)``: how much of ``total`` is done, and of what, if that changes.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err, disable=quiet or not err.is_terminal, transient=True) as bar:
        task = bar.add_task(escape(what), total=total)

        def tell(completed: float, what: Optional[str] = None):
            bar.update(task, completed=completed, description=None if what is None else escape(what))

        yield tell


def cause(error: BaseException) -> str:
    """Mitsuba's message on one line, without source positions and the traceback of a Python plugin.

    >>> cause(RuntimeError("[parser.cpp:12] Found an error:\\n  - float"))
    'Found an error: float'
    """
    text = str(error)
    before, traceback, after = text.partition("Traceback (most recent call last):")
    if traceback:
        last = after.rpartition("Traceback (most recent call last):")[2]
        told = [line for line in last.splitlines() if line and not line.startswith(" ")]
        text = before + re.sub(r"^[\w.]+: ", "", " ".join(told))
    text = re.sub(r"\[[\w.]+\.(?:cpp|h):\d+\]\s*", "", text)
    text = re.sub(r"\s*\n\s*(?:- )?", " ", text).strip()
    return text or type(error).__name__


@contextlib.contextmanager
def told_by_mitsuba():
    """Turn what Mitsuba and this package raise for a scene or its options into a ``Failure``."""
    try:
        yield
    except (RuntimeError, ValueError, TypeError) as error:
        raise Failure(cause(error)) from error


def defines(pairs: list[str]) -> dict[str, str]:
    """What the options ``-D`` say; typer's ``BadParameter`` where one is not of the form NAME=VALUE.

    >>> defines(["res=64", "file=a=b.exr"])
    {'res': '64', 'file': 'a=b.exr'}
    """
    values = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not name or not equals:
            raise typer.BadParameter(f"'{pair}' is not of the form name=value", param_hint="-D")
        values[name] = value
    return values


def _unused_parameter(scene: Path, values: dict[str, str], error: BaseException) -> Optional[str]:
    """What to say where a scene has no parameter of a name in ``values``; None where the error is another one."""
    if "unused parameters" not in str(error):
        return None
    known = sorted(set(re.findall(r"\$(\w+)", scene.read_text("utf-8", "replace"))))
    name = next((name for name in values if name not in known), None)
    if name is None:
        return None
    way = advice(name, known) if known else f'write <default name="{name}" value="..."/> and ${name}'
    return f'{scene} has no parameter "{name}": {way}'


def name_of(scene: Path) -> str:
    """What results call a scene file: its folder's name if it is scene.xml, else its own.

    >>> name_of(Path("amber/scene.xml")), name_of(Path("amber/dark.xml"))
    ('amber', 'dark')
    """
    return scene.resolve().parent.name if scene.stem == "scene" else scene.stem


def load(scene: Path, values: dict[str, str]) -> mi.Scene:
    """Load a scene file with these parameters; ``Failure`` says why it can't be."""
    if not scene.is_file():
        name = scene.parent.name
        ours = scene.name == "scene.xml" and name in example_scenes.SCENES
        way = f": refscatter scenes {name} -o {scene.parent} writes it" if ours else ""
        raise Failure(f"there is no scene file {scene}{way}")
    meshcheck.check_scene(scene, values)
    try:
        loaded = example_scenes.load(scene, **values)
    except (RuntimeError, ValueError, TypeError) as error:
        raise Failure(_unused_parameter(scene, values, error) or cause(error)) from error
    if not isinstance(loaded, mi.Scene):
        raise Failure(f"{scene} does not hold a scene")
    if not loaded.sensors():
        raise Failure(f"{scene} has no sensor: add one")
    return loaded

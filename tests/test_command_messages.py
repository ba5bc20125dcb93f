"""What the command says: help, typing errors, tracebacks only where asked for, progress bars."""

import dataclasses
import io
import re

import mitsuba as mi
import OpenEXR
import pytest
import rich.console
from test_commands import SPHERE, assert_one_sentence, needs_variant, refscatter, scene_file
from typer.main import get_command
from typer.testing import CliRunner

from mitsuba_refscatter import platform
from mitsuba_refscatter.commands import console, main
from mitsuba_refscatter.core import spelling

COMMANDS = sorted(get_command(main.app).commands)
LINES, COLUMNS = 40, 80


def fits(text):
    lines = text.splitlines()
    assert len(lines) <= LINES and max(len(line) for line in lines) <= COLUMNS, text
    assert sum("Example: refscatter" in line for line in lines) == 1, text


def test_without_arguments_the_command_says_how_to_use_it():
    done = refscatter(COLUMNS=str(COLUMNS))
    fits(done.stdout)
    assert done.returncode == 2 and all(f"\n  {name} " in done.stdout for name in COMMANDS)
    assert "..." not in done.stdout.partition("Commands:")[2], "a summary is cut off"
    assert "Exit codes: 0 done, 1 error, 2 wrong usage, 130 Ctrl-C, 143 SIGTERM" in done.stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_help_fits_a_screen_and_shows_an_example(name):
    """The example is one line and its options are those of the command."""
    done = CliRunner(env={"COLUMNS": str(COLUMNS)}).invoke(main.app, [name, "--help"])
    assert done.exit_code == 0
    fits(done.stdout)
    (example,) = re.findall(rf"Example: refscatter {name}\b.*", done.stdout)
    for option in re.findall(r" (--?[a-zA-Z][\w-]*)", example):
        assert re.search(rf"^ .*{option}[ ,]", done.stdout.partition("Options:")[2], re.MULTILINE), option


@pytest.mark.parametrize("arguments, near", [
    (["rendr", SPHERE], "render"),
    (["--debgu", "check"], "--debug"),
    (["render", SPHERE, "--smaples", "2"], "--samples"),
    (["tradeoff", SPHERE, "--tolerence", "0.1"], "--tolerance"),
    (["scaling", "--method", "holzschuh2015"], "holzschuch2015"),
    (["scaling", "--scene", "shpere"], "sphere"),
    (["convergence", "--scene", "brnaches", "-o", "out"], "branches"),
    (["compare", SPHERE, "--methods", "refscatter,volpth", "-o", "out"], "volpath"),
], ids=lambda x: " ".join(str(y) for y in x if y != SPHERE) if isinstance(x, list) else x)  # fmt: skip
def test_a_typing_error_is_answered_with_the_near_name(arguments, near, tmp_path):
    done = refscatter(*arguments, cwd=tmp_path)
    assert_one_sentence(done, near, code=2)
    assert re.search(rf"did you mean '?{near}'?\?", done.stderr, re.IGNORECASE), done.stderr
    assert re.fullmatch(r"Try: refscatter( \w+)? --help", done.stderr.splitlines()[1])
    assert not list(tmp_path.iterdir())


def test_near_names_where_the_usage_is_right():
    assert_one_sentence(refscatter("scenes", "shpere"), "did you mean sphere?")
    assert_one_sentence(refscatter("render", SPHERE, "-m", "llvm_ad_rbg"), "did you mean llvm_ad_rgb?")
    assert_one_sentence(refscatter("render", SPHERE, "-D", "rez=16"), "did you mean res?")
    assert "did you mean" not in spelling.advice("xyz", ["curve", "point"])


def test_a_gpu_is_said_to_be_untried(rgb, monkeypatch, tmp_path):
    """By ``check`` of one that looks usable, and at the start of a render on it, which here is as far as it goes."""

    def stop(*_):
        raise RuntimeError("far enough")

    report = dataclasses.replace(platform.report(), gpu_problem=None)
    monkeypatch.setattr(platform, "report", lambda: report)
    assert re.search(rf"^GPU +usable, but {platform.GPU_REMARK}", CliRunner().invoke(main.app, ["check"]).stdout, re.M)
    monkeypatch.setattr(platform, "require_usable", lambda name: None)
    monkeypatch.setattr(mi, "set_variant", lambda name: None)
    monkeypatch.setattr(main, "_render", stop)
    for variant in (rgb, "cuda_ad_rgb"):
        monkeypatch.setattr(main, "err", rich.console.Console(file=io.StringIO(), soft_wrap=True))
        CliRunner().invoke(main.app, ["render", str(SPHERE), "-m", variant, "-o", str(tmp_path / "out.exr")])
        told = main.err.file.getvalue()
        assert f"in {variant} ..." in told and (platform.GPU_REMARK in told) == variant.startswith("cuda")


def test_what_is_missing_is_told_once_for_all():
    with pytest.raises(
        console.Failure, match=r"^this needs no_such and none_such: \S+ -m pip install no_such none_such$"
    ):
        console.require("json", "no_such", "none_such")


def test_a_missing_scene_of_ours_is_answered_with_what_writes_it(tmp_path):
    """README and help name such scenes, which only a checkout has."""
    scene = tmp_path / "scenes" / "sphere" / "scene.xml"
    with pytest.raises(console.Failure) as told:
        console.load(scene, {})
    command = re.fullmatch(f"there is no scene file {scene}: refscatter (.*) writes it", str(told.value)).group(1)
    done = refscatter(*command.split())
    assert done.returncode == 0 and scene.is_file()
    for other in (scene.with_name("mine.xml"), tmp_path / "mine" / "scene.xml"):
        with pytest.raises(console.Failure, match=r"mine(/scene)?\.xml$"):
            console.load(other, {})


@pytest.mark.parametrize("plugin, name, value, near", [
    ("refscatter", "estimator", "curv", "curve"),
    ("refscatter", "culling", "spindles", "spindle"),
    ("refscatter", "aovs", "surfaces, candidate", "candidates"),
    ("refscatter_photons", "mode", "point", "points"),
    ("refscatter_photons", "photon", 10, "photons"),
    ("refscatter_straight", "internal_bounce", 1, "internal_bounces"),
])  # fmt: skip
def test_near_values_of_properties(rgb, plugin, name, value, near):
    with pytest.raises(RuntimeError, match=rf'{plugin}: .*"{name}".*did you mean {near}\?'):
        mi.load_dict({"type": plugin, name: value})


@needs_variant
def test_tracebacks_are_shown_where_asked_for(tmp_path):
    """Of an error that is expected; without ``--debug``: ``test_usage_errors`` and others."""
    done = refscatter("--debug", "render", tmp_path / "nowhere.xml")
    assert done.returncode == 1 and "Traceback" in done.stderr
    assert done.stderr.splitlines()[-1].startswith("refscatter: there is no scene file")
    bad = refscatter("--debug", "render", scene_file(tmp_path, '<shape type="nonsense"/>'), cwd=tmp_path)
    assert bad.returncode == 1 and "in load" in bad.stderr, "the cause's traceback is missing"


@pytest.mark.parametrize("arguments", [["check"], ["--debug", "check"]], ids=" ".join)
def test_an_unexpected_error_is_one_line_and_a_hint(arguments, monkeypatch, capsys):
    def broken():
        raise ZeroDivisionError("of a kind that\nnobody thought of")

    monkeypatch.setattr("mitsuba_refscatter.platform.report", broken)
    monkeypatch.setattr(console, "err", rich.console.Console(file=io.StringIO(), soft_wrap=True))
    done = CliRunner().invoke(main.app, arguments)
    told = console.err.file.getvalue()
    lines = told.splitlines()
    assert done.exit_code == 1
    assert lines[-2] == "refscatter: ZeroDivisionError, which should not happen: of a kind that nobody thought of"
    assert "refscatter --debug" in lines[-1]
    assert ("Traceback" in told) == ("--debug" in arguments) and (len(lines) == 2) == ("--debug" not in arguments)


@pytest.mark.parametrize("terminal, quiet", [(True, False), (True, True), (False, False)])
def test_progress_is_shown_on_a_terminal_only(terminal, quiet, monkeypatch):
    err = rich.console.Console(file=io.StringIO(), force_terminal=terminal, width=80)
    monkeypatch.setattr(console, "err", err)
    with console.progress("some [work]", 2, quiet) as tell:
        tell(1)
        tell(2, "more [work]")
    told = err.file.getvalue()
    assert ("more [work]" in told and "100%" in told) if terminal and not quiet else told == ""


def test_every_long_command_can_be_quiet():
    commands = get_command(main.app).commands
    quiet = {name for name in COMMANDS if any("--quiet" in p.opts for p in commands[name].params)}
    assert quiet == {"render", "compare", "gallery", "scaling", "convergence", "equal-error", "tradeoff"}
    assert_one_sentence(refscatter("scaling", "--quiet"), "nothing would be left", code=2)


@needs_variant
def test_quiet_is_quiet(tmp_path):
    sizes = ("--scene", "sphere", "--resolution", 8, "--most", 16)
    done = refscatter("convergence", *sizes, "-o", tmp_path, "--quiet")
    assert done.returncode == 0 and done.stdout == done.stderr == ""
    assert sorted(p.name for p in tmp_path.iterdir()) == ["convergence.png", "results.json"]


@needs_variant
def test_a_picture_says_how_it_was_made(tmp_path):
    """The header of the EXR: settings, versions, samples, the scene's name; no place on this machine."""
    import mitsuba_refscatter

    done = refscatter("render", SPHERE, "-D", "res=16", "-s", 2, "-m", "llvm_ad_rgb", "-o", tmp_path / "out.exr")
    if done.returncode != 0 and "llvm_ad_rgb cannot be used" in done.stderr:
        pytest.skip(done.stderr)
    assert done.returncode == 0, done.stderr
    header = OpenEXR.File(str(tmp_path / "out.exr"), header_only=True).header()
    assert header["integrator"].startswith("RefscatterIntegrator[") and "tolerance = 0.01" in header["integrator"]
    assert header["refscatter"] == mitsuba_refscatter.__version__ and header["mitsuba"] == mi.__version__
    said = [header[key] for key in ("variant", "scene", "spp", "seed")]
    assert said == ["llvm_ad_rgb", "scene.xml", 2, 0]
    assert not any(str(place) in str(header) for place in (tmp_path, SPHERE.parent))

"""READMEs: links and pictures lead to something, commands and files that they name exist, tables name all there is."""

import re
import shlex
from pathlib import Path

import pytest
import test_layers
from typer.main import get_command

from mitsuba_refscatter import example_scenes
from mitsuba_refscatter.commands import main

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "mitsuba_refscatter"
READMES = sorted([*ROOT.glob("*.md"), *(path for name in ("mitsuba_refscatter", "tests", "scenes", "notebooks")
                                        for path in (ROOT / name).rglob("*.md"))])  # fmt: skip
APP = get_command(main.app)
PLACES = ROOT, PACKAGE, ROOT / "tests"
"""Where files that are named may be, besides next to the README."""


def named(path):
    return path.relative_to(ROOT).as_posix()


readmes = pytest.mark.parametrize("path", READMES, ids=named)


def without_code(text):
    return re.sub(r"```.*?```", "", text, flags=re.DOTALL)


def anchors(path):
    """Those that a page's headings make."""
    heads = re.findall(r"^#+ (.*)$", without_code(path.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def targets(path):
    """Relative links and pictures: file and anchor of each."""
    links = re.findall(r"\]\(([^)\s]+)\)", without_code(path.read_text(encoding="utf-8")))
    return [(path.parent / link.partition("#")[0] if link[0] != "#" else path, link.partition("#")[2])
            for link in links if not link.startswith("https://")]  # fmt: skip


def commands(text):
    """The arguments of each ``refscatter`` that stands in code."""
    lines = re.findall(r"^(?: {4}|\t.*/)(refscatter .*)$", text, re.MULTILINE) + re.findall(r"`(refscatter .*?)`", text)
    return [shlex.split(line, comments=True)[1:] for line in lines if "..." not in line]


def check(arguments):
    """Raises for a command or option that is not known."""
    _, rest, _ = APP.make_parser(APP.context_class(APP)).parse_args(list(arguments))
    if rest:
        command = APP.commands[rest[0]]
        command.make_parser(command.context_class(command)).parse_args(rest[1:])


def first_cells(text, head):
    """Names in code in the first cells of a table, by its head."""
    lines = text.partition(head + "\n")[2].splitlines()[1:]
    rows = lines[: next((i for i, line in enumerate(lines) if not line.startswith("|")), len(lines))]
    return [name for row in rows for name in re.findall(r"`(.*?)`", row.split("|")[1])]


def test_all_of_them_are_looked_at():
    found = set(map(named, READMES))
    folders = ("", "mitsuba_refscatter/", "mitsuba_refscatter/benchmarks/", "tests/", "scenes/")
    assert found >= {f"{folder}README.md" for folder in folders} | {"CHANGELOG.md"}


@readmes
def test_links_and_pictures_lead_to_something(path):
    for file, anchor in targets(path):
        assert file.exists(), f"{file} is not there"
        assert not anchor or anchor in anchors(file), f"{file} has no heading #{anchor}"


@readmes
def test_files_that_are_named_exist(path):
    if path.name != "CHANGELOG.md":  # which tells of what was
        for name in re.findall(r"`([\w/.*]+(?:\.py|/))`", path.read_text(encoding="utf-8")):
            if not name.startswith("renders/"):
                assert any(list(place.glob(name)) for place in (path.parent, *PLACES)), f"there is no {name}"


@pytest.mark.parametrize("path", [*READMES, ROOT / "Makefile"], ids=named)
def test_commands_are_known(path):
    for arguments in commands(path.read_text(encoding="utf-8")):
        check(arguments)


def test_the_walk_finds_commands_and_what_is_wrong_with_them():
    text = (
        "`refscatter check` and\n    refscatter render a.xml -s 4  # so\nrefscatter not\n\t$(BIN)/refscatter scenes x\n"
    )
    assert commands(text) == [["render", "a.xml", "-s", "4"], ["scenes", "x"], ["check"]]
    for wrong in (["rendr", "a.xml"], ["render", "a.xml", "--smaples", "4"], ["--debgu", "check"]):
        with pytest.raises(Exception, match=r"rendr|No such option"):
            check(wrong)


def test_the_readme_is_short():
    assert 120 <= len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 180


def test_the_house_is_that_of_the_imports():
    """All folders and modules, from the ground up."""
    text = (PACKAGE / "README.md").read_text(encoding="utf-8")
    for head, order in (("| the renderer | |", test_layers.CORE), ("| tools | |", test_layers.TOOLS)):
        assert [name.removesuffix("/").removesuffix(".py") for name in first_cells(text, head)] == order, head


def test_tables_name_all_files():
    """Tests, tools that measure, scenes; and every picture is shown somewhere."""
    tests = (ROOT / "tests" / "README.md").read_text(encoding="utf-8")
    parts = tests.partition("## What each file is for")[2].split("| file | |")[1:]
    assert sorted(name for part in parts for name in first_cells("| file | |" + part, "| file | |")) == sorted(
        path.name for path in (ROOT / "tests").glob("*.py")
    )
    tools = (PACKAGE / "benchmarks" / "README.md").read_text(encoding="utf-8")
    found = sorted(path.name for path in (PACKAGE / "benchmarks").glob("*.py") if path.name != "__init__.py")
    assert sorted(first_cells(tools, "| module | |")) == found
    scenes = (ROOT / "scenes" / "README.md").read_text(encoding="utf-8")
    assert first_cells(scenes, "| Scene | Triangles | Origin |") == list(example_scenes.SCENES)
    shown = {file.resolve() for path in READMES for file, _ in targets(path)}
    assert {path.resolve() for path in (ROOT / "scenes").rglob("*.png")} <= shown

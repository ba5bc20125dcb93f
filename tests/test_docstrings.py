"""Docstrings: examples in them run, everything public has one, and tables of properties say what ``options.py``
says."""

import dataclasses
import doctest
import importlib
import inspect
import re
from pathlib import Path

import mitsuba as mi
import pytest

from mitsuba_refscatter import options

ROOT = Path(__file__).parent.parent
PATHS = sorted(path.relative_to(ROOT) for path in (ROOT / "mitsuba_refscatter").rglob("*.py"))
MODULES = [".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in PATHS if path.stem != "__main__"]

PLUGINS = {
    "refscatter": options.Options,
    "refscatter_photons": options.PhotonOptions,
    "refscatter_straight": options.Common,
}
KINDS = {float: "|float|", int: "|int|", str: "|string|", bool: "|bool|"}


@pytest.mark.parametrize("name", MODULES)
def test_examples_run(rgb, name):
    module = importlib.import_module(name)
    assert doctest.testmod(module, extraglobs={"mi": mi}).failed == 0


def test_there_are_examples(rgb):
    finder = doctest.DocTestFinder()
    with_examples = [name for name in MODULES
                     if any(test.examples for test in finder.find(importlib.import_module(name)))]  # fmt: skip
    assert len(with_examples) >= 15


@pytest.mark.parametrize("name", MODULES)
def test_everything_public_has_a_docstring(rgb, name):
    module = importlib.import_module(name)
    for key, value in vars(module).items():
        own = (inspect.isclass(value) or inspect.isfunction(value)) and value.__module__ == name
        if own and not key.startswith("_"):
            text = value.__doc__ or ""
            # That of a dataclass without one is its signature.
            assert text and not text.startswith(f"{key}("), f"{name}.{key} has no docstring"


def properties(plugin):
    """Rows of the table in a plugin's docstring: name -> (type, meaning)."""
    table = (type(mi.load_dict({"type": plugin})).__doc__ or "").partition(".. pluginparameters::")[2]
    table = table.partition(".. code-block::")[0]
    rows = {}
    for row in re.split(r"^ *\* - ", table, flags=re.MULTILINE)[1:]:
        names, kind, meaning = re.split(r"^ *-(?= |$)", row, maxsplit=2, flags=re.MULTILINE)
        rows.update(dict.fromkeys((n.strip() for n in names.split(",")), (kind.strip(), " ".join(meaning.split()))))
    return rows


@pytest.mark.parametrize("plugin", PLUGINS)
def test_tables_of_plugins_list_the_options(rgb, plugin):
    """All of them, with type, default and choices; those that stand in one row are as of ``refscatter``, whose have
    each its own."""
    rows, fields = properties(plugin), {field.name: field for field in dataclasses.fields(PLUGINS[plugin])}
    assert rows.keys() == {*fields}
    for name, (kind, meaning) in rows.items():
        if kind == "":
            assert plugin != "refscatter" and "As of ``refscatter``" in meaning
        else:
            field = fields[name]
            default = re.search(r"\(Default: (.*?)\)$", meaning)
            assert kind == KINDS[type(field.default)] and default and same(default.group(1), field.default), name
            assert all(f"``{choice}``" in meaning for choice in field.metadata.get("choices", ())), name
    assert all(f"``{name}``" in properties("refscatter")["aovs"][1] for name in options.AOVS)


def test_the_readme_lists_the_options():
    """Its table of properties, and that of the integrators to compare with: names, defaults, and choices."""
    places = (ROOT / "README.md", ROOT / "mitsuba_refscatter" / "benchmarks" / "README.md")
    text, of_others = (path.read_text(encoding="utf-8") for path in places)
    first = table(text, "| property | default | meaning |")
    fields = {field.name: field for field in dataclasses.fields(options.Options)}
    assert {name for name, *_ in first} == {*fields}
    second = table(of_others, "| property | of | default | meaning |")
    photons = {f.name: f for f in dataclasses.fields(options.PhotonOptions)}
    common = {f.name for f in dataclasses.fields(options.Common)}
    own = [row for row in second if row[1] != "both"]
    assert {name for name, *_ in own} == photons.keys() - common
    assert {name for names, of, *_ in second if of == "both" for name in names.split(", ")} == common
    rows = [(fields[name], default, meaning) for name, default, meaning in first if name in fields]
    rows += [(photons[name], default, meaning) for name, _, default, meaning in own]
    for field, default, meaning in rows:
        assert same(default, field.default), field.name
        assert all(choice in meaning for choice in field.metadata.get("choices", ())), field.name
    assert all(name in next(row for row in first if row[0] == "aovs")[2] for name in options.AOVS)


def table(text, head):
    """Cells of the rows below a table's head, without marks of code."""
    lines = text.partition(head + "\n")[2].splitlines()[1:]
    end = next(i for i, line in enumerate(lines) if not line.startswith("|"))
    return [[cell.strip().replace("`", "") for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines[:end]]


def same(told, default):
    """Whether a text says a default."""
    if isinstance(default, str):
        return told == (default or "none")
    return told == str(default).lower() if isinstance(default, bool) else float(told) == default

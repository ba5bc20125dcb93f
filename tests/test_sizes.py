"""The size of files, functions and signatures, and that fields have real types: what makes code readable by others."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

LINES, BODY, PARAMETERS, COLUMNS = 400, 60, 6, 120
"""Of a file; of a function, its docstring included; positional ones of a function, but ``self``; of a line."""

FILES = sorted(path for folder in ("mitsuba_refscatter", "tests") for path in (ROOT / folder).rglob("*.py"))


def is_command(function):
    """Whether a function is a command of the command line, whose parameters are options with names."""
    calls = [x.func if isinstance(x, ast.Call) else x for x in function.decorator_list]
    return any(isinstance(x, ast.Attribute) and x.attr in ("command", "callback") for x in calls)


def is_test(function):
    """Whether pytest calls a function, by the names of its parameters."""
    marks = [ast.unparse(x) for x in function.decorator_list]
    return function.name.startswith("test_") or any(x.startswith("pytest.fixture") for x in marks)


def faults(source):
    """What is too large or has no type in a file."""
    lines = source.splitlines()
    if len(lines) > LINES:
        yield f"{len(lines)} lines"
    for number, line in enumerate(lines, 1):
        if len(line) > COLUMNS:
            yield f"line {number} has {len(line)} columns"
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.AnnAssign) and "object" in {
            x.id for x in ast.walk(node.annotation) if isinstance(x, ast.Name)
        }:
            yield f"line {node.lineno}: a field of type object"
        if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        length = node.end_lineno - node.lineno + 1
        if length > BODY:
            yield f"{node.name} has {length} lines"
        names = [x.arg for x in node.args.posonlyargs + node.args.args if x.arg not in ("self", "cls")]
        if len(names) > PARAMETERS and not is_command(node) and not is_test(node):
            yield f"{node.name} has {len(names)} positional parameters"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_sizes(path):
    found = list(faults(path.read_text(encoding="utf-8")))
    assert not found, "\n".join(found)


def test_faults_are_seen():
    long = "def long():\n" + "    x = 0\n" * BODY
    many = "def many(a, b, c, d, e, f, g):\n    pass\n"
    field = "class A:\n    x: object = None\n    y: list[object]\n"
    wide = "x = '" + "y" * COLUMNS + "'\n"
    for source, count in ((long, 1), (many, 1), (field, 2), (wide, 1), ("\n" * (LINES + 1), 1)):
        assert len(list(faults(source))) == count
    fine = "class A:\n    def f(self, a, b, c, d, e, f, *, g):\n        x: int = 0\n"
    assert not list(faults(fine))

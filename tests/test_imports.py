"""Imports run one way: a module may use what stands before it in ORDER, and nothing else of the package."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "mitsuba_refscatter"

# Modules and subpackages from the ground up. What uses Mitsuba only to describe a machine
# or to write a file (platform, output) knows nothing of the others.
ORDER = [
    "spelling", "platform", "tolerances", "optics", "lanes", "kept", "sequence", "geometry", "scene", "visibility", "air", "solve", "culling",
    "estimators", "wavefront", "camera", "options", "film", "integrators", "probing", "plugin", "scenes", "output",
    "compare", "meshcheck", "console", "comparing", "measuring", "cli", "__main__",
]  # fmt: skip

MODULES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def imported(path):
    """Top-level names of the package that a file imports, wherever in the file."""
    parts = path.relative_to(PACKAGE).parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name.split(".") for alias in node.names]
            names = [name[1:] for name in names if name[0] == PACKAGE.name]
        elif isinstance(node, ast.ImportFrom):
            module = (node.module or "").split(".") if node.module else []
            if node.level:
                base = list(parts[: len(parts) - node.level])
                names = [base + module] if base + module else [[alias.name] for alias in node.names]
            elif module[:1] == [PACKAGE.name]:
                names = [module[1:]] if module[1:] else [[alias.name] for alias in node.names]
        yield from (name[0] for name in names if name)


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_run_one_way(path):
    own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    assert own in ORDER, f"{own} is new: give it a place in ORDER"
    for name in set(imported(path)) - {own}:
        assert name in ORDER, f"{own} imports {name}, which has no place in ORDER"
        assert ORDER.index(name) < ORDER.index(own), f"{own} imports {name}, which stands above it"


def test_the_package_itself_only_registers():
    """But for ``probe``, which is imported when it is asked for."""
    assert set(imported(PACKAGE / "__init__.py")) <= {"plugin", "probing"}


def test_the_walk_sees_every_form_of_import(tmp_path, monkeypatch):
    monkeypatch.setattr("test_imports.PACKAGE", tmp_path / "mitsuba_refscatter")
    file = tmp_path / "mitsuba_refscatter" / "culling" / "x.py"
    file.parent.mkdir(parents=True)
    file.write_text("from .. import a\nfrom ..b import c\nfrom . import d\nimport mitsuba_refscatter.e\n"
                    "from mitsuba_refscatter import f\nfrom mitsuba_refscatter.g import h\nimport numpy\n"
                    "def late():\n    from ..i.j import k\n")  # fmt: skip
    assert sorted(imported(file)) == ["a", "b", "culling", "e", "f", "g", "i"]

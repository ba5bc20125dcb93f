"""Imports run one way: a module may use what stands before it in ORDER, and nothing else of the package. And
``scene/`` alone reads what a scene of Mitsuba's holds."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "mitsuba_refscatter"

# Modules and subpackages from the ground up: the layout of the house. What uses Mitsuba only to describe a machine
# or to write a file (platform, image_io) knows nothing of the others.
CORE = [
    "tolerances",
    "core",
    "platform",
    "optics",
    "geometry",
    "scene",
    "transport",
    "light",
    "missing",
    "solve",
    "culling",
    "estimators",
    "options",
    "film",
    "integrators",
    "plugin",
]

TOOLS = ["example_scenes", "image_io", "benchmarks", "probing", "commands", "__main__"]
"""They load scenes, change them and render them, with other integrators, too."""

ORDER = CORE + TOOLS

LONGEST = 9
"""Modules or folders in the longest chain of imports of the core, its ends included."""

TRACING = {"ray_intersect_preliminary", "ray_test"}

ASKS = {
    "integrators/refscatter.py": {"sensors"},
    "missing/walk.py": {"compute_surface_interaction"},
    "light/first_cells.py": {"ray_intersect_preliminary"},
    "light/light_samples.py": {"sample_position"},
    "probing/__init__.py": {"ray_intersect_preliminary", "sensors"},
    "transport/crossing.py": {
        "ray_intersect_preliminary",
        "compute_surface_interaction",
        "bsdf",
    },  # the latter two of mirrors
    "transport/surface_paths.py": {  # what any path tracer asks for
        "ray_intersect_preliminary",
        "compute_surface_interaction",
        "bsdf",
        "emitter",
        "environment",
        "is_emitter",
        "pdf_emitter_direction",
        "ray_intersect",
        "sample_emitter_direction",
    },
    "transport/transmittance.py": TRACING,
    "transport/visibility.py": TRACING,
}
"""What modules of the renderer but ``scene/`` ask scenes, shapes and media of Mitsuba's for."""

HANDS_ON = {"transport/surface_paths.py"}
"""Who gives Mitsuba's scene to others: to what samples emitters."""

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


def test_tools_stay_out_of_the_core():
    """The core imports none of them, wherever in a file."""
    for path in MODULES:
        own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if own in CORE:
            assert not set(imported(path)) & set(TOOLS), path


def test_chains_of_imports_are_short():
    """From the plugin to the ground."""
    needs = {name: set() for name in CORE}
    for path in MODULES:
        own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if own in CORE:
            needs[own] |= set(imported(path)) - {own}
    chains = {}
    for name in CORE:  # each after what it needs
        chains[name] = max((chains[other] for other in needs[name]), key=len, default=[]) + [name]
    longest = max(chains.values(), key=len)
    assert len(longest) <= LONGEST, " -> ".join(longest)


def test_the_package_itself_only_registers():
    """But for ``probe``, which is imported when it is asked for."""
    assert set(imported(PACKAGE / "__init__.py")) <= {"plugin", "probing"}


def test_the_walk_sees_every_form_of_import(tmp_path, monkeypatch):
    monkeypatch.setattr("test_layers.PACKAGE", tmp_path / "mitsuba_refscatter")
    file = tmp_path / "mitsuba_refscatter" / "culling" / "x.py"
    file.parent.mkdir(parents=True)
    file.write_text("from .. import a\nfrom ..b import c\nfrom . import d\nimport mitsuba_refscatter.e\n"
                    "from mitsuba_refscatter import f\nfrom mitsuba_refscatter.g import h\nimport numpy\n"
                    "def late():\n    from ..i.j import k\n")  # fmt: skip
    assert sorted(imported(file)) == ["a", "b", "culling", "e", "f", "g", "i"]


def of_the_renderer():
    """Names and trees of the modules that must not read scenes."""
    for path in MODULES:
        parts = path.relative_to(PACKAGE).parts
        if parts[0].removesuffix(".py") not in {*TOOLS, "scene"} - {"probing"}:
            yield "/".join(parts), ast.parse(path.read_text(encoding="utf-8"))


def test_scene_alone_reads_scenes(rgb):
    """Other modules call nothing that scenes, shapes and media of Mitsuba's have but what ``ASKS`` says."""
    import mitsuba as mi

    readers = {name for kind in (mi.Scene, mi.Shape, mi.Mesh, mi.Medium) for name in dir(kind)} - set(dir(mi.Object))
    assert {"shapes", "emitters", "interior_medium", "vertex_positions_buffer", "phase_function"} <= readers
    asked = {name: called(tree) & readers for name, tree in of_the_renderer()}
    assert {name: calls for name, calls in asked.items() if calls} == ASKS


def test_rays_are_all_that_a_scene_is_asked_for():
    """``Scene.mi_scene``, outside of ``scene/``."""
    for name, tree in of_the_renderer():
        known = {id(x.value) for x in ast.walk(tree) if isinstance(x, ast.Attribute) and x.attr in TRACING}
        others = [
            x for x in ast.walk(tree) if isinstance(x, ast.Attribute) and x.attr == "mi_scene" and id(x) not in known
        ]
        assert bool(others) == (name in HANDS_ON), f"{name} takes mi_scene for more than rays"


def called(tree):
    """Names of the methods that are called in a tree, or taken from an object by ``getattr``."""
    calls = [x for x in ast.walk(tree) if isinstance(x, ast.Call)]
    methods = {x.func.attr for x in calls if isinstance(x.func, ast.Attribute)}
    taken = [x.args[1] for x in calls if isinstance(x.func, ast.Name) and x.func.id == "getattr" and len(x.args) > 1]
    return methods | {x.value for x in taken if isinstance(x, ast.Constant)}


def test_the_walk_sees_calls():
    assert called(ast.parse("a.b().c(d.e)\nf(g.h)\ngetattr(i, 'j')(k)")) == {"b", "c", "j"}

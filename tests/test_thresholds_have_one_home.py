"""Thresholds have one home: no module of the renderer but ``tolerances`` holds a number that looks like one."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "mitsuba_refscatter"

HOMES = ("tolerances/", "options.py")
"""Where thresholds, and defaults and ranges of options, stand."""

TOOLS = ("benchmarks/", "commands/", "probing/", "image_io.py", "platform.py")
"""What measures, draws and writes. Its own settings have a name too, at the head of a module or as the default of
an option."""

SHAPES = ("example_scenes/",)
"""Bodies and scenes made by code: their numbers are lengths and places."""

DIVISOR = 1e-30
"""What may stand anywhere: a divisor that must not be 0, ``maximum(x, 1e-30)``."""

SMALL, LARGE = 0.05, 1e5
"""Numbers whose size is below or above look like thresholds."""

NAMED = {
    ("transport/transmittance.py", "BLOCKED"): "an index that means none",
    ("culling/beam.py", "BEAM"): "numbers of a record",
    ("culling/beam_tree.py", "NODE"): "numbers of a record",
    ("culling/clearance.py", "NODE"): "numbers of a record",
    ("culling/spindle.py", "NODE"): "numbers of a record",
    ("estimators/photons.py", "NODE"): "numbers of a record",
    ("estimators/photons.py", "RECORD"): "numbers of a record",
    ("geometry/bvh.py", "LEAF"): "the layout of a tree",
    ("geometry/geodesic.py", "_GOLDEN"): "the golden ratio",
    ("geometry/triangle.py", "RECORD"): "numbers of a record",
    ("core/arrays.py", "ALIGNMENT"): "Dr.Jit's",
    ("core/arrays.py", "NONE"): "an index that means none",
    ("scene/records.py", "ONCE"): "two counts in one number",
    ("light/beams.py", "BEAM"): "numbers of a record",
    ("light/beams.py", "LINES"): "numbers of a record",
    ("light/beams.py", "NOTHING"): "a radius that means none",
    ("light/beams.py", "RADIUS"): "a place in a record",
    ("light/chain_tracing.py", "REGION"): "a place in a record",
    ("light/chain_tracing.py", "ONWARD"): "a place in a record",
    ("light/chain_tracing.py", "START"): "a place in a record",
    ("light/chains.py", "THROUGH"): "a choice",
    ("light/chains.py", "REFLECTED"): "a choice",
    ("light/refinement.py", "NODE"): "numbers of a record",
    ("light/refinement.py", "UNLIT"): "a label",
    ("light/refinement.py", "DARK"): "a label",
    ("light/refinement.py", "FREE"): "a label",
    ("light/light_samples.py", "BELOW_ONE"): "float32's",
    ("scene/tessellation.py", "FREQUENCY_EDGE"): "geometry of the sphere",
    ("core/sobol.py", "BITS"): "of an integer",
    ("core/sobol.py", "LIGHT"): "numbers of dimensions",
    ("core/sobol.py", "PLACE"): "numbers of dimensions",
    ("core/sobol.py", "ROUNDS"): "of a cipher",
    ("solve/newton.py", "_GO_ON"): "a number that means none",
}
"""Constants of the renderer's modules that are no thresholds: what they are."""

BARE = {
    ("benchmarks/convergence.py", "0.01"): "the line that is labelled 1 %",
    ("image_io.py", "0.0031308"): "where sRGB begins to be linear",
    ("probing/picture.py", "0.03"): "a place in the picture",
    ("probing/view.py", "0.01"): "a place in the picture",
}
"""The same of numbers in the tools' functions."""


def modules(*without):
    """Names and paths of the package's modules, but those whose names begin so."""
    names = {path.relative_to(PACKAGE).as_posix(): path for path in sorted(PACKAGE.rglob("*.py"))}
    return {name: path for name, path in names.items() if not name.startswith(without)}


def looks_like_a_threshold(text):
    """Of a number as it is written."""
    size = abs(float(text))
    return "e" in text.lower() or 0 < size < SMALL or size >= LARGE


def divisors(tree):
    """The numbers in a tree that keep a divisor from being 0: the last argument of ``max`` or ``maximum``."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and len(node.args) == 2]
    names = [(getattr(call.func, "attr", None) or getattr(call.func, "id", None), call.args[1]) for call in calls]
    return [x for name, x in names if name in ("max", "maximum") and isinstance(x, ast.Constant) and x.value == DIVISOR]


def bare(source, inside_functions=False):
    """Floats, as they are written, that look like thresholds; ``inside_functions``: only in the bodies of functions."""
    tree = ast.parse(source)
    functions = [node for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.Lambda))]
    bodies = [part for f in functions for part in (f.body if isinstance(f.body, list) else [f.body])]
    roots = bodies if inside_functions else [tree]
    allowed = {id(x) for x in divisors(tree)}
    found = {
        id(x): x for root in roots for x in ast.walk(root) if isinstance(x, ast.Constant) and type(x.value) is float
    }
    texts = [ast.get_source_segment(source, x) for key, x in found.items() if key not in allowed]
    return [text for text in texts if looks_like_a_threshold(text)]


def named(source):
    """Names of a module's constants in upper case that are numbers, or tuples of numbers, themselves."""
    out = []
    for node in ast.parse(source).body:
        if not isinstance(node, (ast.Assign, ast.AnnAssign)) or node.value is None:
            continue
        for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
            several = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
            for name, value in zip(target.elts, node.value.elts) if several else [(target, node.value)]:
                if isinstance(name, ast.Name) and name.id.isupper() and is_number(value):
                    out.append(name.id)
    return out


def is_number(value):
    """Whether an expression is a number, or some in a tuple or list, made of nothing but numbers."""
    if isinstance(value, (ast.Tuple, ast.List)):
        return (
            bool(value.elts)
            and not any(isinstance(x, (ast.Tuple, ast.List)) for x in value.elts)
            and all(map(is_number, value.elts))
        )
    parts = list(ast.walk(value))
    return not any(isinstance(x, (ast.Name, ast.Call, ast.Dict)) for x in parts) and any(
        isinstance(x, ast.Constant) and type(x.value) in (int, float) for x in parts
    )


RENDERER = modules(*HOMES, *TOOLS, *SHAPES)


@pytest.mark.parametrize("name", RENDERER)
def test_the_renderer_holds_no_threshold(name):
    source = RENDERER[name].read_text(encoding="utf-8")
    found = bare(source) + [constant for constant in named(source) if (name, constant) not in NAMED]
    assert not found, f"{name} holds {', '.join(found)}: give them a name, unit and reason in tolerances/"


def test_tools_give_their_settings_a_name():
    tools = modules(*HOMES, *SHAPES, *RENDERER)
    assert {name.split("/")[0] for name in tools} == {tool.strip("/") for tool in TOOLS}
    for name, path in tools.items():
        found = [x for x in bare(path.read_text(encoding="utf-8"), inside_functions=True) if (name, x) not in BARE]
        assert not found, f"{name} holds {', '.join(found)}: give them a name at its head"


def test_exceptions_occur():
    for (name, constant), why in NAMED.items():
        assert constant in named((PACKAGE / name).read_text(encoding="utf-8")), f"{constant} is not in {name}: {why}"
    for (name, text), why in BARE.items():
        source = (PACKAGE / name).read_text(encoding="utf-8")
        assert text in bare(source, inside_functions=True), f"{text} is not in {name}: {why}"


def test_every_threshold_has_a_reason_and_a_use():
    """A text right behind each, and some module that asks for it."""
    used = {
        node.attr
        for path in modules("tolerances/").values()
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Attribute)
    }
    seen = set()
    for path in sorted((PACKAGE / "tolerances").glob("*.py")):
        body = ast.parse(path.read_text(encoding="utf-8")).body
        used |= {
            x.id
            for x in ast.walk(ast.parse(path.read_text("utf-8")))
            if isinstance(x, ast.Name) and isinstance(x.ctx, ast.Load)
        }
        for node, behind in zip(body, [*body[1:], None]):
            if isinstance(node, ast.Assign):
                name = node.targets[0].id
                assert name not in seen, f"{name} is there twice"
                assert isinstance(behind, ast.Expr) and isinstance(behind.value, ast.Constant), f"{name} has no reason"
                seen.add(name)
    assert not seen - used, f"nothing uses {', '.join(seen - used)}"


def test_the_walk_finds_what_it_should():
    source = (
        "import drjit as dr\nA = 0.5\nB, C = 3, (1, 2)\n_D = 1 << 16\nE = tolerances.E * 2\nF: float = "
        "-1e-3\nG = ((1, 2), (3, 4))\n"
        "def f(x, y=0.01):\n    z = 1e-6 * x / dr.maximum(x, 1e-30) + max(x, 1e-7) + 1e-30\n    return 0.04 if "
        "x < 0.06 else 2e5\n"
        "h = lambda x: x > 0.02\n"
    )
    assert named(source) == ["A", "B", "C", "_D", "F"]
    assert sorted(bare(source)) == sorted(["1e-3", "0.01", "1e-6", "1e-7", "1e-30", "0.04", "2e5", "0.02"])
    assert sorted(bare(source, inside_functions=True)) == sorted(["1e-6", "1e-7", "1e-30", "0.04", "2e5", "0.02"])

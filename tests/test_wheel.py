"""The package as others get it: what is built, and the wheel in an environment of its own, far from the checkout.

Nothing is downloaded: what the wheel requires is linked from the environment of the tests, and the extras are not.
"""

import contextlib
import email
import os
import re
import shlex
import shutil
import subprocess
import sys
import tarfile
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from test_commands import assert_one_sentence, needs_variant

import mitsuba_refscatter

ROOT = Path(__file__).parent.parent
PACKAGE = "mitsuba_refscatter"
NOT_BUILT_FROM = (".git", ".venv", ".cache", "renders", "build", "dist", "*.egg-info", "__pycache__")
SMALL = ("-D", "res=16")
# Each command that needs more than the wheel requires: its arguments and what it writes, if it is quick enough to run.
MORE = {
    "compare": (("SCENE", "--seconds", "0.1", "--methods", "refscatter", *SMALL), "report.html"),
    "gallery": ((), None),
    "probe": (("SCENE", "--pixel", "8", "8", *SMALL), "probe.html"),
    "scaling": (("--scene", "sphere", "--triangles", "80", "--resolution", "8", "--samples", "1"), "scaling.png"),
    "convergence": (("--scene", "sphere", "--resolution", "8", "--most", "16"), "convergence.png"),
    "equal-error": ((), None),
    "tradeoff": (("SCENE", "--tolerance", "0.1", "--no-choices", *SMALL), "tradeoff.png"),
}


def clean(**more):
    """The environment variables without those that lead Python to the checkout."""
    return {**{key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}, **more}


def done_well(*command, **where):
    """Run a command that must succeed; return its output."""
    done = subprocess.run([str(x) for x in command], capture_output=True, text=True, timeout=500, **where)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The wheel and the sdist that it was made of, built from a copy of the checkout."""
    folder = tmp_path_factory.mktemp("built")
    shutil.copytree(ROOT, folder / "source", ignore=shutil.ignore_patterns(*NOT_BUILT_FROM))
    done_well(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder / "dist", folder / "source",
              cwd=folder, env=clean())  # fmt: skip
    (wheel,), (sdist,) = ((folder / "dist").glob(f"*{end}") for end in (".whl", ".tar.gz"))
    return wheel, sdist


def metadata_of(wheel):
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return email.message_from_string(archive.read(name).decode("utf-8"))


def test_the_wheel_holds_the_package_alone(built):
    own = {p.relative_to(ROOT).as_posix() for p in (ROOT / PACKAGE).rglob("*") if p.is_file() and p.suffix != ".pyc"}
    with zipfile.ZipFile(built[0]) as archive:
        names = set(archive.namelist())
    about = {name for name in names if name.partition("/")[0].endswith(".dist-info")}
    assert names - about == own
    with tarfile.open(built[1]) as archive:
        names = {member.name.partition("/")[2] for member in archive.getmembers() if member.isfile()}
    # What tests need, scenes and references, is not in it either.
    assert own | {"pyproject.toml", "LICENSE"} <= names and not any(name.startswith("tests/") for name in names)


def test_the_metadata_makes_sense_without_the_checkout(built):
    about = metadata_of(built[0])
    assert about["Version"] == mitsuba_refscatter.__version__
    assert about["License-Expression"] == "BSD-3-Clause" and about["License-File"] == "LICENSE"
    assert about["Description-Content-Type"] == "text/markdown"
    links = re.findall(r"\]\((.*?)\)", about.get_payload())
    assert links and all(link.startswith("https://") for link in links), links


class Elsewhere:
    """A fresh environment with the wheel, and of other packages only what the wheel requires."""

    def __init__(self, folder, wheel):
        done_well(sys.executable, "-m", "venv", folder, env=clean())
        self.bin = folder / "bin"
        self.env = clean(PATH=f"{self.bin}{os.pathsep}{os.environ['PATH']}", COLUMNS="200", PYTHONNOUSERSITE="1")
        ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
        self.packages = Path(done_well(self.bin / "python", "-c", ask, env=self.env).strip())
        self.link(metadata_of(wheel).get_all("Requires-Dist"))
        self.run("python", "-m", "pip", "install", "--quiet", "--no-index", wheel)

    def link(self, requirements):
        """Link distributions and what they require, extras left out; return the new links."""
        wanted, seen, links = list(requirements), set(), []
        while wanted:
            requirement = Requirement(wanted.pop())
            name = canonicalize_name(requirement.name)
            if name in seen or (requirement.marker and not requirement.marker.evaluate({"extra": ""})):
                continue
            seen.add(name)
            distribution = metadata.distribution(name)
            wanted += distribution.requires or []
            for top in {file.parts[0] for file in distribution.files} - {"..", "__pycache__"}:
                if not (self.packages / top).exists():
                    (self.packages / top).symlink_to(distribution.locate_file(top))
                    links.append(self.packages / top)
        return links

    @contextlib.contextmanager
    def linked(self, requirements):
        links = self.link(requirements)
        try:
            yield
        finally:
            for link in links:
                link.unlink()

    def run(self, program, *arguments, cwd=None):
        return done_well(self.bin / program, *arguments, cwd=cwd, env=self.env)

    def refscatter(self, *arguments, cwd=None):
        """Run the installed command, whether it succeeds or not."""
        command = [self.bin / "refscatter", *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=100, cwd=cwd, env=self.env)


@pytest.fixture(scope="module")
def elsewhere(built, tmp_path_factory):
    return Elsewhere(tmp_path_factory.mktemp("elsewhere") / "environment", built[0])


IMPORTS = ["import mitsuba_refscatter, mitsuba as mi; mi.set_variant(name)",
           "import mitsuba as mi; mi.set_variant(name); import mitsuba_refscatter"]  # fmt: skip


@needs_variant
@pytest.mark.slow
@pytest.mark.parametrize("imports", IMPORTS, ids=["before the variant", "after the variant"])
def test_the_wheel_is_imported(elsewhere, imports, tmp_path):
    name = mitsuba_refscatter.platform.default_variant()
    code = (
        f"name = {name!r}; {imports}; print(mi.load_dict({{'type': 'refscatter'}}).class_name()); "
        "print(mitsuba_refscatter.__file__); import importlib.util as u; "
        "print([x for x in ('matplotlib', 'plotly', 'flip_evaluator', 'OpenEXR', 'pytest') if u.find_spec(x)])"
    )
    _, file, extras = elsewhere.run("python", "-c", code, cwd=tmp_path).splitlines()
    assert extras == "[]" and Path(file) == elsewhere.packages / PACKAGE / "__init__.py"


@needs_variant
@pytest.mark.slow
def test_the_commands_of_the_description_work(built, elsewhere, tmp_path):
    """In the order in which they stand, in a directory that holds nothing else; the picture is smaller."""
    commands = re.findall(r"^ {4}(refscatter .*)$", metadata_of(built[0]).get_payload(), re.MULTILINE)
    assert [command.split()[1] for command in commands] == ["check", "scenes", "render"]
    for command in commands:
        elsewhere.run(*shlex.split(command.replace("res=256", "res=32")), cwd=tmp_path)
    assert {"sphere.exr", "sphere.png", "sphere"} == {path.name for path in tmp_path.iterdir()}
    assert "underwater" in elsewhere.run("refscatter", "scenes")


@needs_variant
@pytest.mark.slow
@pytest.mark.parametrize("command", MORE)
def test_hints_of_extras_fit(built, elsewhere, command, tmp_path):
    """What a command asks for is not installed, belongs to the extra, suffices, and is asked for before any work."""
    arguments, writes = MORE[command]
    elsewhere.run("refscatter", "scenes", "sphere", "--triangles", "80", cwd=tmp_path)
    call = [command, *(("sphere/scene.xml" if x == "SCENE" else x) for x in arguments), "-o", "out"]
    refused = elsewhere.refscatter(*call, cwd=tmp_path)
    assert_one_sentence(refused, "this needs")
    assert not (tmp_path / "out").exists()
    program, _, names = refused.stderr.strip().partition(": this needs ")[2].partition(" -m pip install ")
    assert Path(program.partition(": ")[2]) in (elsewhere.bin / "python", elsewhere.bin / "python3")
    about = metadata_of(built[0]).get_all("Requires-Dist")
    extra = {canonicalize_name(Requirement(x).name) for x in about if x.endswith('extra == "compare"')}
    assert {canonicalize_name(name) for name in names.split()} <= extra
    if writes is not None:
        with elsewhere.linked(names.split()):
            elsewhere.run("refscatter", *call, cwd=tmp_path)
        assert (tmp_path / "out" / writes).is_file()


@pytest.mark.slow
def test_every_command_is_tried(elsewhere):
    """Those that need more, and those of the description; ``supported`` prints a table."""
    listed = re.findall(r"^  ([a-z-]+) ", elsewhere.run("refscatter", "--help").partition("Commands:")[2], re.MULTILINE)
    assert sorted(listed) == sorted([*MORE, "check", "scenes", "render", "supported"])
    assert "| emitter | `point` |" in elsewhere.run("refscatter", "supported")

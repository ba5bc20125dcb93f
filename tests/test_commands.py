"""The command, run as a user runs it."""

import functools
import json
import os
import re
import resource
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from mitsuba_refscatter import platform

ROOT = Path(__file__).parent.parent
SPHERE = ROOT / "scenes" / "sphere" / "scene.xml"
ENVIRONMENT = {**os.environ, "COLUMNS": "200", "PYTHONPATH": str(ROOT)}
COMMAND = [sys.executable, "-m", "mitsuba_refscatter"]
HANGS = 900
"""Seconds after which a command hangs, however busy the machine is."""

needs_variant = pytest.mark.skipif(
    all(platform.problem_of(v) for v in platform.PREFERRED), reason="no variant can render on this machine"
)


def refscatter(*arguments, cwd=None, **environment):
    command = COMMAND + [str(a) for a in arguments]
    env = {**ENVIRONMENT, **environment}
    return subprocess.run(command, capture_output=True, text=True, timeout=HANGS, cwd=cwd, env=env)


def assert_one_sentence(done, *words, code=1):
    """The command failed with a message of one line that says these words, and no traceback."""
    assert done.returncode == code, done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("refscatter: ")]
    assert len(lines) == 1 and "Traceback" not in done.stderr, done.stderr
    for word in words:
        assert word in lines[0], done.stderr


def scene_file(folder, body="", version=' version="3.0.0"'):
    path = Path(folder) / "scene.xml"
    path.write_text(f"<scene{version}>{body}</scene>")
    return path


@needs_variant
def test_check_says_what_is_there():
    done = refscatter("check")
    assert done.returncode == 0, done.stderr
    assert mi.__version__ in done.stdout and platform.default_variant() in done.stdout
    assert "polarisation" in done.stdout and "JIT variant" in done.stdout


def test_check_fails_where_nothing_can_render():
    done = refscatter("check", DRJIT_LIBLLVM_PATH="/nonexistent/libLLVM.so", CUDA_VISIBLE_DEVICES="-1")
    if platform.gpu_problem() is None and done.returncode == 0:
        pytest.skip("the GPU of this machine cannot be hidden")
    assert_one_sentence(done, "nothing can be rendered", "LLVM")


def test_render_is_refused_before_mitsuba_touches_llvm(tmp_path):
    done = refscatter("render", SPHERE, "-m", "llvm_ad_rgb", cwd=tmp_path, DRJIT_LIBLLVM_PATH="/nonexistent/libLLVM.so")
    assert_one_sentence(done, "llvm_ad_rgb", "LLVM")
    assert not list(tmp_path.iterdir())


def test_scenes_lists_and_writes(tmp_path):
    listed = refscatter("scenes")
    assert listed.returncode == 0 and "bumpy_sphere" in listed.stdout and "20480" in listed.stdout
    written = refscatter("scenes", "sphere", "--triangles", "100", "-o", tmp_path / "here")
    assert written.returncode == 0 and "(80 triangles)" in written.stdout
    assert (tmp_path / "here" / "meshes" / "sphere.ply").exists()
    assert_one_sentence(refscatter("scenes", "nonsense"), "nonsense", "bumpy_sphere")
    assert_one_sentence(refscatter("scenes", "branches", "--triangles", "10"), "4000")
    assert refscatter("scenes", "sphere", "--triangles", "none").returncode == 2


@needs_variant
def test_scenes_go_where_files_can_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    assert_one_sentence(refscatter("scenes", "sphere", "-o", tmp_path / "file" / "x"), "nothing can be written")


BAD_SCENES = [
    ("<shape", ["Parsing of XML"]),
    ('<shape type="nonsense"/>', ["nonsense", "not found"]),
    ('<shape type="sphere"><float name="radios" value="2"/></shape>', ["radios"]),
    ('<shape type="sphere"><float name="radius" value="x"/></shape>', ["floating point"]),
    ('<shape type="sphere"><string name="radius" value="x"/></shape>', ["radius", "wrong type"]),
    ('<shape type="ply"><string name="filename" value="nowhere.ply"/></shape>', ["nowhere.ply", "not found"]),
    ('<shape type="sphere"/>', ["no sensor"]),
    ('<integrator type="path"><integer name="max_depth" value="$depth"/></integrator>', ["$depth"]),
    ('<integrator type="refscatter"><string name="tolerance" value="x"/></integrator>', ["tolerance"]),
]


@needs_variant
@pytest.mark.parametrize("body, words", BAD_SCENES, ids=[body[1:30] for body, _ in BAD_SCENES])
def test_a_bad_scene_is_one_sentence(body, words, tmp_path):
    done = refscatter("render", scene_file(tmp_path, body), "-o", tmp_path / "out.exr")
    assert_one_sentence(done, *words)
    assert [p.name for p in tmp_path.iterdir()] == ["scene.xml"]


@needs_variant
def test_a_vertex_index_out_of_range_does_not_end_the_process(tmp_path):
    header = ("ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
              "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n")  # fmt: skip
    data = struct.pack("<9f", *range(9)) + struct.pack("<B3i", 3, 0, 1, 9_000_000)
    (tmp_path / "mesh.ply").write_bytes(header.encode() + data)
    body = '<default name="m" value="mesh"/><shape type="ply"><string name="filename" value="$m.ply"/></shape>'
    assert_one_sentence(refscatter("render", scene_file(tmp_path, body)), "mesh.ply", "9000000")
    text = header.replace("binary_little_endian", "ascii") + "0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n"
    (tmp_path / "mesh.ply").write_text(text)
    assert_one_sentence(refscatter("render", scene_file(tmp_path, body)), "mesh.ply", "0, 1, 3")


@needs_variant
def test_usage_errors(tmp_path):
    assert_one_sentence(refscatter("render", tmp_path / "nowhere.xml"), "nowhere.xml")
    assert_one_sentence(refscatter("render", SPHERE, "-m", "scalar_rgb", cwd=tmp_path), "needs a JIT variant")
    assert_one_sentence(refscatter("render", SPHERE, "-D", "nonsense=1", cwd=tmp_path), "nonsense")
    assert_one_sentence(refscatter("render", SPHERE, "-o", tmp_path), "is a directory")
    (tmp_path / "file").write_text("")
    assert_one_sentence(refscatter("render", SPHERE, "-o", tmp_path / "file" / "x.exr"), "nothing can be written")
    assert refscatter("render", SPHERE, "-D", "nonsense").returncode == 2
    assert refscatter("render", SPHERE, "-s", "many").returncode == 2
    assert refscatter("render").returncode == 2


@needs_variant
def test_render_writes_both_pictures_and_says_where(tmp_path):
    done = refscatter("render", SPHERE, "-D", "res=24", "-s", "2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["scene.exr", "scene.png"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["scene.exr", "scene.png"]
    assert mi.Bitmap(str(tmp_path / "scene.exr")).height() == 24
    quiet = refscatter("render", SPHERE, "-D", "res=24", "-o", "a/b", "--quiet", cwd=tmp_path)
    assert quiet.returncode == 0 and quiet.stdout == quiet.stderr == ""
    assert (tmp_path / "a" / "b.exr").exists() and (tmp_path / "a" / "b.png").exists()


@needs_variant
@pytest.mark.parametrize("integrator, replaced", [
    ('<integrator type="path"/>', True),
    ("", True),
    ('<integrator type="moment"><integrator type="refscatter"/></integrator>', False),
    ('<integrator type="aov"><string name="aovs" value="d:depth"/><integrator type="refscatter"/></integrator>', False),
], ids=["path", "none", "moment", "aov"])  # fmt: skip
def test_another_integrator_is_replaced_and_ours_is_kept(integrator, replaced, tmp_path):
    text = SPHERE.read_text().replace("meshes/", f"{SPHERE.parent}/meshes/")
    text = text.replace('<default name="surfaces" value="true"/>', "")
    text = re.sub("<integrator.*</integrator>", integrator, text, flags=re.DOTALL)
    (tmp_path / "scene.xml").write_text(text)
    done = refscatter("render", "scene.xml", "-D", "res=16", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert ("rendering with refscatter instead" in done.stderr) == replaced


@needs_variant
@pytest.mark.parametrize("number, after, code",
                         [(signal.SIGINT, 8.0, 130), (signal.SIGTERM, 8.0, 143), (signal.SIGTERM, 0.3, 143)],
                         ids=["Ctrl-C", "SIGTERM", "SIGTERM early"])  # fmt: skip
def test_interrupting_keeps_the_earlier_picture(tmp_path, number, after, code):
    (tmp_path / "out.exr").write_bytes(b"earlier")
    command = COMMAND + ["render", str(SPHERE), "-o", "out.exr", "-s", str(1 << 20)]  # hours
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # A shell that runs this in the background makes its processes deaf to SIGINT.
    hears = functools.partial(signal.signal, signal.SIGINT, signal.default_int_handler)
    process = subprocess.Popen(command, cwd=tmp_path, env=ENVIRONMENT, preexec_fn=hears, **pipes)
    assert process.stderr is not None
    assert "Rendering" in process.stderr.readline()
    time.sleep(after)  # on a quiet machine 8 s are in the middle of the render
    process.send_signal(number)
    _, told = process.communicate(timeout=HANGS)
    assert process.returncode == code and "stopped" in told and "Traceback" not in told
    assert (tmp_path / "out.exr").read_bytes() == b"earlier"
    assert [p.name for p in tmp_path.iterdir()] == ["out.exr"]


@needs_variant
def test_a_full_disk_keeps_the_earlier_picture(tmp_path):
    """No file may grow beyond 3,000 bytes, as on a disk that is full then; the picture would be larger."""
    (tmp_path / "out.exr").write_bytes(b"earlier")
    limit = functools.partial(resource.setrlimit, resource.RLIMIT_FSIZE, (3000, 3000))
    command = COMMAND + ["render", str(SPHERE), "-o", "out.exr", "-D", "res=64", "-s", "1"]
    done = subprocess.run(
        command, cwd=tmp_path, env=ENVIRONMENT, preexec_fn=limit, capture_output=True, text=True, timeout=HANGS
    )
    assert_one_sentence(done, "out.exr", "cannot be written")
    assert (tmp_path / "out.exr").read_bytes() == b"earlier"
    assert [p.name for p in tmp_path.iterdir()] == ["out.exr"]


@needs_variant
@pytest.mark.parametrize("more", [(), pytest.param(("photon_beams", "refscatter_exact_mesh"), marks=pytest.mark.slow)])
def test_scaling_measures_and_writes_results(tmp_path, more):
    """Two tiny sizes through the command, some of the methods: the table and the rows of results.json."""
    chosen = ("refscatter", "holzschuch2015", *more)
    sizes = ("--triangles", 80, "--triangles", 320, "--resolution", 16, "--samples", 2)
    done = refscatter("scaling", *sizes, *(x for name in chosen for x in ("--method", name)), "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    data = json.loads((tmp_path / "results.json").read_text())
    assert data["schema"] == "refscatter-results-1" and data["machine"]["cores"] >= 1
    methods = (*chosen, "volpath")
    assert [(row["method"], row["triangles"]) for row in data["rows"]] == [(m, n) for n in (80, 320) for m in methods]
    for method in methods:
        assert f"{method}: wall_seconds grows with triangles^" in done.stdout
    assert np.array(mi.Bitmap(str(tmp_path / "scaling.png"))).std() > 5
    ours = data["rows"][0]
    assert ours["wall_seconds"] > 0 and ours["relmse"] is None and ours["settings"]["surfaces"] is False
    assert ours["contributing_per_ray"] > 0 and ours["candidates_per_ray"] > 0
    assert "320" in done.stdout
    published = data["rows"][1]
    assert published["settings"]["estimator"] == "interval" and published["settings"]["culling"] == "spindle"
    assert published["wall_seconds"] > 0 and published["contributing_per_ray"] > 0


def test_scaling_refuses_an_unknown_method():
    done = refscatter("scaling", "--method", "jensen2001")
    assert done.returncode == 2 and "holzschuch2015" in done.stderr


@needs_variant
def test_convergence_draws_a_plot(tmp_path):
    """A tiny run through the command: the table, the rows of results.json, and a picture with something in it."""
    done = refscatter("convergence", "--scene", "sphere", "--resolution", 8, "--most", 64, "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "results.json").read_text())["rows"]
    assert [(row["method"], row["samples"]) for row in rows] == [
        ("interval", 1), ("interval", 4), ("interval", 16), ("interval", 64), ("point", 16), ("point", 64),
    ]  # fmt: skip
    assert all(0 < row["mean_relative_error"] < 0.5 and row["wall_seconds"] > 0 for row in rows)
    assert rows[3]["mean_relative_error"] < 0.01
    picture = np.array(mi.Bitmap(str(tmp_path / "convergence.png")))
    assert picture.shape[1] > 300 and picture.std() > 5
    assert sorted(p.name for p in tmp_path.iterdir()) == ["convergence.png", "results.json"]


@pytest.mark.slow
@needs_variant
def test_equal_error_measures_and_extrapolates(tmp_path):
    """A tiny run through the command: the rows, the extrapolation, the picture."""
    sizes = (
        "--resolution",
        8,
        "--triangles",
        80,
        "--seconds",
        0,
        "--error",
        0.5,
        "--volpath-radius",
        0.8,
        "--volpath-radius",
        0.4,
    )
    done = refscatter("equal-error", *sizes, "--radius", 0.2, "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "results.json").read_text())["rows"]
    assert [(row["method"], row["radius"], row["extrapolated"]) for row in rows] == [
        ("volpath", 0.8, False), ("volpath", 0.4, False), ("volpath", 0.2, True), ("refscatter", 0.2, False),
        ("volpath", None, False), ("refscatter", None, False),
    ]  # fmt: skip
    large, middle, small, ours = (row["seconds_to_error"] for row in rows[:4])
    assert large > 0 and small == pytest.approx(4 * middle, rel=1e-6)
    assert rows[3]["mean_relative_error"] <= 0.5 and rows[3]["speedup"] == pytest.approx(small / ours)
    assert "extrapolated" in done.stdout
    assert np.array(mi.Bitmap(str(tmp_path / "equal_error.png"))).std() > 5


def test_supported_prints_the_table():
    done = refscatter("supported")
    assert done.returncode == 0 and "| `directional` |" in done.stdout and "no: " in done.stdout

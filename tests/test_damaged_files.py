"""Scenes and meshes that were damaged at random, through the command: it renders them or says in one sentence why not.

A part of ``make test-all``; REFSCATTER_FUZZ_SCENES says how many. What failed stays as a directory to look at.
"""

import os
import random
import re
import shutil
import subprocess
import time
from pathlib import Path

import build
import mitsuba as mi
import numpy as np
import pytest
from meshes import icosphere
from test_commands import COMMAND, ENVIRONMENT, HANGS, ROOT, needs_variant

SCENES = int(os.environ.get("REFSCATTER_FUZZ_SCENES", "100"))
ENOUGH = 100
"""Damaged scenes of which some render: about a tenth does, and of 100 none with a probability of 3e-5."""

NUMBERS = [
    "0",
    "-1",
    "1",
    "1e-30",
    "1e30",
    "nan",
    "inf",
    "-inf",
    "",
    "1e400",
    "99999999999",
    "0.5",
    "x",
    "1,2",
    "1 2 3",
    "-0",
]
WORDS = [
    "sphere", "dielectric", "homogeneous", "point", "area", "ply", "nothing", "", "conductor", "rgb",
    "refscatter", "path", "thindielectric", "null", "constant", "isotropic", "hg", "independent", "hdrfilm",
    "perspective",
]  # fmt: skip


def damaged_xml(text, rng):
    """The text with one to three numbers, words, lines or characters changed."""
    for _ in range(rng.randint(1, 3)):
        kind = rng.choice(["number", "word", "line out", "line twice", "lines swapped", "character", "tag"])
        lines = text.split("\n")
        i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        numbers, words = (
            list(re.finditer(r'(?<=value=")[^"]*(?=")', text)),
            list(re.finditer(r'(?<=type=")\w*(?=")', text)),
        )
        if kind == "number" and numbers:
            found = rng.choice(numbers)
            text = text[: found.start()] + rng.choice(NUMBERS) + text[found.end() :]
        elif kind == "word" and words:
            found = rng.choice(words)
            text = text[: found.start()] + rng.choice(WORDS) + text[found.end() :]
        elif kind == "line out":
            text = "\n".join(lines[:i] + lines[i + 1 :])
        elif kind == "line twice":
            text = "\n".join([*lines[:i], lines[i], *lines[i:]])
        elif kind == "lines swapped":
            lines[i], lines[j] = lines[j], lines[i]
            text = "\n".join(lines)
        elif kind == "character":
            at = rng.randrange(len(text))
            text = text[:at] + chr(rng.randrange(32, 127)) + text[at + 1 :]
        else:
            text = re.sub(r'name="\w+"', lambda found: rng.choice([found.group(), found.group(), 'name="x"']), text)
    return text


def damaged_bytes(data, rng):
    """The bytes with some of them changed, cut off, left out or doubled."""
    data = bytearray(data)
    kind, at = rng.choice(["bits", "cut", "out", "twice", "header", "block"]), rng.randrange(len(data))
    if kind == "bits":
        for _ in range(rng.randint(1, 8)):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif kind == "cut":
        del data[at:]
    elif kind == "out":
        del data[at : at + rng.randint(1, 40)]
    elif kind == "twice":
        data[at:at] = data[at : at + rng.randint(1, 40)]
    elif kind == "header":
        at = rng.randrange(min(len(data), 400))
        data[at] = rng.randrange(256)
    else:
        data[at : at + 4] = rng.choice(
            [b"\xff\xff\xff\xff", b"\0\0\0\0", b"\0\0\x80\x7f", b"\0\0\xc0\x7f", b"\xff\xff\xff\x7f"]
        )
    return bytes(data)


def write_obj(mesh, path):
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"vn {x} {y} {z}" for x, y, z in mesh.normals]
    lines += ["f " + " ".join(f"{v + 1}//{v + 1}" for v in face) for face in mesh.faces]
    path.write_text("\n".join(lines) + "\n")


def originals(folder):
    """Files of a small scene: its text, and the mesh as PLY in bytes and in text and as OBJ."""
    ball = icosphere(1)
    build.mesh_shape(ball, folder / "ball.ply")
    write_obj(ball, folder / "ball.obj")
    text = (ROOT / "scenes" / "sphere" / "scene.xml").read_text()
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r'value="meshes/\w+\.ply"', 'value="ball.ply"', text)
    header = "ply\nformat ascii 1.0\nelement vertex {}\n{}element face {}\n"
    header += "property list uchar int vertex_indices\nend_header\n"
    names = "".join(f"property float {x}\n" for x in ("x", "y", "z", "nx", "ny", "nz"))
    rows = [" ".join(map(str, [*x, *n])) for x, n in zip(ball.vertices, ball.normals)]
    rows += ["3 " + " ".join(map(str, face)) for face in ball.faces]
    ascii_ply = header.format(len(ball.vertices), names, len(ball.faces)) + "\n".join(rows) + "\n"
    return {"xml": text, "ply": (folder / "ball.ply").read_bytes(), "obj": (folder / "ball.obj").read_bytes(),
            "ascii": ascii_ply.encode()}  # fmt: skip


def attempt(folder, files, rng):
    """Damages one file and renders. Returns what is wrong with how the command took it, None if nothing is; and whether
    it rendered."""
    kind = rng.choice(["xml", "xml", "ply", "obj", "ascii"])
    name = "ball.obj" if kind == "obj" else "ball.ply"
    text = files["xml"].replace('type="ply"', 'type="obj"').replace("ball.ply", name) if kind == "obj" else files["xml"]
    mesh = files["obj"] if kind == "obj" else files["ascii"] if kind == "ascii" else files["ply"]
    if kind == "xml":
        text = damaged_xml(text, rng)
    else:
        mesh = damaged_bytes(mesh, rng)
    (folder / "scene.xml").write_text(text)
    (folder / name).write_bytes(mesh)
    command = [*COMMAND, "render", "scene.xml", "-D", "res=8", "-s", "1", "-o", "out.exr"]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=HANGS, cwd=folder, env=ENVIRONMENT, errors="replace"
        )
    except subprocess.TimeoutExpired:
        return f"{kind}: hangs", False
    told = [line for line in done.stderr.splitlines() if line.startswith("refscatter: ")]
    left = {p.name for p in folder.iterdir()} - {"scene.xml", "ball.ply", "ball.obj", "out.exr", "out.png"}
    if left:
        return f"{kind}: leaves {left}", False
    if done.returncode == 0:
        if not (folder / "out.exr").exists():
            return f"{kind}: no picture and no error", False
        image = np.array(mi.Bitmap(str(folder / "out.exr")), dtype=np.float64)
        if not np.isfinite(image).all() or (image < 0).any():
            return f"{kind}: the picture holds NaN, infinity or negative numbers", False
        return None, True
    if done.returncode not in (1, 2) or "Traceback" in done.stderr or (done.returncode == 1 and len(told) != 1):
        return f"{kind}: exit code {done.returncode}: {done.stderr[-400:]}", False
    return (f"{kind}: a picture in spite of an error" if (folder / "out.exr").exists() else None), False


@pytest.mark.slow
@needs_variant
def test_damaged_files(rgb, tmp_path):
    """Each with a seed that is printed, and kept with its files if it fails."""
    files, rendered, failed = originals(tmp_path), 0, []
    first = int(os.environ.get("REFSCATTER_FUZZ_SEED", time.time_ns() % 1_000_000_000))
    print(f"{SCENES} damaged scenes from seed {first}")
    for seed in range(first, first + SCENES):
        folder = Path(tmp_path / str(seed))
        folder.mkdir()
        wrong, well = attempt(folder, files, random.Random(seed))
        rendered += well
        if wrong is None:
            shutil.rmtree(folder)
        else:
            failed.append(f"seed {seed} in {folder}: {wrong}")
            if len(failed) == 10:
                break
    print(f"of which {rendered} rendered")
    assert not failed, "\n".join(failed)
    assert SCENES < ENOUGH or 0 < rendered < SCENES, "all of them are taken alike"

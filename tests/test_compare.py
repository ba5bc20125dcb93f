"""``refscatter compare``, as a user runs it, at the smallest size; and what it is made of."""

import json
import re
from dataclasses import replace

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from against_volpath import BLOCK, WITHIN, Case, colour, glass
from build import point_light
from comparison import check, compare
from test_cli import SPHERE, assert_one_sentence, needs_variant, refscatter

from mitsuba_refscatter.compare import methods, race, suite

QUICK = ("--seconds", 0.1, "-D", "res=16", "-D", "spp=1")


@needs_variant
@pytest.mark.parametrize("names", [list(methods.METHODS)], ids=["all"])
def test_compare_writes_a_report(tmp_path, names):
    """All methods: rows with every figure, an image of each, and a report that needs nothing else."""
    done = refscatter("compare", SPHERE, *QUICK, "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    data = json.loads((tmp_path / "results.json").read_text())
    assert data["schema"] == "refscatter-results-1" and [row["method"] for row in data["rows"]] == names
    for row in data["rows"]:
        for key in ("wall_seconds", "cpu_seconds", "samples", "relmse", "mean_relative_error", "p99_relative_error", "bias",
                    "flip", "triangles", "warm_up_seconds"):  # fmt: skip
            assert np.isfinite(row[key]), (row["method"], key)
        assert row["settings"]["resolution"] == [16, 16] and len(row["curve"]) >= 1
        image = np.array(mi.Bitmap(str(tmp_path / f"{row['method']}.exr")))
        assert image.shape == (16, 16, 3)
        assert image.max() > 0 or row["method"] == "volpath"  # which may find nothing so soon
        header = OpenEXR.File(str(tmp_path / f"{row['method']}.exr"), header_only=True).header()
        assert (header["scene"], header["spp"]) == ("sphere", row["samples"]) and row["settings"]["type"] in header[
            "integrator"
        ]
    by_name = {row["method"]: row for row in data["rows"]}
    assert by_name["refscatter"]["relmse"] < by_name["straight_line"]["relmse"]
    assert by_name["refscatter"]["seconds_to_first"] == by_name["refscatter"]["wall_seconds"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert all(name in page for name in names) and "Bidirectional" in page
    assert not re.findall(r"(?:src|href)=[\"'](?!data:)", page)
    assert page.count("data:image/png;base64,") == 3 * (len(names) + 1) + 1
    assert (tmp_path / "reference.exr").exists() and (tmp_path / "refscatter.png").exists()


@needs_variant
def test_compare_with_a_given_reference_and_equal_quality(tmp_path):
    """The reference is the image given, here one that is twice too bright: the bias says so. ``--equal-quality`` goes on longer."""
    done = refscatter("compare", SPHERE, *QUICK, "--methods", "refscatter", "-o", tmp_path / "a")
    assert done.returncode == 0, done.stderr
    image = np.array(mi.Bitmap(str(tmp_path / "a" / "reference.exr")))
    mi.Bitmap(2 * image).write(str(tmp_path / "twice.exr"))
    again = refscatter("compare", SPHERE, *QUICK, "--methods", "refscatter,straight_line", "--reference", tmp_path / "twice.exr",
                       "--equal-quality", "-o", tmp_path / "b")  # fmt: skip
    assert again.returncode == 0, again.stderr
    rows = json.loads((tmp_path / "b" / "results.json").read_text())["rows"]
    assert rows[0]["bias"] == pytest.approx(-0.5, abs=0.02)
    assert rows[1]["curve"][-1][0] >= race.LONGEST * 0.1 / race.GROWTH > rows[0]["curve"][-1][0]


@needs_variant
def test_compare_says_what_is_wrong(tmp_path):
    unknown = refscatter("compare", SPHERE, "--methods", "refscatter,bdpt", "-o", tmp_path)
    assert unknown.returncode == 2 and "bdpt" in unknown.stderr and "volpath" in unknown.stderr
    assert refscatter("compare", "-o", tmp_path).returncode == 2
    assert refscatter("compare", SPHERE, "--suite", "-o", tmp_path).returncode == 2
    (tmp_path / "no.exr").write_bytes(b"no image")
    mi.Bitmap(np.ones((8, 8, 3), np.float32)).write(str(tmp_path / "small.exr"))
    mi.Bitmap(np.zeros((16, 16, 3), np.float32)).write(str(tmp_path / "black.exr"))
    for name, words in (("small", ("8 x 8", "16 x 16")), ("black", ("black",))):
        done = refscatter("compare", SPHERE, "--reference", tmp_path / f"{name}.exr", *QUICK, "-o", tmp_path)
        assert_one_sentence(done, *words)
    assert_one_sentence(refscatter("compare", tmp_path / "none.xml", *QUICK, "-o", tmp_path), "none.xml")
    assert_one_sentence(
        refscatter("compare", SPHERE, "--reference", tmp_path / "no.exr", *QUICK, "-o", tmp_path), "no.exr"
    )


def test_volpath_finds_the_same_light_as_ours(rgb, monkeypatch):
    """As comparisons set it up: restricted to the same paths, the same scene without scattering subtracted, a sphere in place of
    the point light; here a large one, which it finds, and against ours with that sphere."""
    radius, intensity = 0.7, np.array([1, 2, 3])
    monkeypatch.setattr(methods, "LIGHT_RADIUS", radius)
    case = Case(lambda: {"light": point_light((1.6, 2.2, 1.3), intensity.tolist()), "body": {
        "type": "cube", "bsdf": glass(1.3), "interior": WITHIN}})  # fmt: skip
    scenes = [methods.for_volpath(case.scene({"type": "path"}, **changes)) for changes in ({}, {"albedo": 0.0})]
    theirs = [np.subtract(*(np.array(mi.render(x, seed=k, spp=256)) for x in scenes)) for k in range(16)]
    ball = {"type": "sphere", "center": [1.6, 2.2, 1.3], "radius": radius,
            "emitter": {"type": "area", "radiance": colour(*(intensity / (np.pi * radius**2)).tolist())}}  # fmt: skip
    parts = {**case.parts(), "light": ball}
    options = {"type": "refscatter", "surfaces": False, "internal_bounces": 0, "culling": "spindle"}
    scene = Case(lambda: parts).scene(options)
    ours = [np.array(mi.render(scene, seed=k, spp=16)) for k in range(8)]
    check(compare(np.array(ours), np.array(theirs), BLOCK), mean_error=0.02, block_error=0.12)


@pytest.mark.parametrize("sampler", ["independent", "stratified", "multijitter", "orthogonal", "ldsampler"])
def test_passes_grow_whatever_the_sampler(rgb, sampler):
    """Passes of any size, also those that a sampler does not take; all samples count alike."""
    parts = Case(
        lambda: {
            "light": point_light((1.6, 2.2, 1.3)),
            "body": {"type": "cube", "bsdf": glass(1.3), "interior": WITHIN},
        }
    )
    scene = parts.scene({"type": "path"})
    sensor = mi.load_dict({
        "type": "perspective", "fov": 34, "to_world": mi.ScalarTransform4f().look_at([0.3, 0.5, 5], [0, 0, 0], [0, 1, 0]),
        "sampler": {"type": sampler}, "film": {"type": "hdrfilm", "width": 8, "height": 8, "pixel_format": "rgb"}})  # fmt: skip
    integrator, sizes, seen = mi.load_dict({"type": "refscatter", "surfaces": False}), [1, 2, 5, 8, 0], []

    def watch(samples, image):
        seen.append(samples)
        return sizes[len(seen) - 1]

    expected = np.array(integrator.render(scene, sensor, spp=64))
    integrator.watch = watch
    found = np.array(integrator.render(scene, sensor, spp=1 << 20))
    assert seen == [1, 2, 4, 9, 17]
    assert np.abs(found - expected).sum() < 0.1 * expected.sum() and found.sum() == pytest.approx(
        expected.sum(), rel=0.01
    )


def test_the_suite_can_be_made(rgb, tmp_path):
    """Its cases have names of their own, and the changes that they name are made."""
    assert len({case.name for case in suite.CASES}) == len(suite.CASES)
    changed = [case for case in suite.CASES if case.density == 8 or case.name == "light_near"]
    small = suite.Case("plain", "bumpy_sphere", 80)
    plain = mi.traverse(small.subject(tmp_path, 8).load())
    scale = "body.interior_medium.scale"

    def position(parameters):
        return np.ravel(next(value for key, value in parameters if key.endswith(".position")))

    for case in changed:
        found = mi.traverse(replace(case, triangles=80).subject(tmp_path, 8).load())
        assert found[scale] == pytest.approx(case.density * plain[scale])
        assert np.allclose(position(found), case.light or position(plain))


@pytest.mark.slow
@needs_variant
def test_gallery(tmp_path):
    """Three strips: four tiles, two rows of four, one tile per method, all of them with light."""
    done = refscatter("gallery", "--resolution", 12, "--samples", 1, "--seconds", 0.1, "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    for name, rows, columns in (("scenes", 1, 4), ("densities", 2, 4), ("methods", 1, len(methods.METHODS))):
        image = np.array(mi.Bitmap(str(tmp_path / f"{name}.png")))
        assert image.shape == (16 * rows - 4, 16 * columns - 4, 3)
        tiles = [image[16 * i : 16 * i + 12, 16 * j : 16 * j + 12] for i in range(rows) for j in range(columns)]
        assert min(tile.max() for tile in tiles) > 60, [tile.max() for tile in tiles]

"""``refscatter compare``, as a user runs it, at the smallest size; and what it is made of."""

import json
import re
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
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
        assert image.shape == (16, 16, 3) and image.max() > 0
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


def test_compare_says_what_is_wrong(tmp_path):
    unknown = refscatter("compare", SPHERE, "--methods", "refscatter,bdpt", "-o", tmp_path)
    assert unknown.returncode == 2 and "bdpt" in unknown.stderr and "volpath" in unknown.stderr
    assert refscatter("compare", "-o", tmp_path).returncode == 2
    assert refscatter("compare", SPHERE, "--suite", "-o", tmp_path).returncode == 2
    (tmp_path / "no.exr").write_bytes(b"no image")
    assert_one_sentence(refscatter("compare", tmp_path / "none.xml", *QUICK, "-o", tmp_path), "none.xml")
    assert_one_sentence(
        refscatter("compare", SPHERE, "--reference", tmp_path / "no.exr", *QUICK, "-o", tmp_path), "no.exr"
    )


def test_volpath_finds_the_same_light_as_ours(rgb):
    """In a scene with a light that it finds (what stands for a point light is large enough here): restricted to the same
    paths, scattering alone, the means agree."""
    near = {"type": "sphere", "radius": 1.0, "bsdf": {"type": "dielectric", "int_ior": 1.3, "ext_ior": 1.0},
            "interior": {"type": "homogeneous", "sigma_t": 1.0, "albedo": 0.8}}  # fmt: skip
    sensor = {"type": "perspective", "fov": 30, "to_world": mi.ScalarTransform4f().look_at([0, 0.5, 5], [0, 0, 0], [0, 1, 0]),
              "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}, "pixel_format": "rgb"}}  # fmt: skip
    parts = {"type": "scene", "sensor": sensor, "body": near, "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, -2, 0]).rotate([1, 0, 0], -90).scale(9)},
             "lamp": {"type": "point", "position": [0.4, 1.12, 0.2], "intensity": {"type": "rgb", "value": [1, 2, 3]}}}  # fmt: skip
    scene, dark = (mi.load_dict(parts, optimize=False) for _ in range(2))
    methods.without_scattering(dark)
    both, clear = methods.for_volpath(scene), methods.for_volpath(dark)
    theirs = (
        np.mean(
            [
                np.array(x.integrator().render(x, seed=k, spp=256)) * sign
                for k in range(64)
                for x, sign in ((both, 1), (clear, -1))
            ],
            axis=0,
        )
        * 2
    )
    # The sphere that stands for the point has a radius of 0.1: the same for ours.
    ours = np.array(
        mi.load_dict({"type": "refscatter", "surfaces": False, "internal_bounces": 0}).render(
            both_lights(parts), spp=256
        )
    )
    ratio = theirs.mean(axis=(0, 1)) / ours.mean(axis=(0, 1))
    print(ratio)
    assert np.abs(ratio - 1).max() < 0.05


def both_lights(parts):
    lamp = {"type": "sphere", "center": [0.4, 1.12, 0.2], "radius": methods.LIGHT_RADIUS, "emitter": {
        "type": "area", "radiance": {"type": "rgb", "value": [x / (np.pi * methods.LIGHT_RADIUS**2) for x in (1, 2, 3)]}}}  # fmt: skip
    return mi.load_dict({**parts, "lamp": lamp}, optimize=False)


def test_the_suite_can_be_made(rgb, tmp_path):
    """Its cases have names of their own, and the changes that they name are made."""
    assert len({case.name for case in suite.CASES}) == len(suite.CASES)
    changed = [case for case in suite.CASES if case.density == 8 or case.name == "light_near"]
    small = suite.Case("plain", "bumpy_sphere", 80)
    plain = mi.traverse(small.subject(tmp_path, 8).load())
    for case in changed:
        found = mi.traverse(replace(case, triangles=80).subject(tmp_path, 8).load())
        scale, position = "body.interior_medium.scale", next(key for key, _ in plain if key.endswith(".position"))
        assert found[scale] == pytest.approx(case.density * plain[scale])
        assert np.allclose(np.ravel(found[position]), case.light or np.ravel(plain[position]))

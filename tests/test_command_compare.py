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
from test_commands import SPHERE, assert_one_sentence, needs_variant, refscatter

from mitsuba_refscatter import example_scenes, platform
from mitsuba_refscatter.benchmarks import duel, methods, race, suite, timing
from mitsuba_refscatter.integrators.hooks import Hooks

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
        for key in ("wall_seconds", "cpu_seconds", "samples", "relmse", "mean_relative_error", "p99_relative_error",
                    "bias", "flip", "triangles", "warm_up_seconds"):  # fmt: skip
            assert np.isfinite(row[key]), (row["method"], key)
        assert row["settings"]["resolution"] == [16, 16] and len(row["curve"]) >= 1
        image = np.array(mi.Bitmap(str(tmp_path / f"{row['method']}.exr")))
        assert image.shape == (16, 16, 3)
        assert image.max() > 0 or row["method"] == "volpath"  # which may find nothing so soon
        header = OpenEXR.File(str(tmp_path / f"{row['method']}.exr"), header_only=True).header()
        assert (header["scene"], header["spp"]) == ("sphere", row["samples"]) and row["settings"]["type"] in header[
            "integrator"
        ]
    first = data["rows"][0]
    assert first["method"] == "refscatter" and first["seconds_to_first"] == first["wall_seconds"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert all(name in page for name in names) and "Bidirectional" in page
    assert not re.findall(r"(?:src|href)=[\"'](?!data:)", page)
    assert page.count("data:image/png;base64,") == 3 * (len(names) + 1) + 1
    assert (tmp_path / "reference.exr").exists() and (tmp_path / "refscatter.png").exists()


@pytest.fixture(scope="module")
def subject():
    mi.set_variant(platform.default_variant())
    return duel.Subject.of("sphere", lambda: example_scenes.load(SPHERE, res="16"))


@pytest.fixture(scope="module")
def truth(subject):
    """The image of 64 samples per pixel at the tolerance of references."""
    settings = methods.single_scattering("refscatter", 0, race.REFERENCE_TOLERANCE)
    return np.array(mi.load_dict(settings).render(subject.load(), seed=race.REFERENCE_SEED, spp=64), dtype=float)


@pytest.fixture
def by_samples(monkeypatch):
    """Races on whose clock each sample per pixel takes a second, however busy the machine is."""

    class Stopwatch(timing.Stopwatch):
        samples = 0

        def go_on(self):
            pass

        def pause(self):
            self.wall = self.cpu = float(self.samples)

    class Follower(race._Follower):
        def __call__(self, samples, image):
            self.clock.samples = samples
            return super().__call__(samples, image)

    monkeypatch.setattr(race, "_Follower", Follower)
    monkeypatch.setattr(timing, "Stopwatch", Stopwatch)
    monkeypatch.setattr(timing, "clock", lambda work: (1.0, 1.0))


@needs_variant
def test_with_as_many_samples_ours_is_nearest(rgb, subject, truth, by_samples):
    """The straight line computes another image; ``volpath`` is noisy."""
    names = ["refscatter", "straight_line", "volpath"]
    rows = duel.compare(subject, names, race.Setup(rgb, seconds=8.0), truth).rows
    assert [(row["method"], row["samples"], row["wall_seconds"]) for row in rows] == [(name, 8, 8.0) for name in names]
    ours, straight, volpath = (row["relmse"] for row in rows)
    assert ours < straight / 4 and ours < volpath / 4
    assert abs(rows[0]["bias"]) < 0.02 and rows[1]["bias"] < -0.2
    assert [t for t, _ in rows[0]["curve"]] == [1, 2, 4, 8]


@needs_variant
@pytest.mark.parametrize(
    ("names", "ends"),
    [(["refscatter", "straight_line"], [4, race.LONGEST * 4]), (["straight_line", "refscatter"], [4, 4])],
)
def test_equal_quality_goes_on_longer(rgb, subject, truth, by_samples, names, ends):
    """Up to ``LONGEST`` where the quality of the first method is not reached: not by the straight line."""
    rows = duel.compare(subject, names, race.Setup(rgb, seconds=4.0, equal_quality=True), truth).rows
    assert [row["samples"] for row in rows] == [4, 4]
    assert [row["curve"][-1][0] for row in rows] == ends


@needs_variant
def test_compare_with_a_given_reference_and_equal_quality(tmp_path, truth):
    """The reference is the image given, here one that is twice too bright: the bias says so, with one sample as
    with many.

    Both hold however few samples there is time for: a straight line is farther from that image than one sample of ours.
    """
    twice = tmp_path / "twice.exr"
    mi.Bitmap((2 * truth).astype(np.float32)).write(str(twice))
    options = "--methods", "refscatter,straight_line", "--reference", twice, "--equal-quality", "-o", tmp_path / "out"
    done = refscatter("compare", SPHERE, *QUICK, *options)
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(*(mi.Bitmap(str(tmp_path / x)) for x in ("twice.exr", "out/reference.exr")))
    first, second = json.loads((tmp_path / "out" / "results.json").read_text())["rows"]
    assert first["bias"] == pytest.approx(-0.5, abs=0.02)
    assert all(t < first["seconds"] for t, _ in first["curve"][:-1])
    assert second["curve"][-1][0] >= race.LONGEST * second["seconds"] / race.GROWTH


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
    """As comparisons set it up: restricted to the same paths, what does not scatter subtracted, a sphere as the
    point light.

    Here that is a large one, which it finds, and ours is lit by that sphere.
    """
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
    view = mi.ScalarTransform4f().look_at([0.3, 0.5, 5], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 8, "height": 8, "pixel_format": "rgb"}
    sensor = mi.load_dict(
        {"type": "perspective", "fov": 34, "to_world": view, "sampler": {"type": sampler}, "film": film}
    )
    integrator, sizes, seen = mi.load_dict({"type": "refscatter", "surfaces": False}), [1, 2, 5, 8, 0], []

    def watch(samples, image):
        seen.append(samples)
        return sizes[len(seen) - 1]

    expected = np.array(integrator.render(scene, sensor, spp=64))
    found = np.array(integrator.render(scene, sensor, spp=1 << 20, hooks=Hooks(watch=watch)))
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
    """Three strips: four tiles, two rows of four, one tile per method.

    All of them show light, but that of ``volpath``, which may find nothing so soon.
    """
    done = refscatter("gallery", "--resolution", 12, "--samples", 1, "--seconds", 0.1, "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    for name, rows, columns in (("scenes", 1, 4), ("densities", 2, 4), ("methods", 1, len(methods.METHODS))):
        image = np.array(mi.Bitmap(str(tmp_path / f"{name}.png")))
        assert image.shape == (16 * rows - 4, 16 * columns - 4, 3)
        tiles = [image[16 * i : 16 * i + 12, 16 * j : 16 * j + 12] for i in range(rows) for j in range(columns)]
        if name == "methods":
            tiles.pop(list(methods.METHODS).index("volpath"))
        assert min(tile.max() for tile in tiles) > 60, [tile.max() for tile in tiles]

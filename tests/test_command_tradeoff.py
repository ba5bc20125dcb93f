"""``refscatter tradeoff``, and that what the tolerance decides can all be switched off."""

import dataclasses
import json

import mitsuba as mi
import numpy as np
import pytest
from comparison import l1
from test_commands import SPHERE, needs_variant, refscatter

from mitsuba_refscatter import example_scenes, tolerances
from mitsuba_refscatter.benchmarks import tradeoff
from mitsuba_refscatter.integrators.hooks import Hooks

OTHERS = {
    "interval_samples", "point_samples", "panels", "panel_points", "lobes", "adapts",
    "bend", "linear", "newton", "guest_points", "samples_visibility", "coarse", "points",
}  # fmt: skip
"""Of triangles themselves and other estimators, and of light that is not refracted; the same for all tolerances."""


@needs_variant
def test_tradeoff_writes_results_and_a_picture(tmp_path):
    """Tolerances are kept to; the rows of results.json; a picture with something in it."""
    sizes = ("-D", "res=16", "--tolerance", 0.1, "--tolerance", 0.01, "--no-choices")
    done = refscatter("tradeoff", SPHERE, *sizes, "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "results.json").read_text())["rows"]
    assert [(row["scene"], row["tolerance"], row["switched"]) for row in rows] == [
        ("sphere", 0.1, False),
        ("sphere", 0.01, False),
    ]
    for row in rows:
        assert 0 < row["mean_relative_error"] < row["tolerance"] and row["wall_seconds"] > 0
    assert np.array(mi.Bitmap(str(tmp_path / "tradeoff.png"))).std() > 5
    assert sorted(p.name for p in tmp_path.iterdir()) == ["results.json", "tradeoff.png"]


def test_every_choice_is_switched():
    """The choices are all that the tolerance decides for the curve, each in one place.

    Each that is switched differs from the default.
    """
    names = [name for choice in tradeoff.CHOICES.values() for name in choice]
    assert sorted([*names, *OTHERS]) == sorted(field.name for field in dataclasses.fields(tolerances.Accuracy))
    every = tradeoff.settings(tradeoff.Setup("llvm_ad_rgb"))
    switched = [(name, changes) for name, tolerance, changes in every if changes]
    assert {name.removesuffix(" exact") for name, _ in switched if name.endswith("exact")} == set(tradeoff.CHOICES)
    default = tolerances.accuracy(tradeoff.DEFAULT)
    assert all(dataclasses.replace(default, **changes) != default for _, changes in switched)


@pytest.mark.slow
def test_with_all_choices_switched_off_the_image_is_the_exact_one(rgb, tmp_path):
    """As at tolerance 0; the tests against closed forms and the oracle hold that to the truth."""
    path, _ = example_scenes.write_scene("branches", tmp_path, 5120)
    scene = example_scenes.load(path, res="32")

    def image(tolerance, changes):
        integrator = mi.load_dict(
            {"type": "refscatter", "surfaces": False, "internal_bounces": 1, "tolerance": tolerance}
        )
        return np.array(integrator.render(scene, spp=1, hooks=Hooks(accuracy=changes)), dtype=np.float64)

    exact = tolerances.accuracy(0.0)
    off = {name: getattr(exact, name) for names in tradeoff.CHOICES.values() for name in names}
    truth, default, found = image(0.0, {}), image(0.1, {}), image(0.1, off)
    assert l1(default, truth) > 1e-3
    assert l1(found, truth) < 1e-5

"""An estimator of one's own takes its class and one line of the table, and nothing else."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import mesh_shape, point_light
from meshes import bumpy_sphere

from mitsuba_refscatter.estimators import ESTIMATORS
from mitsuba_refscatter.estimators.curve import Curve
from mitsuba_refscatter.estimators.point import Point
from mitsuba_refscatter.options import OptionError

pytestmark = pytest.mark.usefixtures("rgb")


class Twice(Curve):
    """A toy: all light that it finds counts twice."""

    def accumulate(self, sums, pairs, segments, culling, illumination, accuracy):
        once = dr.copy(sums.value)
        rest = super().accumulate(sums, pairs, segments, culling, illumination, accuracy)
        sums.value = 2 * sums.value - once
        sums.eval()
        return rest


class FewPoints(Point):
    """A toy: ``point`` under an option that sets another field than its own."""

    samples_field = None


@pytest.fixture
def scene(tmp_path):
    sensor = {
        "type": "perspective",
        "fov": 30,
        "to_world": mi.ScalarTransform4f().look_at([0, 1, 5], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 16, "height": 16, "pixel_format": "rgb", "component_format": "float32"},
    }
    body = mesh_shape(bumpy_sphere(2), tmp_path / "m.ply", eta=1.4)
    return mi.load_dict({"type": "scene", "sensor": sensor, "body": body, "light": point_light((-2.6, 2.4, -0.9))})


def image(scene, **properties):
    integrator = mi.load_dict({"type": "refscatter", "surfaces": False, **properties})
    return np.array(integrator.render(scene, spp=1, seed=1), dtype=np.float64)


@pytest.mark.parametrize("culling", ["beams", "spindle"])
def test_a_toy_estimator(scene, monkeypatch, culling):
    monkeypatch.setitem(ESTIMATORS, "twice", Twice())
    once, twice = (image(scene, culling=culling, estimator=name, tolerance=0.0) for name in ("curve", "twice"))
    assert once.mean() > 0
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-4, atol=1e-5 * once.max())


def test_what_an_estimator_can_do_decides(scene, monkeypatch):
    """Not its name: options that it does not take are refused."""
    monkeypatch.setitem(ESTIMATORS, "few", FewPoints())
    assert image(scene, estimator="few").mean() > 0
    with pytest.raises((OptionError, RuntimeError), match='"samples" has no meaning for the estimator few'):
        image(scene, estimator="few", samples=4)
    with pytest.raises((OptionError, RuntimeError), match="nown are curve, interval, point,.* few"):
        image(scene, estimator="fewer_points")

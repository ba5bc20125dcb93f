"""The three estimators with either culling: the same image, and no kernel made anew when the scene moves."""

import build
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from comparison import bias, l1
from meshes import box, bumpy_sphere, icosphere

from mitsuba_refscatter import tolerances
from mitsuba_refscatter.benchmarks import convergence
from mitsuba_refscatter.benchmarks.methods import METHODS
from mitsuba_refscatter.estimators import interval, point
from mitsuba_refscatter.light.illumination import Illumination
from mitsuba_refscatter.optics import LocalLight
from mitsuba_refscatter.transport.segments import LocalSegments

COMBINATIONS = [
    (estimator, culling) for estimator in ("curve", "interval", "point") for culling in ("beams", "spindle")
]
LIGHT, CAMERA = (-2.6, 2.4, -0.9), (0.0, 1.1, 5.2)


@pytest.mark.parametrize("most", [4096, pytest.param(16384, marks=pytest.mark.slow)])
@pytest.mark.parametrize("scene", build.slow_ones(convergence.SCENES, ["rounded_cube", "branches"]))
def test_estimators_converge_to_the_same_image(rgb, scene, most):
    """As their samples grow, interval and point come to within 1 % of the curve (relative L1 over the image).

    Radiance per length grows like |t - t_fold|^(-1/2) next to a fold, so that the variance of point is infinite: one
    sample of rounded_cube lies 2e-9 from a fold with seed 0, and brings 13 % of the image. Of three seeds the median
    counts there."""
    error, seeds = {}, range(3 if (scene, most) == ("rounded_cube", 4096) else 1)
    for seed in seeds:
        for row in convergence.run(scene, most, variant=rgb, resolution=10, seed=seed):
            error.setdefault((row["method"], row["samples"]), []).append(row["mean_relative_error"])
    error = {key: float(np.median(values)) for key, values in error.items()}
    print({key: f"{value:.1e}" for key, value in error.items()})
    assert error["interval", 64] < 2e-3
    assert error["point", most] < 0.01
    assert error["point", most] < error["point", 16] / (6 if most > 4096 else 4)


@pytest.fixture
def scene_at(tmp_path):
    """Makes scenes of a bumpy ball."""

    def make(eta=1.5, g=None):
        shape = build.mesh_shape(bumpy_sphere(3, 0.06, 6.0), tmp_path / "ball.ply", eta=eta, g=g)
        light = build.point_light(LIGHT)
        sensor = {
            "type": "perspective", "fov": 30, "sampler": {"type": "independent", "sample_count": 1},
            "to_world": mi.ScalarTransform4f().look_at(list(CAMERA), [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}, "pixel_format": "rgb",
                     "component_format": "float32"},
        }  # fmt: skip
        return mi.load_dict({"type": "scene", "sensor": sensor, "body": shape, "light": light})

    return make


def render(scene, **options):
    integrator = mi.load_dict({"type": "refscatter", "surfaces": False, "internal_bounces": 1, **options})
    return np.array(integrator.render(scene))


def errors(truth, image):
    """L1 and bias."""
    return l1(image, truth), bias(image, truth)


@pytest.mark.parametrize(("eta", "g"), [pytest.param(0.7, 0.6, marks=pytest.mark.slow), (1.0, None), (1.5, -0.5)])
def test_every_combination(rgb, scene_at, eta, g):
    """For all kinds of boundary within the tolerance (point: within its noise)."""
    scene = scene_at(eta=eta, g=g)
    truth = render(scene, tolerance=0.0)
    assert truth.mean() > 0
    for estimator, culling in COMBINATIONS:
        samples = {"samples": 128} if estimator == "point" else {}
        error, bias = errors(truth, render(scene, estimator=estimator, culling=culling, **samples))
        print(f"eta {eta}, {estimator} by {culling}: L1 {error:.1e}, bias {bias:+.1e}")
        assert error < (0.15 if estimator == "point" else 0.01)
        assert abs(bias) < (0.03 if estimator == "point" else 5e-3)


def test_every_variant(variant, scene_at):
    """The methods of 2015 and 2009 in each variant; with one seed all see the same wavelengths."""
    scene = scene_at()
    truth = render(scene, tolerance=0.0)
    for method in ("holzschuch2015", "walter2009"):
        error, bias = errors(truth, render(scene, **METHODS[method]))
        print(f"{variant}, {method}: L1 {error:.1e}, bias {bias:+.1e}")
        assert error < (0.3 if method == "walter2009" else 0.01)
        assert abs(bias) < (0.05 if method == "walter2009" else 5e-3)


LARGE = 300
"""Operations of a kernel that takes long to compile. Those for one lane, or for the parts of the one curve that
must be cut, are others, as are small ones now and then."""


@pytest.mark.parametrize(("estimator", "culling"), COMBINATIONS)
def test_no_kernel_is_made_anew(rgb, scene_at, estimator, culling):
    """Light and camera move, and with them the numbers of segments and pairs: after a few frames all large kernels are
    known."""
    scene = scene_at()
    parameters, known, large = mi.traverse(scene), set(), []
    for frame, x in enumerate((0.1, 0.25, 0.5, 0.4, 0.2, 0.3)):
        place = [float(p + x) for p in LIGHT]
        parameters["light.position"] = dr.opaque(mi.Point3f, place)
        parameters["sensor.to_world"] = mi.ScalarTransform4f().look_at([x, *CAMERA[1:]], [0, 0.1 * x, 0], [0, 1, 0])
        parameters.update()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            render(scene, estimator=estimator, culling=culling)
            kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT and k["size"] > tolerances.CUT]
        new = [k for k in kernels if k["hash"] not in known and k["operation_count"] > LARGE]
        large += [k["operation_count"] for k in kernels if k["operation_count"] > LARGE]
        known |= {k["hash"] for k in kernels}
        assert frame < 3 or not new, [(k["operation_count"], k["size"]) for k in new]
    assert len(large) > 10


# ---- Parts of the estimators ----------------------------------------------------------------


def test_interval_in_t(rgb):
    """The quadratic t(x): ends, clipping to the segment, slopes in the given ratio, and dt as its derivative."""
    rng, n = np.random.default_rng(3), 1000
    t0, t1, s0, s1 = rng.uniform(-0.5, 1.5, (4, n))
    s0, s1 = np.abs(s0) * np.sign(t1 - t0), np.abs(s1) * np.sign(t1 - t0)
    s0[::4], s1[1::4] = 0, 0  # folds
    ends = [interval._End(mi.Vector2f(0), mi.Float(t), mi.Float(s), mi.Float(t)) for t, s in ((t0, s0), (t1, s1))]
    span = interval._range(*ends, mi.Float(np.ones(n)))
    low, high = np.clip(np.minimum(t0, t1), 0, 1), np.clip(np.maximum(t0, t1), 0, 1)
    first, last = np.array(span.first), np.array(span.last)
    inside = high > low + 1e-3
    reached = np.sort([np.array(span.t(mi.Float(x))) for x in (first, last)], axis=0)
    np.testing.assert_allclose(reached[:, inside], np.array([low, high])[:, inside], atol=2e-6)
    assert (np.array(span.last - span.first)[(high == low)] < 1e-6).all()
    x, h = rng.uniform(0.1, 0.9, n), 1e-2
    slope = (np.array(span.t(mi.Float(x + h))) - np.array(span.t(mi.Float(x - h)))) / (2 * h)
    np.testing.assert_allclose(np.array(span.dt(mi.Float(x))), np.abs(slope), rtol=1e-3, atol=1e-4)
    at_0, at_1 = (np.array(span.dt(mi.Float(np.full(n, x)))) for x in (0.0, 1.0))
    np.testing.assert_allclose(at_0 * np.abs(s1), at_1 * np.abs(s0), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("n", [64, 1024])
def test_sample_points_of_segments(rgb, n):
    """Weighted sums over the sample points are integrals along the segments, attenuation included."""
    rng, count = np.random.default_rng(4), 200
    t_max, sigma_t = rng.uniform(0.1, 3, count), rng.uniform(0, 2, (3, count))
    o, L = rng.normal(size=(3, count)), rng.normal(size=(3, count)) * 3
    d = rng.normal(size=(3, count))
    d /= np.linalg.norm(d, axis=0)
    segments = LocalSegments(mi.Point3f(o), mi.Vector3f(d), mi.Float(t_max), mi.Spectrum(sigma_t))
    illumination = Illumination(LocalLight(mi.Point3f(L)), mi.Float(1.5), 1, None, None, None)
    total = np.zeros((3, count))
    for first in (0, n // 2):
        index, points, weight = point.sample_points(segments, illumination, first, n // 2, n, seed=7)
        index, along = (
            np.array(index),
            np.einsum("in,in->n", np.array(points.o) - o[:, np.array(index)], d[:, np.array(index)]),
        )
        assert (along >= -1e-6).all() and (along <= t_max[index] + 1e-6).all()
        np.add.at(total.T, index, (np.array(weight) * along).T)
    with np.errstate(all="ignore"):
        exact = np.where(
            sigma_t * t_max > 1e-3, (1 - np.exp(-sigma_t * t_max) * (1 + sigma_t * t_max)) / sigma_t**2, t_max**2 / 2
        )
    # Strata make the error fall faster than 1/sqrt(n).
    assert np.abs(total / exact - 1).max() < (0.05 if n == 64 else 0.003)


# ---- Extremes -------------------------------------------------------------------------------


def extreme(tmp_path, mesh, light, eta=1.5, density=1.0, intensity=10.0):
    """A small image of a body at 0 as a scene."""
    shape = build.mesh_shape(mesh, tmp_path / "body.ply", eta=eta)
    shape["interior"]["scale"] = float(density)
    sensor = {
        "type": "perspective",
        "fov": 35,
        "to_world": mi.ScalarTransform4f().look_at([0.7, 0.9, 4], [0, 0, 0], [0, 1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": 12,
            "height": 12,
            "rfilter": {"type": "box"},
            "component_format": "float32",
        },
        "sampler": {"type": "independent", "sample_count": 1},
    }
    light = build.point_light(light, (intensity,) * 3)
    return mi.load_dict({"type": "scene", "sensor": sensor, "body": shape, "light": light})


@pytest.mark.parametrize("distance", build.slow_ones([1e2, 1e4, 1e6], [1e2]))
def test_distant_lights(rgb, tmp_path, distance):
    """Nothing is lost to float32 where all of the segment is seen under a tiny angle."""
    light = distance * np.array([-0.02, -0.05, -1])
    scene = extreme(tmp_path, bumpy_sphere(3), light, intensity=10 * distance**2)
    truth = render(scene, tolerance=0.0)
    assert errors(truth, render(scene, estimator="point", samples=4096))[0] < 0.02
    assert errors(truth, render(scene, estimator="interval", culling="spindle"))[0] < 0.01


@pytest.mark.parametrize("density", [3, 20, 100])
def test_dense_media(rgb, tmp_path, density):
    """Large triangles across which nearly all light is absorbed: intervals get as many samples as that takes."""
    scene = extreme(tmp_path, icosphere(2), (-3, 3, 1), density=density)
    truth = render(scene, tolerance=0.0)
    for culling in ("beams", "spindle"):
        error, bias = errors(truth, render(scene, estimator="interval", culling=culling))
        assert error < 0.01 and abs(bias) < 5e-3, (culling, error, bias)


@pytest.mark.parametrize(("light", "eta"), [((-1.02, 0.3, 0.1), 1.5), ((-1.5, 0.6, 0.4), 0.4), ((-3, 3, 1), 1.5)])
def test_coarse_box(rgb, tmp_path, light, eta):
    """Twelve triangles and a light near to one of them: spindles cut them as finely as beams."""
    scene = extreme(tmp_path, box((-1, -1, -1), (1, 1, 1)), light, eta=eta)
    truth = render(scene, tolerance=0.0)
    for estimator in ("curve", "interval"):
        for culling in ("beams", "spindle"):
            exact, rough = (render(scene, estimator=estimator, culling=culling, tolerance=t) for t in (0.0, 0.01))
            assert errors(truth, exact)[0] < 1e-3, (estimator, culling)
            assert errors(truth, rough)[0] < 0.015, (estimator, culling)

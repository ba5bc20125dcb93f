"""The three estimators with either culling: the same image, and no kernel made anew when the scene moves."""

import build
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from meshes import bumpy_sphere

from mitsuba_refscatter.compare import convergence
from mitsuba_refscatter.compare.methods import METHODS

COMBINATIONS = [
    (estimator, culling) for estimator in ("curve", "interval", "point") for culling in ("beams", "spindle")
]
LIGHT, CAMERA = (-2.6, 2.4, -0.9), (0.0, 1.1, 5.2)


@pytest.mark.parametrize("scene", convergence.SCENES)
def test_estimators_converge_to_the_same_image(rgb, scene):
    """As their samples grow, interval and point come to within 1 % of the curve (relative L1 over the image)."""
    rows = convergence.run(scene, 4096, variant=rgb, resolution=16, culling="spindle")
    error = {(row["method"], row["samples"]): row["mean_relative_error"] for row in rows}
    print({key: f"{value:.1e}" for key, value in error.items()})
    for method, counts in convergence.SAMPLES.items():
        assert error[method, counts[-1]] < 0.01
    assert error["interval", 64] < 2e-3
    assert error["point", 4096] < error["point", 16] / 4


@pytest.fixture
def scene_at(tmp_path):
    """Makes scenes of a bumpy ball: refined ``level`` times, light and camera moved by ``shift``, eta."""

    def make(level=2, shift=0.0, eta=1.5, **more):
        name = f"{level}-{eta}-{len(more)}"
        shape = build.mesh_shape(bumpy_sphere(level, 0.06, 6.0), tmp_path / f"{name}.ply", eta=eta, **more)
        light = build.point_light(np.array(LIGHT) + shift)
        sensor = {
            "type": "perspective", "fov": 30, "sampler": {"type": "independent", "sample_count": 1},
            "to_world": mi.ScalarTransform4f().look_at([CAMERA[0] + shift, *CAMERA[1:]], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}, "pixel_format": "rgb",
                     "component_format": "float32"},
        }  # fmt: skip
        return mi.load_dict({"type": "scene", "sensor": sensor, "body": shape, "light": light})

    return make


def render(scene, **options):
    integrator = mi.load_dict({"type": "refscatter", "surfaces": False, "internal_bounces": 1, **options})
    return np.array(integrator.render(scene))


def errors(truth, image):
    """Relative L1 difference and bias."""
    return np.abs(image - truth).sum() / truth.sum(), image.sum() / truth.sum() - 1


@pytest.mark.parametrize(("eta", "g"), [(0.7, 0.6), (1.0, None), (1.5, -0.5)])
def test_every_combination(rgb, scene_at, eta, g):
    """For all kinds of boundary within the tolerance (point: within its noise)."""
    scene = scene_at(level=3, eta=eta, g=g)
    truth = render(scene, tolerance=0.0)
    assert truth.mean() > 0
    for estimator, culling in COMBINATIONS:
        error, bias = errors(truth, render(scene, estimator=estimator, culling=culling))
        print(f"eta {eta}, {estimator} by {culling}: {error:.1e}, bias {bias:+.1e}")
        assert error < (0.2 if estimator == "point" else 0.01)
        assert abs(bias) < (0.02 if estimator == "point" else 5e-3)


def test_every_variant(variant, scene_at):
    """The methods of 2015 and 2009 in each variant; with one seed all see the same wavelengths."""
    scene = scene_at(level=3)
    truth = render(scene, tolerance=0.0)
    for method in ("holzschuch2015", "walter2009"):
        error, bias = errors(truth, render(scene, **METHODS[method]))
        print(f"{variant}, {method}: {error:.1e}, bias {bias:+.1e}")
        assert error < (0.3 if method == "walter2009" else 0.01)
        assert abs(bias) < (0.05 if method == "walter2009" else 5e-3)


LARGE = 300
"""Operations of a kernel that takes long to compile. Those for one lane are others, as are small ones now and then."""


@pytest.mark.parametrize(("estimator", "culling"), COMBINATIONS)
def test_no_kernel_is_made_anew(rgb, scene_at, estimator, culling):
    """Light and camera move, and with them the numbers of segments and pairs: after a few frames all large kernels are
    known."""
    scene = scene_at(level=3)
    parameters, known, large = mi.traverse(scene), set(), []
    for frame, x in enumerate((0.1, 0.25, 0.5, 0.4, 0.2, 0.3)):
        place = [float(p + x) for p in LIGHT]
        parameters["light.position"] = dr.opaque(mi.Point3f, place)
        parameters["sensor.to_world"] = mi.ScalarTransform4f().look_at([x, *CAMERA[1:]], [0, 0.1 * x, 0], [0, 1, 0])
        parameters.update()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            render(scene, estimator=estimator, culling=culling)
            kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT and k["size"] > 1]
        new = [k for k in kernels if k["hash"] not in known and k["operation_count"] > LARGE]
        large += [k["operation_count"] for k in kernels if k["operation_count"] > LARGE]
        known |= {k["hash"] for k in kernels}
        assert frame < 3 or not new, [(k["operation_count"], k["size"]) for k in new]
    assert len(large) > 10

"""Light in a straight line: ours at eta = 1, and otherwise what the formula for it says."""

import build
import mitsuba as mi
import numpy as np
import pytest
from comparison import bias, l1
from meshes import bumpy_sphere, icosphere
from test_scene_kinds_against_volpath import PLACES, sun

pytestmark = pytest.mark.usefixtures("rgb")

LAMP = (-2.6, 2.4, -0.9)


@pytest.mark.parametrize("light", ["point", "sun"])
@pytest.mark.parametrize("shape", ["convex", "concave"])
def test_equals_ours_at_eta_one(tmp_path, shape, light):
    """A boundary with the index 1 refracts by curves in ``refscatter`` (every zero of g is solved for), and lets
    light through along the segment here. Where a concave body shadows itself the one finds the shadow's edge per
    light beam, the other by bisection: rays along such edges may differ, their sum hardly."""
    mesh = icosphere(3) if shape == "convex" else bumpy_sphere(4, 0.12, 6.0)
    lights = {"light": build.point_light(LAMP)} if light == "point" else {"sun": sun()}
    loaded = mi.load_dict({"type": "scene", **lights, "body": build.mesh_shape(mesh, tmp_path / "body.ply", eta=1.0)})
    o, d = build.rays_at((0.2, 1.1, 5.2), 0.9, 400, seed=3)
    names = "refscatter", "refscatter_straight"
    ours, straight = (build.single_scattering(loaded, o, d, type=name, tolerance=1e-4) for name in names)
    assert ours.mean() > 0
    error = np.abs(ours - straight).max(axis=1) / np.maximum(ours.max(axis=1), 1e-3 * ours.max())
    print(f"median {np.median(error):.1e}, 99 % {np.percentile(error, 99):.1e}, bias {bias(straight, ours):+.1e}")
    assert np.median(error) < 1e-4 and np.percentile(error, 99) < (1e-3 if shape == "convex" else 2e-2)
    assert abs(bias(straight, ours)) < 1e-4


def test_equals_the_formula_behind_refraction(tmp_path):
    """The camera ray is refracted, light is not: a slab seen from above, against a float64 sum over the line of
    sight."""
    slab = {
        "type": "cube",
        "bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
        "to_world": mi.ScalarTransform4f().scale([40, 1, 40]),
        "interior": {"type": "homogeneous", "sigma_t": 0.6, "albedo": 0.5},
    }
    lamp = np.array([0.4, 3.0, -0.2])
    loaded = mi.load_dict({"type": "scene", "light": build.point_light(lamp, (7.0, 7.0, 7.0)), "slab": slab})
    o = np.tile([0.0, 5.0, 0.0], (50, 1))
    d = np.random.default_rng(1).normal(size=(50, 3)) * [0.4, 0, 0.4] - [0, 1, 0]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    found = build.single_scattering(loaded, o, d, type="refscatter_straight", internal_bounces=0, tolerance=1e-4)[:, 0]
    t, weight = np.polynomial.legendre.leggauss(200)
    for k in range(50):
        entry = o[k] + d[k] * 4 / -d[k, 1]
        cos_i = -d[k, 1]
        cos_t = np.sqrt(1 - (1 - cos_i**2) / 1.5**2)
        inner = np.array([d[k, 0], 0, d[k, 2]]) / 1.5 - [0, cos_t, 0]
        F = 0.5 * (
            ((cos_i - 1.5 * cos_t) / (cos_i + 1.5 * cos_t)) ** 2 + ((1.5 * cos_i - cos_t) / (1.5 * cos_i + cos_t)) ** 2
        )
        length = 2 / cos_t
        along = 0.5 * length * (t + 1)
        V = entry + along[:, None] * inner
        way = np.linalg.norm(lamp - V, axis=1)
        inside = way * (1 - V[:, 1]) / (lamp[1] - V[:, 1])
        value = 0.3 * 7.0 / (4 * np.pi) * np.exp(-0.6 * (along + inside)) / way**2
        expected = (1 - F) / 1.5**2 * (value * weight).sum() * 0.5 * length
        assert found[k] == pytest.approx(expected, rel=1e-3)


def test_a_light_inside_is_as_ours():
    """Light that is not refracted anyway."""
    images = [
        np.array(
            mi.render(
                PLACES["light inside"].scene({"type": name, "surfaces": False, "internal_bounces": 0}), seed=1, spp=16
            )
        )
        for name in ("refscatter", "refscatter_straight")
    ]
    assert l1(images[1], images[0]) < 1e-5

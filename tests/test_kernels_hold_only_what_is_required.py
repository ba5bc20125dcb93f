"""The kernels of a render hold only what its scene requires: seen in the kernels themselves, in Dr.Jit's history of
them."""

import re

import drjit as dr
import mitsuba as mi
import pytest
from build import mesh_shape, point_light
from meshes import bumpy_sphere, icosphere
from test_scene_kinds_against_volpath import LAMP, ball_light, empty, glass, medium, panel, sky, spot, sun, to

from mitsuba_refscatter import platform
from mitsuba_refscatter.core.cache import Cache
from mitsuba_refscatter.integrators.hooks import Hooks

pytestmark = [
    pytest.mark.usefixtures("rgb"),
    pytest.mark.skipif(platform.default_variant() != "llvm_ad_rgb", reason="reads LLVM's form of kernels"),
]

RAY = r"call void %rd\d+\(ptr %u\d+_in_0_1"
NEAREST_HIT = r"%u\d+_in_geomid_1 ="
"""What rays of a kernel have, but for shadow rays."""
CALL = r"define fastcc [^\n]*@func_"
"""A function of an object of the scene that is chosen when the kernel runs."""


class Kernels:
    """Those of a render: their hashes, and how often something stands in their code."""

    def __init__(self, scene, silent=True):
        integrator = scene.integrator()

        def render():
            integrator.render(scene, spp=1, hooks=Hooks(silent=silent))

        render()  # what is made once per process
        integrator.cache = Cache()  # and what renders keep
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            render()
            found = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
        self.hashes = {kernel["hash"] for kernel in found}
        self.code = [kernel["ir"].getvalue() for kernel in found]

    def count(self, pattern):
        return sum(len(re.findall(pattern, code)) for code in self.code)

    @property
    def shadow_rays(self):
        return self.count(RAY) - self.count(NEAREST_HIT)

    @property
    def most_shadow_rays(self):
        """Of one kernel."""
        return max(len(re.findall(RAY, code)) - len(re.findall(NEAREST_HIT, code)) for code in self.code)


def view():
    return {
        "type": "perspective",
        "fov": 34,
        "to_world": mi.ScalarTransform4f().look_at([0.3, 0.5, 5], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}},
    }


def scene(path, mesh, **parts):
    integrator = {"type": "refscatter", "surfaces": False, "internal_bounces": 0, "light_samples": 2}
    body = mesh_shape(mesh, path, g=parts.pop("g", None))
    return mi.load_dict(
        {"type": "scene", "integrator": integrator, "sensor": view(), "lamp": point_light(LAMP), "body": body, **parts},
        optimize=False,
    )


def rich(path):
    """Lights of all kinds, media of all kinds, boundaries of all kinds, mirrors and blocks."""
    mirror = {"type": "rectangle", "to_world": to(("translate", [0, -2, 0]), ("rotate", [1, 0, 0], -90), ("scale", 3)),
              "bsdf": {"type": "conductor"}}  # fmt: skip
    block = {"type": "sphere", "radius": 0.2, "bsdf": {"type": "diffuse"}}
    return scene(
        path,
        bumpy_sphere(2, 0.2, 6.0),
        g=0.6,
        sky=sky(),
        spot=spot(),
        sun=sun(),
        panel=panel("disk"),
        ball=ball_light(),
        mirror=mirror,
        block=block,
        thin=empty({"type": "thindielectric"}, ("translate", [0, 2.6, 0])),
        fog={
            "type": "cube",
            "to_world": to(("translate", [2.5, 0, 0]), ("scale", 0.4)),
            "bsdf": {"type": "null"},
            "interior": {**medium(phase={"type": "rayleigh"}), "id": "other"},
        },
        bubble=empty(glass(1.2), ("translate", [-2.4, 0, 0]), ("scale", 0.4)),
    )


def test_a_simple_scene_pays_nothing_for_a_rich_one(tmp_path):
    """Its kernels are the same before and after the rich one is rendered, and hold no choice between objects, no shadow
    ray, and fewer rays: those of the camera alone. With the estimate of missing light they are the same, too."""
    simple = scene(tmp_path / "simple.ply", icosphere(2))
    with_estimate = Kernels(simple, silent=False)
    before = Kernels(simple)
    all_of_it = Kernels(rich(tmp_path / "rich.ply"))
    after = Kernels(simple)
    assert before.hashes == after.hashes
    assert Kernels(simple, silent=False).hashes == with_estimate.hashes and with_estimate.count(CALL) == 0
    assert all_of_it.count(CALL) > 0 and all_of_it.count(NEAREST_HIT) > before.count(NEAREST_HIT)
    assert before.count(CALL) == 0 and before.shadow_rays == 0
    assert before.count(NEAREST_HIT) == 2  # to the body, and in it
    assert not all_of_it.hashes <= before.hashes


def test_a_convex_body_traces_no_inner_shadow_rays(tmp_path):
    """With something opaque outside, its light is tested on the way to it only; a body that is not convex tests
    inside, too."""
    block = {
        "type": "cube",
        "to_world": to(("translate", [0.9, 1.6, 0.8]), ("scale", 0.2)),
        "bsdf": {"type": "diffuse"},
    }
    convex, other = (
        Kernels(scene(tmp_path / f"{k}.ply", mesh, block=block))
        for k, mesh in enumerate((icosphere(2), bumpy_sphere(2, 0.2, 6.0)))
    )
    # Light beams end where a ray that starts with them meets the body.
    assert convex.most_shadow_rays == other.most_shadow_rays == 1
    assert convex.count(NEAREST_HIT) == 2 < other.count(NEAREST_HIT)
    # Without the block light comes to it unhindered: then it traces none at all.
    assert Kernels(scene(tmp_path / "alone.ply", icosphere(2))).shadow_rays == 0

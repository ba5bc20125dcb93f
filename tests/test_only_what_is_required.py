"""The kernels of a render hold only what its scene requires: seen in the kernels themselves, by Dr.Jit's history of them."""

import re

import build
import drjit as dr
import mitsuba as mi
import pytest
from against_volpath import glass, to
from meshes import Mesh, bumpy_sphere, icosphere
from test_real_scenes import ball_light, sky, spot, sun

from mitsuba_refscatter import platform

pytestmark = [
    pytest.mark.usefixtures("rgb"),
    pytest.mark.skipif(platform.default_variant() != "llvm_ad_rgb", reason="reads LLVM's form of kernels"),
]


class Kernels:
    """Those of a render: hashes, and the numbers of some things in their code."""

    def __init__(self, scene):
        scene.integrator().render(scene, spp=1)  # what is made once per process
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            scene.integrator().render(scene, spp=1)
            found = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
        self.hashes = {k["hash"] for k in found}
        self.code = [k["ir"].getvalue() for k in found]

    def count(self, pattern):
        return sum(len(re.findall(pattern, code)) for code in self.code)

    @property
    def rays(self):
        """Rays that look for the nearest hit."""
        return self.count(r"getelementptr[^\n]*\n[^\n]*\n[^\n]*call void %rd\d+\(ptr %u\d+_in_0_1") - self.shadow_rays

    @property
    def shadow_rays(self):
        return sum(len(re.findall(r"call void %rd\d+\(ptr %u\d+_in_0_1", code)) - len(re.findall(r"%u\d+_in_geomid_1 =", code))
                   for code in self.code)  # fmt: skip

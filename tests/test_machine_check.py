"""The check of the machine: what is refused, and that looking changes nothing."""

import glob
import os
import subprocess
import sys

import pytest
from test_commands import HANGS

from mitsuba_refscatter import platform


def python(code, **environment):
    """Run code in a fresh interpreter, with some environment variables set."""
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=HANGS, env={**os.environ, **environment}
    )


def test_looking_sets_no_variant():
    code = (
        "from mitsuba_refscatter import platform; platform.report(); platform.default_variant(); "
        "import mitsuba as mi; assert mi.variant() is None"
    )
    done = python(code)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("variant", ["scalar_rgb", "scalar_spectral"])
def test_scalar_is_refused(variant):
    assert not platform.is_supported(variant)
    with pytest.raises(platform.PlatformError, match="needs a JIT variant"):
        platform.require_usable(variant)


def test_polarised_is_refused():
    with pytest.raises(platform.PlatformError, match="polarisation"):
        platform.require_usable("llvm_ad_spectral_polarized")


def test_unknown_variant_names_the_known_ones():
    with pytest.raises(platform.PlatformError, match="llvm_ad_rgb"):
        platform.require_usable("llvm_ad_nonsense")


@pytest.mark.parametrize("usable, default", [
    (["cuda_ad_rgb", "llvm_ad_rgb"], "llvm_ad_rgb"), (["cuda_ad_rgb", "llvm_ad_mono"], "cuda_ad_rgb"),
    (["llvm_ad_mono"], None),
], ids=["both", "no LLVM", "none"])  # fmt: skip
def test_llvm_is_the_default_where_it_is_usable(usable, default, monkeypatch):
    """The GPU is taken where it is not, and of two reasons why nothing is usable LLVM's is told."""
    monkeypatch.setattr(platform, "problem_of", lambda name: None if name in usable else f"{name} is broken")
    report = platform.report()
    assert report.default == default
    if default is not None:
        assert platform.default_variant() == default and report.problem is None
    else:
        with pytest.raises(platform.PlatformError, match="llvm_ad_rgb is broken"):
            platform.default_variant()
        assert report.problem == "llvm_ad_rgb is broken"


@pytest.mark.parametrize(
    "version, works, word",
    [
        ((15, 0, 6), True, "15.0.6"),
        ((16, 0, 0), True, "16.0.0"),
        ((-1, -1, -1), False, "no LLVM"),
        ((19, 1, 7), False, "processor"),
    ],
)
def test_unsuitable_llvm_is_explained(version, works, word):
    problem = platform._llvm_problem(version, works)
    assert problem is not None and word in problem
    assert any(advice in problem for advice in ("libllvm19", "DRJIT_LIBLLVM_PATH", "cuda_ad"))


@pytest.mark.parametrize("major", [17, 18, 19, 20, 21])
def test_newer_llvm_is_accepted(major):
    assert platform._llvm_problem((major, 1, 0), True) is None


@pytest.mark.parametrize("path, major", [
    ("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1", 15), ("/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1", 19),
    ("/usr/lib/x86_64-linux-gnu/libLLVM-14.0.6.so.1", 14), ("/usr/lib/llvm-18/lib/libLLVM.so", 18),
    ("/usr/lib/x86_64-linux-gnu/libLLVM.so", -1),
])  # fmt: skip
def test_version_is_read_from_a_library_name(path, major):
    assert platform._version_in_name(path) == major


def test_a_missing_library_is_refused_before_the_first_kernel():
    code = (
        "import mitsuba_refscatter; from mitsuba_refscatter import platform\n"
        "try: platform.require_usable('llvm_ad_rgb')\n"
        "except platform.PlatformError as error: print('refused:', error)"
    )
    done = python(code, DRJIT_LIBLLVM_PATH="/nonexistent/libLLVM.so")
    assert done.returncode == 0 and "refused: the variant llvm_ad_rgb" in done.stdout, done.stderr


def test_an_aborting_library_is_refused_before_the_first_kernel():
    libraries = glob.glob("/usr/lib/*-linux-gnu/libLLVM-1[56].so*")
    if not libraries:
        pytest.skip("neither LLVM 15 nor 16 is installed")
    code = (
        "import mitsuba_refscatter, mitsuba as mi\n"
        "mi.set_variant('llvm_ad_rgb')\n"
        "try: mi.render(mi.load_dict(dict(mi.cornell_box(), integrator={'type': 'refscatter'})))\n"
        "except Exception as error: print('refused:', error)"
    )
    done = python(code, DRJIT_LIBLLVM_PATH=libraries[0])
    assert done.returncode == 0 and "ends the process at the first kernel" in done.stdout, done.stderr

"""Fixtures shared by the tests: which Mitsuba variants run here."""

import mitsuba as mi
import pytest
import references

import mitsuba_refscatter  # noqa: F401 - registers the plugins
from mitsuba_refscatter import platform

VARIANTS = ("llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_spectral", "cuda_ad_rgb")


def pytest_addoption(parser):
    parser.addoption("--make-references", action="store_true", help="compute references where they are not kept")
    parser.addoption("--references-anew", action="store_true", help="compare references with what is kept")


def pytest_configure(config):
    references.MAKE, references.ANEW = config.getoption("--make-references"), config.getoption("--references-anew")


def _use(variant):
    problem = platform.problem_of(variant)
    if problem is not None:
        pytest.skip(f"{variant}: {problem}")
    mi.set_variant(variant)
    return variant


@pytest.fixture(params=VARIANTS)
def variant(request):
    """Each variant that this machine can run, set."""
    return _use(request.param)


@pytest.fixture
def rgb():
    """The variant that renders use by default, set: for tests that one variant is enough for."""
    return _use(platform.default_variant())

"""What is installed and what of it can render: Mitsuba, Dr.Jit, LLVM, GPU, variants.

Importing this module loads nothing and sets no variant. Dr.Jit looks for LLVM when
it is imported, so ``DRJIT_LIBLLVM_PATH`` must be set before that. Asking it for the
version afterwards is harmless; compiling a first kernel with LLVM 15 or 16 is not: it
ends the process ("Cannot select ... fmaximum"), which no ``try`` can catch. Hence
``require_usable``, called before every render.
"""

from __future__ import annotations

import glob
import re
from dataclasses import dataclass
from functools import cache

from .core.spelling import advice

MITSUBA_RANGE = ((3, 9, 1), (3, 10, 0))  # from, below: 3.10 renames the mesh interface
LLVM_MINIMUM = 17  # 14 is refused by Dr.Jit; 15 and 16 end the process on x86
PREFERRED = ("llvm_ad_rgb", "cuda_ad_rgb")
GPU_REMARK = "refscatter has not been run on a GPU yet"
"""Why the GPU is the second choice."""

_LLVM_ADVICE = (
    "install LLVM 17 or newer (Debian and Ubuntu: apt install libllvm19), "
    "or set DRJIT_LIBLLVM_PATH to a libLLVM.so before Python starts"
)
_LIBRARIES = ("/usr/lib/*-linux-gnu/libLLVM*.so*", "/usr/lib/llvm-*/lib/libLLVM*.so*", "/usr/lib64/libLLVM*.so*")


class PlatformError(RuntimeError):
    """What cannot be used on this machine, why, and what to do about it."""


@dataclass(frozen=True)
class Llvm:
    """The LLVM library that Dr.Jit found: version ``(-1, -1, -1)`` and no path if none."""

    version: tuple[int, int, int]
    path: str | None
    problem: str | None

    @property
    def text(self) -> str:
        """Return the version as text, or ``none``."""
        return "none" if self.version[0] < 0 else ".".join(str(v) for v in self.version)


@dataclass(frozen=True)
class Report:
    """Everything that ``refscatter check`` prints; ``variants`` maps a name to its problem or None."""

    mitsuba: str
    drjit: str
    llvm: Llvm
    gpu_problem: str | None
    variants: dict[str, str | None]
    default: str | None
    problem: str | None


def is_supported(variant: str) -> bool:
    """Whether refscatter is written for this kind of variant, whatever the machine.

    >>> [is_supported(name) for name in ("llvm_ad_rgb", "cuda_ad_spectral", "scalar_rgb", "llvm_ad_rgb_polarized")]
    [True, True, False, False]
    """
    return _refusal(variant) is None


def _refusal(variant: str) -> str | None:
    if variant.startswith("scalar"):
        return "refscatter needs a JIT variant: choose llvm_ad_rgb or cuda_ad_rgb"
    if "polarized" in variant:
        return "refscatter does not follow polarisation: choose a variant without it"
    return None


def _loaded_library() -> str | None:
    """Path of the LLVM library in this process, where the system tells (Linux)."""
    try:
        with open("/proc/self/maps", encoding="utf-8", errors="replace") as maps:
            paths = (line.split(maxsplit=5)[-1].strip() for line in maps if "libLLVM" in line)
            return next(paths, None)
    except OSError:
        return None


def _version_in_name(path: str) -> int:
    match = re.search(r"libLLVM(?:-|\.so\.|-\d+\.so\.)(\d+)", path) or re.search(r"llvm-(\d+)/", path)
    return int(match.group(1)) if match else -1


def _usable_library_on_disk() -> str | None:
    """Path of an installed LLVM that would do, newest first."""
    paths = sorted((p for pattern in _LIBRARIES for p in glob.glob(pattern)), key=_version_in_name)
    return paths[-1] if paths and _version_in_name(paths[-1]) >= LLVM_MINIMUM else None


def _llvm_problem(version: tuple[int, int, int], works: bool) -> str | None:
    if version[0] >= LLVM_MINIMUM and works:
        return None
    advice = _LLVM_ADVICE
    other = _usable_library_on_disk()
    if version[0] < LLVM_MINIMUM and other is not None:
        advice = f"set DRJIT_LIBLLVM_PATH={other} before Python starts"
    if version[0] < 0:
        return f"Dr.Jit found no LLVM that it can load: {advice}"
    text = ".".join(str(v) for v in version)
    if version[0] < LLVM_MINIMUM:
        return f"Dr.Jit found LLVM {text}, which ends the process at the first kernel: {advice}"
    return f"LLVM {text} is installed, but Dr.Jit cannot use it on this processor: choose a cuda_ad variant"


@cache
def llvm() -> Llvm:
    """Look at the LLVM library that Dr.Jit has found."""
    import drjit as dr

    version = tuple(int(v) for v in dr.detail.llvm_version())
    problem = _llvm_problem(version, dr.has_backend(dr.JitBackend.LLVM))
    return Llvm(version, _loaded_library() if version[0] >= 0 else None, problem)


@cache
def gpu_problem() -> str | None:
    """Return why no GPU can be used, or None where one can."""
    import drjit as dr

    if dr.has_backend(dr.JitBackend.CUDA):
        return None
    return "Dr.Jit found no NVIDIA GPU with a driver of version 535 or newer: choose an llvm_ad variant"


@cache
def mitsuba_problem() -> str | None:
    """Return what is wrong with the installed Mitsuba, or None."""
    low, high = (".".join(str(v) for v in bound) for bound in MITSUBA_RANGE)
    install = f"pip install 'mitsuba>={low},<{high.rsplit('.', 1)[0]}'"
    try:
        import mitsuba as mi
    except ImportError as error:
        return f"Mitsuba cannot be imported ({error}): {install}"
    version = tuple(int(v) for v in re.findall(r"\d+", mi.__version__)[:3])
    if MITSUBA_RANGE[0] <= version < MITSUBA_RANGE[1]:
        return None
    written = f"refscatter was written for Mitsuba {low} up to, not including, {high}"
    return f"{written} and {mi.__version__} is installed: {install}"


@cache
def problem_of(variant: str) -> str | None:
    """Return why ``variant`` cannot be used here, in one sentence with a way out, or None."""
    problem = mitsuba_problem() or _refusal(variant)
    if problem is not None:
        return problem
    import mitsuba as mi

    if variant not in mi.variants():
        return f"the installed Mitsuba does not have it: {advice(variant, filter(is_supported, mi.variants()))}"
    if variant.startswith("llvm"):
        return llvm().problem
    if variant.startswith("cuda"):
        return gpu_problem()
    return "refscatter knows variants that begin with llvm or cuda: choose llvm_ad_rgb"


def require_usable(variant: str) -> None:
    """Raise ``PlatformError`` unless kernels of ``variant`` can be compiled here; cheap after the first call."""
    problem = problem_of(variant)
    if problem is not None:
        raise PlatformError(f"the variant {variant} cannot be used: {problem}")


def default_variant() -> str:
    """Return the first usable of ``PREFERRED``; raise ``PlatformError`` if there is none."""
    for variant in PREFERRED:
        if problem_of(variant) is None:
            return variant
    raise PlatformError(str(problem_of(PREFERRED[0])))


def report() -> Report:
    """Collect everything that ``refscatter check`` prints."""
    from importlib.metadata import PackageNotFoundError, version

    def installed(name: str) -> str:
        try:
            return version(name)
        except PackageNotFoundError:
            return "not installed"

    problem = mitsuba_problem()
    if problem is not None:
        nothing = Llvm((-1, -1, -1), None, problem)
        return Report(installed("mitsuba"), installed("drjit"), nothing, problem, {}, None, problem)
    import mitsuba as mi

    variants = {name: problem_of(name) for name in mi.variants()}
    default = next((name for name in PREFERRED if variants.get(name, "absent") is None), None)
    problem = None if default else variants.get(PREFERRED[0])
    return Report(mi.__version__, installed("drjit"), llvm(), gpu_problem(), variants, default, problem)

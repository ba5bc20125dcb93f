"""Pictures on disk: an EXR with every channel and a tone-mapped PNG, each written beside and renamed."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Optional

import mitsuba as mi
import numpy as np

import mitsuba_refscatter

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Of linear sRGB."""
PNG_PERCENTILE = 97.0  # of the luminance of lit pixels; caustics and highlights lie above
PNG_LEVEL = 0.8  # linear value that this percentile is shown at


class OutputError(RuntimeError):
    """A picture that cannot be written, and why."""


def target(path) -> Path:
    """Return the EXR path meant by ``path``, once it is certain that a file can be made there.

    A name without an ending gets ``.exr``. Raises ``OutputError`` in one sentence.
    """
    path = Path(path)
    if path.is_dir():
        raise OutputError(f"{path} is a directory: give the name of a file in it")
    if not path.suffix:
        path = path.with_name(path.name + ".exr")
    if path.suffix.lower() != ".exr":
        raise OutputError(f"{path} does not end in .exr: the picture is written as OpenEXR, and as PNG beside it")
    directory(path.parent)
    return path


def directory(path) -> Path:
    """Make a directory and return it, once it is certain that files can be made there; else ``OutputError``."""
    path = Path(path)
    probe = _beside(path / "probe")
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OutputError(f"nothing can be written in {path}: {error.strerror}") from None
    return path


def _beside(path: Path) -> Path:
    """Return a name for an unfinished file: hidden, same directory (so that renaming is atomic), same ending."""
    return path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")


def write_file(path, write: Callable) -> None:
    """Let ``write(path)`` make a file beside ``path`` and rename it: an earlier file stays until then."""
    path = Path(path)
    unfinished = _beside(path)
    try:
        write(unfinished)
        os.replace(unfinished, path)
    except (OSError, RuntimeError) as error:
        raise OutputError(f"{path} cannot be written: {error}") from None
    finally:
        unfinished.unlink(missing_ok=True)


def luminance(radiance: np.ndarray) -> np.ndarray:
    """Luminance (...) of linear rgb (..., 3), or the value itself of one channel (..., 1)."""
    return radiance @ LUMINANCE if radiance.shape[-1] == 3 else radiance[..., 0]


def exposure(rgb: np.ndarray) -> float:
    """Return the factor that shows the 97th percentile of the luminance of lit pixels (H, W, 3) at 0.8.

    Black and non-finite pixels have no say; an image without light gets 1.

    >>> round(exposure(np.full((4, 4, 3), 4.0)), 3)
    0.2
    """
    brightness = luminance(rgb)
    lit = brightness[np.isfinite(brightness) & (brightness > 0.0)]
    return float(PNG_LEVEL / np.percentile(lit, PNG_PERCENTILE)) if lit.size else 1.0


def tone_map(rgb: np.ndarray, factor: Optional[float] = None) -> np.ndarray:
    """Return 8-bit sRGB: the linear image times ``factor`` (None: its ``exposure``), clipped, then the sRGB curve.

    What is not finite is black.

    >>> tone_map(np.array([[[0.0, 0.5, 1.0], [2.0, np.nan, 0.0]]]), factor=1.0).tolist()
    [[[0, 188, 255], [255, 0, 0]]]
    """
    rgb = np.asarray(rgb, dtype=np.float64)
    factor = exposure(rgb) if factor is None else factor
    linear = np.clip(np.nan_to_num(rgb * factor, nan=0.0, posinf=0.0, neginf=0.0), 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    return np.round(255.0 * encoded).astype(np.uint8)


def rgb_of(bitmap: mi.Bitmap) -> Optional[np.ndarray]:
    """The main image of a bitmap as linear RGB (H, W, 3), or None if it has none (a film of raw spectral channels)."""
    images = dict(bitmap.split())
    main = images.get("<root>", bitmap)
    if main.pixel_format() == mi.Bitmap.PixelFormat.MultiChannel:
        return None
    return np.array(main.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False))


def about(integrator, scene: str, spp: Optional[int] = None, seed: Optional[int] = None) -> dict:
    """What an EXR's header says of the image, with versions and variant.

    integrator  with its settings, and the error that it expects of its image
    scene       a name, no path
    spp         samples per pixel, None if they are not known
    seed        None if there is none
    """
    said = {"integrator": str(integrator), "scene": scene, "spp": spp, "seed": seed, "variant": mi.variant(),
            "mitsuba": mi.__version__, "refscatter": mitsuba_refscatter.__version__}  # fmt: skip
    error = getattr(integrator, "estimated_error", None)
    said["estimated_error"] = None if error is None else f"{error:.2e}"
    return {key: value for key, value in said.items() if value is not None}


def write_image(
    path, image: mi.Bitmap | np.ndarray, factor: Optional[float] = None, header: Optional[dict] = None
) -> tuple[Path, Optional[Path]]:
    """Write an EXR of all channels with their names, and a tone-mapped PNG beside it; return the two paths.

    path    of the EXR, as ``target`` takes it
    image   ``film.bitmap()``, or an array (H, W, 1 to 4)
    factor  that the PNG shows the image times, None: its ``exposure``
    header  attributes of the EXR, as of ``about``

    There is no PNG, and None for its path, if the image has no RGB or grey channels. Both files are written under
    hidden names and renamed at the end, so that a failure leaves earlier pictures as they were.
    """
    path = target(path)
    bitmap = image if isinstance(image, mi.Bitmap) else mi.Bitmap(np.asarray(image, dtype=np.float32))
    rgb = rgb_of(bitmap)
    for key, value in (header or {}).items():
        bitmap.metadata()[key] = value
    write_file(path, lambda unfinished: bitmap.write(str(unfinished)))
    if rgb is None:
        return path, None
    png = path.with_suffix(".png")
    shown = mi.Bitmap(tone_map(rgb, factor))
    write_file(png, lambda unfinished: shown.write(str(unfinished)))
    return path, png

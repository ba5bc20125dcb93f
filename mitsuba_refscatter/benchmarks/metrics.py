"""How far an image is from a reference.

All functions take linear images (H, W, 3) of finite numbers, in any unit, and return numbers without a unit. They
raise ``ValueError`` where sizes differ or numbers are not finite, where they divide pixel by pixel. FLIP is NVIDIA's
own code.
"""

from __future__ import annotations

import numpy as np

DARK = 0.01
"""What the reference is at least where errors are divided by it, relative to its mean."""


def _relative(image, reference):
    """(a - b) / max(b, 0.01 mean b), pixel by pixel."""
    image, reference = (np.asarray(x, dtype=np.float64) for x in (image, reference))
    if image.shape != reference.shape:
        raise ValueError(f"images of different sizes, {image.shape} and {reference.shape}")
    if not np.isfinite(image).all() or not np.isfinite(reference).all():
        raise ValueError("an image holds numbers that are not finite")
    return (image - reference) / np.maximum(reference, DARK * reference.mean())


def relmse(image: np.ndarray, reference: np.ndarray) -> float:
    """Mean of ((a - b) / max(b, 0.01 mean b))^2 over pixels and colours.

    >>> reference = np.full((2, 2, 3), 4.0)
    >>> relmse(reference + 1, reference)
    0.0625
    """
    return float(np.square(_relative(image, reference)).mean())


def mean_relative_error(image: np.ndarray, reference: np.ndarray) -> float:
    """The relative L1 difference, sum |a - b| / sum b.

    >>> mean_relative_error(np.array([[[1.5, 1.0, 0.5]]]), np.ones((1, 1, 3)))
    0.3333333333333333
    """
    return float(np.abs(np.subtract(image, reference, dtype=np.float64)).sum() / np.sum(reference, dtype=np.float64))


def p99_relative_error(image: np.ndarray, reference: np.ndarray) -> float:
    """99th percentile of |a - b| / max(b, 0.01 mean b) over pixels and colours."""
    return float(np.percentile(np.abs(_relative(image, reference)), 99))


def bias(image: np.ndarray, reference: np.ndarray) -> float:
    """The relative difference of the sums, sum a / sum b - 1.

    >>> bias(np.array([[[1.5, 1.0, 0.5]]]), np.ones((1, 1, 3)))
    0.0
    """
    return float(np.sum(image, dtype=np.float64) / np.sum(reference, dtype=np.float64) - 1)


def relative_error(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """The map (H, W) that ``relmse`` and ``p99_relative_error`` summarise: the largest error of the colours."""
    return np.abs(_relative(image, reference)).max(axis=-1)


def flip(image: np.ndarray, reference: np.ndarray) -> float:
    """Mean HDR-FLIP (Andersson et al. 2021), 0 to 1: what an observer sees of the difference, at several exposures."""
    import flip_evaluator

    reference, image = (np.ascontiguousarray(x, dtype=np.float32) for x in (reference, image))
    _, mean, _ = flip_evaluator.evaluate(reference, image, "HDR")
    return float(mean)


def all_of(image: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """All of the summaries, under the names of ``results.ROW``."""
    return {f.__name__: f(image, reference) for f in (relmse, mean_relative_error, p99_relative_error, bias, flip)}

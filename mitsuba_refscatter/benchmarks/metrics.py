"""How far an image is from a reference. All take linear images (H, W, 3) of finite numbers, of any unit, and give numbers
without one; ``ValueError`` where sizes differ or numbers are not finite. FLIP is NVIDIA's own."""

import numpy as np

DARK = 0.01
"""Relative to the mean of the reference: what it is at least where errors are divided by it."""


def _relative(image, reference):
    image, reference = (np.asarray(x, dtype=np.float64) for x in (image, reference))
    if image.shape != reference.shape:
        raise ValueError(f"images of different sizes, {image.shape} and {reference.shape}")
    if not np.isfinite(image).all() or not np.isfinite(reference).all():
        raise ValueError("an image holds numbers that are not finite")
    return (image - reference) / np.maximum(reference, DARK * reference.mean())


def relmse(image, reference):
    """Mean of ((a - b) / max(b, 0.01 mean b))^2 over pixels and colours.

    >>> reference = np.full((2, 2, 3), 4.0)
    >>> relmse(reference + 1, reference)
    0.0625
    """
    return float(np.square(_relative(image, reference)).mean())


def mean_relative_error(image, reference):
    """sum |a - b| / sum b.

    >>> mean_relative_error(np.array([[[1.5, 1.0, 0.5]]]), np.ones((1, 1, 3)))
    0.3333333333333333
    """
    return float(np.abs(np.subtract(image, reference, dtype=np.float64)).sum() / np.sum(reference, dtype=np.float64))


def p99_relative_error(image, reference):
    """99th percentile of |a - b| / max(b, 0.01 mean b) over pixels and colours."""
    return float(np.percentile(np.abs(_relative(image, reference)), 99))


def bias(image, reference):
    """sum a / sum b - 1.

    >>> bias(np.array([[[1.5, 1.0, 0.5]]]), np.ones((1, 1, 3)))
    0.0
    """
    return float(np.sum(image, dtype=np.float64) / np.sum(reference, dtype=np.float64) - 1)


def relative_error(image, reference):
    """The map of which ``relmse`` and ``p99_relative_error`` are summaries: the largest of the colours (H, W)."""
    return np.abs(_relative(image, reference)).max(axis=-1)


def flip(image, reference):
    """Mean HDR-FLIP (Andersson et al. 2021): what an observer sees of the difference, 0 to 1, at the exposures that it chooses."""
    import flip_evaluator

    reference, image = (np.ascontiguousarray(x, dtype=np.float32) for x in (reference, image))
    _, mean, _ = flip_evaluator.evaluate(reference, image, "HDR")
    return float(mean)


def all_of(image, reference):
    """All of the summaries, under the names of ``results.ROW``."""
    return {f.__name__: f(image, reference) for f in (relmse, mean_relative_error, p99_relative_error, bias, flip)}

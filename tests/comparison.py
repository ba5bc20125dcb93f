"""Two measures of the error of an image or of rays, and comparison of two image estimators that both have noise.

The measures are ``l1`` and ``bias``; the comparison is by blocks of pixels, z values and chi-square.

Each estimator is given as an array (replicates, height, width, channels) of independent renders with
the same expectation, or as the ``Statistics`` of one.  Nothing here knows what is rendered.
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

MEAN_LIMIT = 3.0  # largest |z| of an image mean
BLOCK_LIMIT = 4.5  # largest |z| of a block; one of 1,000 blocks exceeds it with probability 0.7 %
CHI2_TAIL = 1e-3  # chi-square of the blocks must be in its 0.1 % to 99.9 % range
ROUNDING = 1e-6  # of float32 images, relative
DARK = 0.05  # blocks darker than this, relative to the image mean, hold too few paths for a z-test


def l1(found, truth):
    """The relative L1 difference, sum |a - b| / sum b: the measure that ``tolerance`` is for."""
    return np.abs(found - truth).sum() / truth.sum()


def bias(found, truth):
    """The relative difference of the sums, sum a / sum b - 1: errors of either sign cancel in it."""
    return found.sum() / truth.sum() - 1


@dataclass(frozen=True)
class Agreement:
    """Per channel (C,): means' relative difference, its standard error and z, chi-square of blocks and
    its probability from below; ``blocks``: z values (blocks, C); ``block_error``: median standard error."""

    difference: np.ndarray
    error: np.ndarray
    z: np.ndarray
    chi2: np.ndarray
    probability: np.ndarray
    blocks: np.ndarray
    block_error: float

    def __str__(self):
        def row(x):
            return " ".join(f"{v:8.4f}" for v in x)

        return (
            f"relative difference {row(self.difference)}  standard error {row(self.error)}  z {row(self.z)}\n"
            f"{len(self.blocks)} blocks: chi2 {row(self.chi2)}  probability {row(self.probability)}  "
            f"largest |z| {np.abs(self.blocks).max():.2f}  median relative error {self.block_error:.3f}"
        )


def block_means(images, size):
    """Means over blocks of size x size pixels: (N,H,W,C) -> (N,H/size,W/size,C)."""
    n, height, width, channels = images.shape
    return images.reshape(n, height // size, size, width // size, size, channels).mean((2, 4))


def z_values(a, b):
    """Difference of the means of a (N,...) and b (M,...), its standard error, and z (all (...)).

    The variances are estimated from the replicates, so the quotient follows Student's t (Welch);
    z is the normal variate of the same probability."""
    return _z(*((len(x), x.mean(0), x.var(0, ddof=1)) for x in (a, b)))


def _z(a, b):
    """The same of (count, mean, variance)."""
    rounding = (
        ROUNDING * (np.abs(a[1]) + np.abs(b[1]))
    ) ** 2 + 1e-300  # where both have no noise, as under an even sky
    va, vb = a[2] / a[0] + rounding, b[2] / b[0] + rounding
    difference, variance = a[1] - b[1], va + vb
    freedom = variance**2 / np.maximum(va**2 / (a[0] - 1) + vb**2 / (b[0] - 1), 1e-300)
    t = difference / np.sqrt(variance)
    z = np.sign(t) * stats.norm.isf(np.maximum(stats.t.sf(np.abs(t), freedom), 1e-300))
    return difference, np.sqrt(variance), z


@dataclass(frozen=True)
class Statistics:
    """Of ``count`` renders: mean and variance of the image mean (C,), and of the means of blocks (h, w, C)."""

    count: int
    mean: np.ndarray
    variance: np.ndarray
    block_mean: np.ndarray
    block_variance: np.ndarray

    @classmethod
    def of(cls, images, size):
        """Of (N, H, W, C), with blocks of size x size pixels; of ``Statistics`` themselves."""
        if isinstance(images, cls):
            return images
        images = np.asarray(images, dtype=np.float64)
        whole, blocks = images.mean((1, 2)), block_means(images, size)
        return cls(len(images), whole.mean(0), whole.var(0, ddof=1), blocks.mean(0), blocks.var(0, ddof=1))


def compare(ours, theirs, size):
    """``Agreement`` of two sets of renders, with blocks of size x size pixels."""
    a, b = (Statistics.of(x, size) for x in (ours, theirs))
    difference, error, z = _z(*((x.count, x.mean, x.variance) for x in (a, b)))
    bright = (a.block_mean > DARK * a.mean).all(-1)
    _, block_error, block_z = _z(*((x.count, x.block_mean[bright], x.block_variance[bright]) for x in (a, b)))
    chi2 = (block_z**2).sum(0)
    return Agreement(
        difference / a.mean,
        error / a.mean,
        z,
        chi2,
        stats.chi2.cdf(chi2, bright.sum()),
        block_z,
        float(np.median(block_error / a.block_mean[bright])),
    )


def check(agreement, mean_error, block_error):
    """Asserts agreement, and that the statistics were good enough to see a difference: relative
    standard errors of the image mean and (median) of a block."""
    print(agreement)
    assert (agreement.error < mean_error).all(), f"too few samples to tell anything\n{agreement}"
    assert agreement.block_error < block_error, f"too few samples to tell anything\n{agreement}"
    assert (np.abs(agreement.z) < MEAN_LIMIT).all(), f"the image means differ\n{agreement}"
    assert (np.abs(agreement.blocks) < BLOCK_LIMIT).all(), f"a block differs\n{agreement}"
    assert (agreement.probability > CHI2_TAIL).all(), f"blocks agree too well: standard errors are wrong\n{agreement}"
    assert (agreement.probability < 1 - CHI2_TAIL).all(), f"blocks differ\n{agreement}"

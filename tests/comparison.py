"""Comparison of two image estimators that both have noise: blocks of pixels, z values, chi-square.

Each estimator is given as an array (replicates, height, width, channels) of independent renders with
the same expectation.  Nothing here knows what is rendered.
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

MEAN_LIMIT = 3.0  # largest |z| of an image mean
BLOCK_LIMIT = 4.5  # largest |z| of a block; one of 1,000 blocks exceeds it with probability 0.7 %
CHI2_TAIL = 1e-3  # chi-square of the blocks must be in its 0.1 % to 99.9 % range
DARK = 0.05  # blocks darker than this, relative to the image mean, hold too few paths for a z-test


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
    va, vb = a.var(0, ddof=1) / len(a), b.var(0, ddof=1) / len(b)
    difference, variance = a.mean(0) - b.mean(0), np.maximum(va + vb, 1e-300)
    freedom = variance**2 / np.maximum(va**2 / (len(a) - 1) + vb**2 / (len(b) - 1), 1e-300)
    t = difference / np.sqrt(variance)
    z = np.sign(t) * stats.norm.isf(np.maximum(stats.t.sf(np.abs(t), freedom), 1e-300))
    return difference, np.sqrt(variance), z


def compare(ours, theirs, size):
    """``Agreement`` of two sets of renders, with blocks of size x size pixels."""
    difference, error, z = z_values(ours.mean((1, 2)), theirs.mean((1, 2)))
    level = ours.mean((0, 1, 2))
    blocks = [block_means(x, size).reshape(len(x), -1, x.shape[-1]) for x in (ours, theirs)]
    bright = (blocks[0].mean(0) > DARK * level).all(-1)
    block_difference, block_error, block_z = z_values(*(x[:, bright] for x in blocks))
    chi2 = (block_z**2).sum(0)
    return Agreement(
        difference / level,
        error / level,
        z,
        chi2,
        stats.chi2.cdf(chi2, bright.sum()),
        block_z,
        float(np.median(block_error / blocks[0].mean(0)[bright])),
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

"""The numbers of camera samples: the Sobol sequence, turned for each pixel and for each group of them."""

import numpy as np
import pytest
from scipy.stats import qmc

from mitsuba_refscatter.core import sobol
from mitsuba_refscatter.core.sobol import LIGHT, PLACE, Batch, Sequence

pytestmark = pytest.mark.usefixtures("rgb")


@pytest.mark.parametrize("count", [1, 16, 1024, 4096])
def test_sobol_against_scipy(count):
    """Which has the points of each power of two in another order."""
    ours = np.stack([sobol.sobol(np.arange(count), k) for k in range(4)], axis=-1) / 2**32
    theirs = qmc.Sobol(4, scramble=False).random(count)
    assert (ours[np.lexsort(ours.T)] == theirs[np.lexsort(theirs.T)]).all()


def numbers(made, batches, pixels, light_samples):
    """The four numbers of the samples of pixels (pixels, samples, 4) as integers of 24 bits, and their light
    points' indices."""
    parts, which = [], []
    for batch in batches:
        n = pixels * batch.per_pixel
        light, index = made.shared(light_samples, batch, n)
        index = index.numpy().astype(int)
        place = made.own(PLACE, batch, n).numpy().T
        parts.append(np.concatenate([place, light[index]], axis=1).reshape(pixels, batch.per_pixel, 4))
        which.append(index.reshape(pixels, batch.per_pixel))
    return np.floor(np.concatenate(parts, axis=1) * 2**24).astype(int), np.concatenate(which, axis=1)


@pytest.mark.parametrize("per_pixel, light_samples", [(1, 16), (4, 16), (5, 16), (16, 16)])
def test_a_pixel_has_one_sobol_sequence(per_pixel, light_samples):
    """From pass to pass, place and light together: all but one turn per pixel."""
    passes = 64 // per_pixel
    x, which = numbers(Sequence(5), [Batch(k * per_pixel, per_pixel) for k in range(passes)], 100, light_samples)
    plain = np.stack([sobol.sobol(np.arange(passes * per_pixel), k) for k in PLACE + LIGHT], axis=-1) >> 8
    turns = x ^ plain
    assert (turns == turns[:, :1]).all()
    assert len(np.unique(turns[:, 0, :2], axis=0)) == 100  # of places, for each pixel
    groups = light_samples // per_pixel
    assert len(np.unique(turns[:, 0, 2:], axis=0)) == groups
    blocks = (which[:, 0] // per_pixel)[: 100 // groups * groups].reshape(-1, groups)
    assert (np.sort(blocks, axis=1) == np.arange(groups)).all()  # neighbours are in different groups
    assert groups == 1 or len(np.unique(blocks, axis=0)) > 1


@pytest.mark.parametrize("per_pixel, light_samples", [(1, 16), (4, 16), (16, 16), (1, 64), (4, 128)])
def test_all_light_points_of_a_pass_are_evenly_spread(per_pixel, light_samples):
    """Rectangles of equal area, of every shape, hold as many of them as of the first points of the sequence; and
    those of two passes are not the same."""
    made = Sequence(5)
    pools = [made.shared(light_samples, Batch(k * per_pixel, per_pixel), 1)[0] for k in range(2)]
    plain = np.stack([sobol.sobol(np.arange(light_samples), k) / 2**32 for k in LIGHT], axis=-1)
    m = light_samples.bit_length() - 1
    for points in pools:
        assert len(points) == light_samples
        for q in range(m + 1):
            counts = [np.sort(np.histogram2d(*x.T, bins=(2**q, 2 ** (m - q)), range=[[0, 1]] * 2)[0].ravel())
                      for x in (points, plain)]  # fmt: skip
            assert (counts[0] == counts[1]).all(), (q, counts)
    assert len(np.unique(np.concatenate(pools), axis=0)) == 2 * light_samples


def test_passes_may_grow():
    """Where each sample has a light point of its own (one group of pixels), the sequence goes on whatever the
    passes' sizes."""
    sizes, made = (1, 1, 2, 4, 7, 5), Sequence(5)
    batches = [Batch(sum(sizes[:k]), size) for k, size in enumerate(sizes)]
    x = np.concatenate([numbers(made, [batch], 1, batch.per_pixel)[0] for batch in batches], axis=1)[0]
    plain = np.stack([sobol.sobol(np.arange(sum(sizes)), k) for k in PLACE + LIGHT], axis=-1) >> 8
    assert ((x ^ plain) == (x ^ plain)[0]).all()


def test_few_light_points_are_shared():
    """By consecutive samples, as evenly as it goes; they go on in the next pass."""
    x, which = numbers(Sequence(5), [Batch(0, 10), Batch(10, 10)], 3, 4)
    assert (which[:, :10] == np.arange(10) // 3).all() and (which[:, :10] == which[:, 10:]).all()
    light = x[0, ::1, 2:] ^ np.stack([sobol.sobol(np.arange(8), k) for k in LIGHT], axis=-1)[
        np.arange(20) // 10 * 4 + np.arange(20) % 10 // 3] >> 8  # fmt: skip
    assert (light == light[0]).all()


def test_each_number_is_uniform():
    """Over pixels, and over seeds for what pixels share: means of single numbers within four standard errors."""
    own = Sequence(3).own(PLACE, Batch(0, 1), 10000).numpy()
    assert np.abs(own.mean(axis=1) - 0.5).max() < 4 * (1 / 12 / 10000) ** 0.5 and own.min() >= 0 and own.max() < 1
    shared = np.array([Sequence(seed).shared(1, Batch(0, 1), 1)[0][0] for seed in range(1000)])
    assert np.abs(shared.mean(axis=0) - 0.5).max() < 4 * (1 / 12 / 1000) ** 0.5
    assert abs(np.corrcoef(shared.T)[0, 1]) < 4 / 1000**0.5 and abs(np.corrcoef(own)[0, 1]) < 4 / 10000**0.5

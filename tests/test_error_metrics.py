"""Error metrics on images whose errors are known, and times to an error on curves that are."""

import numpy as np
import pytest

from mitsuba_refscatter.benchmarks import metrics, race


@pytest.fixture
def reference():
    return np.random.default_rng(1).uniform(0.5, 1.5, size=(40, 30, 3))


@pytest.mark.parametrize("factor", [1.0, 1.01, 0.7])
def test_a_factor(reference, factor):
    """Every summary of an image that is brighter everywhere by one factor is a power of the difference."""
    image, error = factor * reference, factor - 1
    assert metrics.relmse(image, reference) == pytest.approx(error**2, abs=1e-12)
    assert metrics.mean_relative_error(image, reference) == pytest.approx(abs(error), abs=1e-12)
    assert metrics.p99_relative_error(image, reference) == pytest.approx(abs(error), abs=1e-12)
    assert metrics.bias(image, reference) == pytest.approx(error, abs=1e-12)
    np.testing.assert_allclose(metrics.relative_error(image, reference), abs(error), atol=1e-12)


def test_noise(reference):
    """Relative noise of a known deviation: no bias, and the other summaries are its moments and its 99th percentile."""
    sigma = 0.1
    image = reference * (1 + sigma * np.random.default_rng(2).normal(size=reference.shape))
    assert metrics.relmse(image, reference) == pytest.approx(sigma**2, rel=0.1)
    assert metrics.mean_relative_error(image, reference) == pytest.approx(sigma * (2 / np.pi) ** 0.5, rel=0.1)
    assert metrics.p99_relative_error(image, reference) == pytest.approx(2.576 * sigma, rel=0.1)
    assert abs(metrics.bias(image, reference)) < 4 * sigma / reference.size**0.5


def test_one_pixel(reference):
    """An error of one value shows in a sum, and not in a percentile."""
    image = reference.copy()
    image[3, 4, 1] *= 3
    n = reference.size
    assert metrics.relmse(image, reference) == pytest.approx(4 / n)
    assert metrics.p99_relative_error(image, reference) == 0
    assert metrics.relative_error(image, reference).max() == pytest.approx(2)
    assert metrics.bias(image, reference) == pytest.approx(2 * reference[3, 4, 1] / reference.sum())


def test_dark_pixels_do_not_decide(reference):
    """Where the reference is black errors are relative to a hundredth of its mean."""
    reference[0] = 0
    image = reference.copy()
    image[0] = 1e-3 * reference.mean()
    assert metrics.relmse(image, reference) == pytest.approx(0.1**2 / len(reference))


def test_flip_is_zero_for_equal_images_and_grows_with_noise(reference):
    noise = np.random.default_rng(3).normal(size=reference.shape)
    found = [metrics.flip(np.abs(reference + level * noise), reference) for level in (0, 0.1, 0.4)]
    assert found[0] < 1e-6 and 0.01 < found[1] < found[2] < 1


def test_images_that_cannot_be_compared_are_refused(reference):
    with pytest.raises(ValueError, match="sizes"):
        metrics.relmse(reference[1:], reference)
    reference[0, 0, 0] = np.nan
    with pytest.raises(ValueError, match="finite"):
        metrics.relmse(np.ones_like(reference), reference)


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_time_to_an_error(power):
    """On a curve that falls with a power of time: read off within it, extrapolated beyond."""
    t = np.geomspace(0.1, 10, 40)
    curve = list(zip(t, 3.0 * t**-power))
    for seconds in (0.5, 4.0, 300.0):
        found, extrapolated = race.seconds_to(curve, 3.0 * seconds**-power)
        assert found == pytest.approx(seconds, rel=1e-3) and extrapolated == (seconds > 10)


def test_time_to_an_error_that_is_never_reached():
    """A curve that levels out is not extrapolated; neither is one of too few points."""
    t = np.geomspace(0.1, 10, 40)
    assert race.seconds_to(list(zip(t, 0.1 + 1e-3 / t)), 0.01) == (None, True)
    assert race.seconds_to([(1.0, 0.2), (2.0, 0.1)], 0.01) == (None, True)
    assert race.seconds_to([(1.0, 0.2), (2.0, 0.1)], 0.01, power=1) == (pytest.approx(20.0), True)


def test_an_error_counts_from_where_the_curve_stays_below():
    curve = [(1.0, 0.1), (2.0, 0.01), (3.0, 0.1), (4.0, 0.01)]
    seconds, extrapolated = race.seconds_to(curve, 0.05)
    assert 3 < seconds < 4 and not extrapolated

"""Numbers for camera samples: the place in the pixel and the choice of a light point, evenly spread together.

The errors of an image from light points alone, and from places in the pixels alone, are small if either are evenly
spread. What is left is the error of the pairs. So the four numbers of a pixel's samples are points of one Sobol
sequence (Sobol 1967, with the direction numbers of Joe and Kuo 2008). They get a random digital shift, an exclusive or:
each number alone is then uniform.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from . import arrays

BITS = 32

DIRECTIONS = ((0, ()), (0, (1,)), (1, (1, 3)), (1, (1, 3, 1)))
"""Per dimension the coefficients of the primitive polynomial and the initial direction numbers (Joe and Kuo 2008).

The first dimension is van der Corput's."""

PLACE, LIGHT = (0, 1), (2, 3)
"""The dimensions of the place in the pixel and of the light point."""

ROUNDS = 8
"""Of the cipher that makes the pixels' digital shifts.

With Mitsuba's default of four, those of neighbouring seeds are correlated."""


def _columns(dimension):
    """Direction numbers, the columns of the generator matrix, as integers of ``BITS`` bits."""
    polynomial, first = DIRECTIONS[dimension]
    m, degree = list(first), len(first)
    for i in range(degree, BITS):
        if degree == 0:
            m.append(1)
            continue
        new = m[i - degree] ^ (m[i - degree] << degree)
        for k in range(1, degree):
            if polynomial >> (degree - 1 - k) & 1:
                new ^= m[i - k] << k
        m.append(new)
    return [x << (BITS - 1 - i) for i, x in enumerate(m)]


def sobol(index, dimension):
    """Numbers ``index`` (integers below 2^32) of the Sobol sequence in one dimension, as uint32 fractions of 2^32.

    >>> (sobol([0, 1, 2, 3, 4], 0) / 2**32).tolist()
    [0.0, 0.5, 0.25, 0.75, 0.125]
    """
    index = np.asarray(index, dtype=np.uint64)
    out = np.zeros(index.shape, dtype=np.uint64)
    for bit, column in enumerate(_columns(dimension)):
        out ^= np.where(index >> np.uint64(bit) & np.uint64(1), np.uint64(column), np.uint64(0))
    return out.astype(np.uint32)


@dataclass(frozen=True)
class Batch:
    """Camera samples that are rendered together.

    first      number, in its pixel, of the first sample of each pixel
    per_pixel  neighbouring lanes that belong to one pixel
    """

    first: int = 0
    per_pixel: int = 1

    def split(self, n):
        """Pixel and number in it (UInt32) of each of ``n`` lanes.

        >>> Batch(first=8, per_pixel=2).split(6)
        ([0, 0, 1, 1, 2, 2], [0, 1, 0, 1, 0, 1])
        """
        lane, per_pixel = dr.arange(mi.UInt32, n), dr.opaque(mi.UInt32, self.per_pixel)
        return lane // per_pixel, lane % per_pixel


class Sequence:
    """The numbers of all camera samples of a render; ``seed``: int, of their digital shifts."""

    def __init__(self, seed):
        self.seed = seed & 0xFFFFFFFF

    def own(self, dimensions, batch, n):
        """Two numbers (Point2f in [0, 1)) for each lane, with a digital shift for each pixel.

        dimensions  two of the sequence: ``PLACE`` or ``LIGHT``
        batch       ``Batch`` of the lanes
        n           int, number of lanes
        """
        pixel, number = batch.split(n)
        out = []
        for k in dimensions:
            table = arrays.array(mi.UInt32, sobol(batch.first + np.arange(batch.per_pixel), k))
            shift = mi.sample_tea_32(pixel, self._stream(k), ROUNDS)[0]
            out.append(mi.Float((dr.gather(mi.UInt32, table, number) ^ shift) >> 8) * 2.0**-24)
        return mi.Point2f(*out)

    def shared(self, light_samples, batch, n):
        """Numbers of light points that many samples share, (points, 2) in [0, 1), and per lane which (UInt32).

        light_samples  int, about so many light points
        batch          ``Batch`` of the lanes
        n              int, number of lanes

        The pixels are in groups with numbers of their own, neighbours in different ones, as many as there are light
        points for. Where there are fewer points than samples in a pixel, consecutive samples have the same. The groups'
        numbers go on in the sequence, so that those of all light points are evenly spread, too. Below their leading
        digits they are scrambled (by a triangular matrix: Matousek 1998), so that the next samples of other groups are
        not the same again.
        """
        each = -(-batch.per_pixel // light_samples)
        points = -(-batch.per_pixel // each)
        groups = max(1, light_samples // points)
        pixel, number = batch.split(n)
        several = dr.opaque(mi.UInt32, groups)
        first = mi.sample_tea_32(pixel // several, self._stream(len(DIRECTIONS)), ROUNDS)[0]
        group = (pixel + first % several) % several
        which = group * dr.opaque(mi.UInt32, points) + number // dr.opaque(mi.UInt32, each)
        digits = (points - 1).bit_length()
        index = batch.first * points // batch.per_pixel + np.arange(points)
        numbers = np.stack([sobol(index, k) ^ self._scrambled(groups, digits, k)[:, None] for k in LIGHT], axis=-1)
        return numbers.reshape(-1, 2) / 2.0**BITS, which

    def _stream(self, k):
        """A second argument for the cipher, another for each k and for each seed."""
        return dr.opaque(mi.UInt32, ((len(DIRECTIONS) + 1) * self.seed + k) & 0xFFFFFFFF)

    def _scrambled(self, groups, digits, dimension):
        """Scrambled digital shifts (uint32) of groups whose first numbers differ in the leading ``digits``."""
        ahead, rng = sobol(np.arange(groups) << digits, dimension), np.random.default_rng([self.seed, dimension])
        out = np.full(groups, rng.integers(2**BITS), dtype=np.uint32)
        for row in range(BITS):
            bit = 1 << (BITS - 1 - row)
            below = int(rng.integers(bit))
            column = bit | (below if row >= digits else 0)
            out ^= np.where(ahead & np.uint32(bit), np.uint32(column), np.uint32(0))
        return out

"""What an estimator is: it sums what the light beams that a culling finds bring to camera segments."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import mitsuba as mi

from ..transport.segments import LocalSegments


@dataclass
class Query:
    """Sample points that are looked at in place of camera segments.

    index   UInt32, the segment of each point
    points  segments of no length there
    weight  Spectrum, what radiance per unit length at a point counts for its segment
    done    (from, to): shares of all points that are done before and after these, 0 to 1
    """

    index: mi.UInt32
    points: LocalSegments
    weight: mi.Spectrum
    done: tuple[float, float]


class Estimator(ABC):
    """A way to sum single scattering of one light sample.

    Its attributes say what it can do; nothing asks for its name.
    """

    needs_fine = True
    """Whether light beams must be so small that few samples of the light on them do."""

    samples_field: str | None = None
    """The field of ``tolerances.Accuracy`` that the option ``samples`` sets, or None where it has no meaning."""

    of_beams: Estimator | None = None
    """The same on light beams whose error follows the tolerance, or None where there is none."""

    draws = False
    """Whether it draws random numbers."""

    finds_sent_back = False
    """Whether it finds light that a point at the camera sends straight back."""

    def __init_subclass__(cls):
        cls.of_beams = cls.__dict__.get("of_beams")  # of its own: what another class does there it does not

    def queries(self, _segments, _illumination, _accuracy, _seed) -> Iterator[Query] | None:
        """The ``Query`` of sample points that stand for camera segments, chunk by chunk; None where there are none.

        segments      ``LocalSegments``
        illumination  ``light.illumination.Illumination``
        accuracy      ``tolerances.Accuracy``
        seed          int, of random numbers
        """
        return None

    @abstractmethod
    def classify(self, piece, segment):
        """``culling.beam.Zeros``: on which light beams a pair may contribute, lane by lane.

        piece    ``culling.beam.Piece``
        segment  ``LocalSegments``
        """

    @abstractmethod
    def accumulate(self, sums, pairs, segments, culling, illumination, accuracy):
        """Adds what pairs bring to their segments.

        sums          ``accumulator.Sums``
        pairs         ``culling.pairs.Pairs``, of those that ``classify`` brackets
        segments      ``LocalSegments``, which the pairs' numbers mean
        culling       ``culling.protocol.Culling``
        illumination  ``light.illumination.Illumination``
        accuracy      ``tolerances.Accuracy``

        Returns the pairs whose curves must be cut first, or None.
        """

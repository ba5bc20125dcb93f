"""What the one knob ``tolerance`` selects."""

from __future__ import annotations

import math
from dataclasses import dataclass

ALONG = 10.0
"""One point along the curve in a light beam makes an error of about this over the number of beams."""

MOST_PARTS = 8
"""Parts of the curve in a light beam, at most."""

MAX_PAIR_SUBDIVISION = 8
"""Most levels by which a beam is refined for the segments along which g is far from linear on it.

Where a light is next to the camera it is so everywhere, and parts are small compared to their distance: g is then
not far from its rounding in float32."""


@dataclass(frozen=True)
class Accuracy:
    """What the one knob ``tolerance`` selects.

    cells               relative L1 error of the image that light beams may make; 0: exact triangles instead
    along               error that sums over too few parts of the curve in light beams may make
    uneven              largest error of the mean of 1 / |grad g| along the curve in one beam; above, it is cut
    coarse              whether the first cells of light beams may be those of a coarse mesh
    bend                largest deviation of a triangle's beam from a linear one, by its width; above, it is cut
    points              Gauss points along the curve in the beam of one triangle
    guest_points        the same on triangles, where shadows of other objects may end on them
    newton              Newton steps per point of a triangle
    weight              camera segments with a smaller weight are dropped
    linear              largest deviation of g from linear, relative to its range, on a triangle that is solved whole
    clip                the same of t + s, relative to its change, along a curve that begins or ends inside a beam
    interval_samples    samples per interval, of the estimator of that name
    point_samples       samples per camera segment; their noise is about 0.5 / sqrt(samples), not the tolerance
    panels              of the quadrature for light that is not refracted
    panel_points        Gauss points in each panel
    lobes               error that this quadrature may make of a phase function's integral, relative to it
    samples_visibility  whether what is lit, and how far, is judged by samples where it can't be proven
    adapts              whether intervals across which much is absorbed get more samples
    """

    cells: float
    along: float
    uneven: float
    coarse: bool
    bend: float
    points: int
    guest_points: int
    newton: int
    weight: float
    linear: float
    clip: float
    interval_samples: int
    point_samples: int
    panels: int
    panel_points: int
    lobes: float
    samples_visibility: bool
    adapts: bool = True


def parts_along(beams, error):
    """Parts of the curve in one of a number of light ``beams`` of one light that are summed by one point each, for a
    relative ``error``, which falls with their square."""
    return min(math.ceil(math.sqrt(ALONG / max(beams, 1) / max(error, 1e-30))), MOST_PARTS)


def levels(error):
    """Levels to which light beams with a relative ``error`` are cut for single segments: what is left then is a share
    of the light of about a tenth of it."""
    return min(max(round(-math.log2(max(error, 1e-30))), 1), MAX_PAIR_SUBDIVISION)


def accuracy(tolerance):
    """The ``Accuracy`` that is safe for a relative error ``tolerance`` of the image (0: exact to float32).

    Factors and powers were chosen where errors of all shipped scenes are below the tolerance, most of them far.
    """
    finest = max(tolerance, 1e-4)
    decades = -math.log10(finest)  # 1 at 0.1, 2 at 0.01
    points = min(2 ** max(0, math.ceil(decades - 2.5)), 4)
    return Accuracy(
        cells=0.7 * tolerance,
        along=0.2 * tolerance,
        uneven=math.sqrt(finest) if points == 1 else 0.03,
        coarse=True,
        bend=min(max(math.sqrt(finest), 0.02), 0.5),
        points=points,
        guest_points=min(4 ** max(0, math.ceil(decades - 2.5)), 8),
        newton=min(max(0, math.ceil(decades - 1.5)), 3),
        weight=0.1 * tolerance,
        linear=min(2.5 * math.sqrt(finest), 1.0),
        clip=min(finest, 0.05),
        interval_samples=min(4 ** max(0, math.ceil(decades - 2.5)), 16),
        point_samples=round(8 * 4 ** min(max(decades - 1, 0), 3)),
        panels=round(6 * 2 ** min(max(decades - 1, 0), 3)),
        panel_points=3 if decades > 3.5 else 2,
        lobes=min(0.1 * finest, 1e-2),
        samples_visibility=tolerance >= 0.01,
    )

"""What the one knob ``tolerance`` selects."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Accuracy:
    """What the one knob ``tolerance`` selects.

    bend                largest deviation of a light beam from a linear one, relative to its width; above, it is cut
    points              Gauss points along the curve in one beam
    guest_points        the same where shadows of other objects may end on it
    newton              Newton steps per point, on patches 1 at least
    weight              camera segments with a smaller weight are dropped
    linear              largest deviation of g from linear, relative to its range, on a beam that is solved whole
    clip                the same of t + s, relative to its change, along a curve that begins or ends inside a beam
    interval_samples    samples per interval, of the estimator of that name
    point_samples       samples per camera segment; their noise is about 0.5 / sqrt(samples), not the tolerance
    panels              of the quadrature for light that is not refracted
    panel_points        Gauss points in each panel
    lobes               error that this quadrature may make of a phase function's integral, relative to it
    adapts              whether intervals across which much is absorbed get more samples
    samples_visibility  whether what is lit, and how far, is judged by samples where it can't be proven
    coarse              relative error that a coarser mesh may make
    """

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
    adapts: bool = True
    samples_visibility: bool = False
    coarse: float = 0.0


TIERS = {
    0.1: Accuracy(
        bend=0.5,
        points=1,
        guest_points=1,
        newton=0,
        weight=0.2,
        linear=1.0,
        clip=0.05,
        interval_samples=1,
        point_samples=8,
        panels=6,
        panel_points=2,
        lobes=1e-2,
        coarse=0.8,
        samples_visibility=True,
    ),
    0.01: Accuracy(
        bend=0.1,
        points=1,
        guest_points=1,
        newton=1,
        weight=0.1,
        linear=0.25,
        clip=0.01,
        interval_samples=1,
        point_samples=32,
        panels=12,
        panel_points=2,
        lobes=1e-3,
        coarse=0.7,
        samples_visibility=True,
    ),
    0.001: Accuracy(
        bend=0.05,
        points=2,
        guest_points=4,
        newton=2,
        weight=1e-2,
        linear=0.1,
        clip=0.001,
        interval_samples=4,
        point_samples=128,
        panels=24,
        panel_points=2,
        lobes=1e-4,
        coarse=0.7,
    ),
    0.0: Accuracy(
        bend=0.02,
        points=4,
        guest_points=8,
        newton=3,
        weight=1e-2,
        linear=0.05,
        clip=1e-4,
        interval_samples=16,
        point_samples=512,
        panels=48,
        panel_points=3,
        lobes=1e-5,
    ),
}
"""What is safe from these tolerances on; ``weight`` and ``coarse`` are shares of the tolerance."""


def accuracy(tolerance):
    """The ``Accuracy`` that is safe for a relative error ``tolerance`` of the image (0: exact to float32)."""
    tier = next(tier for least, tier in TIERS.items() if tolerance >= least)
    return replace(tier, weight=tier.weight * tolerance, coarse=tier.coarse * tolerance)

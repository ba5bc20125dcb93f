"""A million random rays: the largest error of a single one, against the oracle.

The oracle is too slow for all of them. It judges those in which the package's own tolerances and estimators differ
most: an error that is in all of them alike would have to be in the sums of
``tests/test_extremes_against_oracle.py``, too.
"""

from dataclasses import replace

import build
import numpy as np
import pytest
from test_extremes_against_oracle import CAMERA, CASES

from mitsuba_refscatter.options import Options

RAYS, SUSPECTS = 100_000, 16
LEAST = 0.05
"""Radiance relative to the mean below which errors are relative to that: the ends of what is lit are dark."""
FIREFLY = 0.3
"""Error, relative to the radiance or the mean over all rays, whichever is larger, that no single ray may have."""
UNKNOWN = 0.2
"""Share of suspects, less than this, that the oracle may not know to 1 %: its own error falls slowly where a ray
grazes a caustic, which is where suspects are. They are not in the table; fireflies none of them is either, by more
than the oracle's doubt."""

NAMES = [
    "eta 2.5",
    "eta 0.4",
    "density x size 8",
    "light 1e-2 from the surface",
    "light 1000 sizes away",
    "hg 0.99",
    "closed cylinder",
    "needle triangles 1 : 10^6",
    "shading normals up to 70 degrees off",
    "eta 1.01",
]
AT_FOLDS = ["eta 2.5", "density x size 8", "light 1000 sizes away", "shading normals up to 70 degrees off"]
"""Where at the default tolerance beams move the fold of a caustic past some ray of 100,000."""
LOOKS = {
    "default": {"tolerance": Options().tolerance},
    "0.001": {"tolerance": 1e-3},
    "0": {"tolerance": 0.0},
    "interval": {"tolerance": 1e-3, "estimator": "interval", "culling": "spindle"},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_no_ray_is_far_off(rgb, tmp_path, name):
    """But by the method of 2015, which samples; how far that is off is printed, too."""
    case = next(case for case in CASES if case.name == name)
    case = replace(case, rays=build.rays_at(CAMERA, 0.95, RAYS, seed=11), bounces=0)
    found = {look: case.ours(tmp_path, **options).sum(axis=1) for look, options in LOOKS.items()}
    best, mean = found["0"], found["0"].mean()
    apart = [np.abs(x - best) / np.maximum(best, LEAST * mean) for x in found.values()]
    suspects = np.unique(np.concatenate([x.argsort()[-SUSPECTS:] for x in apart]))
    few = replace(case, rays=tuple(x[suspects] for x in case.lines()))
    rough, truth = (replace(few, subdivisions=k).truths()[0].sum(axis=1) for k in (5, 6))
    doubt = np.abs(rough - truth)
    known = doubt < 0.01 * np.maximum(truth, LEAST * mean)
    print(f"{name}: of {len(suspects)} suspects the oracle knows {(~known).sum()} to no better than 1 %, the worst to "
          f"{(doubt / np.maximum(truth, LEAST * mean)).max():.1%}")  # fmt: skip
    assert (~known).mean() < UNKNOWN
    for look, radiance in found.items():
        error = np.abs(radiance[suspects] - truth)
        relative = (error / np.maximum(truth, LEAST * mean))[known]
        at = suspects[known][relative.argmax()]
        print(f"| {name} | {look} | {relative.max():.1e} | {best[at] / mean:.2g} |")
        worst = ((error - doubt * ~known) / np.maximum(truth, mean)).max()
        if look == "default" and name in AT_FOLDS:
            print(f"{name}: {worst:.2f} of the mean or the radiance, more than {FIREFLY}")
            moved = worst
        else:
            assert look == "interval" or worst < FIREFLY
    if name in AT_FOLDS:
        assert moved >= FIREFLY, "no longer off: take it from the list"
        pytest.xfail(f"a ray is off by {moved:.2f} at the default tolerance")

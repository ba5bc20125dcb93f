"""Newton's method finds the light paths L -> P -> V: over 99.9 % of them, each once, and nothing else.

Against paths made by Snell's law, and against Newton's method from 25 starts, both in float64 NumPy.
"""

import build
import numpy as np
import pytest
import soup
from meshes import norm

from mitsuba_refscatter.solve.newton import Status

ETAS = (0.6, 0.9, 1.0, 1.001, 1.33, 1.5, 2.4)
NEAR = 0.02
"""Distance in (u, v) within which two roots are the same: next to a fold float32 moves them by that much."""


def distance_to(case, uv, segment, roots):
    """Distance from each (case, uv) to the nearest of ``roots`` of that case (segment, (u, v))."""
    order = np.argsort(segment, kind="stable")
    segment, roots = segment[order], roots[order]
    first, last = np.searchsorted(segment, case), np.searchsorted(segment, case, side="right")
    nearest = np.full(len(case), np.inf)
    for k in range((last - first).max()):
        some = first + k < last
        nearest[some] = np.minimum(nearest[some], norm(roots[(first + k)[some]] - uv[some])[:, 0])
    return nearest


def test_a_million_solves(rgb):
    """Random triangles, lights and points V, each with a root that Snell's law made: over 99.9 % of these are found for
    each eta, none twice, and all that is found is refracted light, not reflected and not from behind."""
    rng, cases = np.random.default_rng(5), 0
    for eta in ETAS:
        case = soup.random_cases(rng, 400_000 if eta < 0.7 else 200_000 if eta < 1 else 160_000, eta)
        roots = soup.solve(case, eta)
        segment, _, uv = roots.all()
        found = distance_to(np.arange(len(case.V)), case.uv, segment, uv) < NEAR
        off = soup.miss(case, segment, uv, eta)
        twice = pairs_within(1e-6, segment, soup.polished(case, segment, uv, eta))
        n, evaluations = roots.statuses.sum(), roots.evaluations
        cases += len(case.V)
        shares = ", ".join(
            f"{Status(k).name.lower()} {count / n:.2%}" for k, count in enumerate(roots.statuses) if count
        )
        mean = (evaluations * np.arange(len(evaluations))).sum() / n
        print(
            f"eta {eta}: {n} solves, {len(uv) / len(found):.4f} roots per case, {found.mean():.4%} found, "
            f"{twice} twice, "
            f"largest miss {off.max():.1e}; {shares}; {mean:.2f} evaluations"
        )
        assert found.mean() > 0.999
        # 1 and more: not lit, or from behind. At 5e-5 rad above the surface float32 once settles beside the root.
        assert off.max() < 1 and np.mean(off > 1e-3) <= 1e-5
        assert twice == 0
        assert (
            mean < 3 and roots.statuses[Status.OUT_OF_ITERATIONS] < 1e-3 * n and roots.statuses[Status.NON_FINITE] == 0
        )
    assert cases >= 1_000_000


def pairs_within(distance, segment, roots):
    """How many pairs of roots of the same case are that near to each other."""
    order = np.argsort(segment, kind="stable")
    segment, roots, count = segment[order], roots[order], 0
    for k in range(1, np.bincount(segment).max()):
        same = segment[k:] == segment[:-k]
        count += (norm(roots[k:] - roots[:-k])[same] < distance).sum()
    return count


@pytest.mark.parametrize("eta", build.slow_ones([0.6, 1.001, 1.5, 2.4], [0.6, 1.001, 2.4]))
def test_all_roots_of_a_triangle(rgb, eta):
    """Every root that Newton's method finds from 25 starts: folds, and several roots in one triangle."""
    case = soup.random_cases(np.random.default_rng(6), 60_000 if eta < 1 else 30_000, eta)
    index, uv = soup.every_root(case, eta, 5)
    segment, _, found = soup.solve(case, eta).all()
    apart = (np.bincount(index)[:, None] > 1).sum() - pairs_within(NEAR, index, uv)
    near = distance_to(index, uv, segment, found) < NEAR
    print(f"eta {eta}: {len(uv)} roots, {apart} triangles with several, apart; {near.mean():.4%} found")
    assert apart > 30
    assert near.mean() > 0.999

"""Both cullings lead to the same light paths, and to what brute force finds; one light point per segment."""

from dataclasses import replace

import build
import mitsuba as mi
import numpy as np
import oracle
import pytest
import soup
from comparison import l1
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from meshes import BoxTree, bumpy_sphere, make_patches, take
from pairs import chords, one_body, random_case

from mitsuba_refscatter.estimators import ESTIMATORS
from mitsuba_refscatter.optics import LocalLight

SAMPLES = {"interval_samples": 16, "point_samples": 16, "adapts": False}

SAME = 1e-3
"""Distance in (u, v) within which two roots are the same."""


def roots_for(mesh, eta, light, folder, culling, V):
    """Segment, triangle, (u, v) of all light paths to points V over facets that the light reaches (in float64)."""
    made = one_body(mesh, eta, light, folder, culling=culling, estimator="point")
    segments = soup.points_as_segments(V - made.body.centre)
    roots = soup.Roots()
    made.scatter(segments, estimator=roots)
    if not roots.found:
        return np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2))
    segment, tri, uv = roots.all()
    tri = tri - made.body.first_record
    P = oracle.light_ray(take(make_patches(mesh, eta), tri), uv, light, eta).point
    lit = BoxTree([mesh]).clear(P, np.broadcast_to(light, P.shape), tri)
    return segment[lit], tri[lit], uv[lit]


def without_partner(a, b):
    """How many of the paths ``a`` are not among ``b``."""
    known = {}
    for segment, tri, uv in zip(*b):
        known.setdefault((segment, tri), []).append(uv)
    return sum(
        min((np.abs(uv - x).max() for x in known.get((segment, tri), ())), default=1) > SAME
        for segment, tri, uv in zip(*a)
    )


def test_same_roots(rgb, tmp_path):
    """Random bodies, lights and points of segments: the same paths by beams and by spindles."""
    counts = np.zeros(3, int)

    @settings(max_examples=25, derandomize=True, deadline=None, database=None, phases=[Phase.generate],
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(st.integers(0, 2**32 - 1))
    def check(seed):
        mesh, eta, light, _, (o, d, t_max) = random_case(seed)
        t = np.random.default_rng(seed).uniform(0, 1, (len(o), 8)) * t_max[:, None]
        V = build.rounded((o[:, None] + t[..., None] * d[:, None]).reshape(-1, 3))
        beams, spindle = (roots_for(mesh, eta, light, tmp_path, culling, V) for culling in ("beams", "spindle"))
        counts[:] += len(beams[0]), without_partner(beams, spindle), without_partner(spindle, beams)

    check()
    print(f"{counts[0]} paths; by beams alone {counts[1]}, by spindles alone {counts[2]}")
    assert counts[0] > 10_000
    assert counts[1:].max() <= 1e-4 * counts[0]


LIGHTS = np.array([[-2.6, 2.4, -0.9], [1.7, 0.4, 2.2], [0.3, -1.6, 0.2]])


@pytest.fixture
def bumpy(rgb, tmp_path):
    """Segments in a bumpy sphere; per light the package's view of it by either culling."""
    mesh = bumpy_sphere(3, 0.12, 6.0)
    o, d, t_max = chords(mesh, np.random.default_rng(6), 300)

    def made(culling):
        return [
            one_body(mesh, 1.5, light, tmp_path, culling=culling, tolerance=0.0, accuracy=SAMPLES) for light in LIGHTS
        ]

    return made, (o, d, t_max)


def per_segment(lights, choice):
    """The illumination in which each segment has the light of its choice."""
    first = lights[0].illumination
    L = np.array([np.array(made.illumination.light.L)[:, 0] for made in lights])[choice]
    return replace(first, light=LocalLight(mi.Point3f(L.T)))


def summed(made, segments, illumination, estimator, **more):
    sums, _ = made.scatter(segments, illumination, ESTIMATORS[estimator], **more)
    return np.array(sums.value).T


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_one_light_point_per_segment(bumpy, estimator):
    """By spindles each segment may have its own light point: the same as each light alone by beams."""
    made, rays = bumpy
    beams, spindles = made("beams"), made("spindle")
    choice = np.random.default_rng(2).integers(0, len(LIGHTS), len(rays[0]))
    segments = spindles[0].segments(*rays)
    mixed = summed(spindles[0], segments, per_segment(spindles, choice), estimator)
    alone = np.array([summed(made, segments, made.illumination, estimator) for made in beams])
    expected = alone[choice, np.arange(len(choice))]
    assert expected.sum() > 0
    # Beams are cut into parts in advance, and intervals with them.
    error = l1(mixed, expected)
    print(f"{error:.1e}")
    assert error < (1e-3 if estimator == "interval" else 1e-4)


def test_beams_refuse_one_light_point_per_segment(bumpy):
    made, rays = bumpy
    beams = made("beams")
    segments = beams[0].segments(*rays)
    with pytest.raises(ValueError, match='culling "beams" is made for one light point.*use "spindle"'):
        summed(beams[0], segments, per_segment(beams, np.arange(len(rays[0])) % 3), "curve")

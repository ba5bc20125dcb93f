"""The light points that are drawn of areas and environments: evenly, all of them, others for neighbours and passes."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from against_volpath import WITHIN, colour, medium, to
from build import point_light

from mitsuba_refscatter import options
from mitsuba_refscatter.core import arrays
from mitsuba_refscatter.core.cache import Cache
from mitsuba_refscatter.core.sobol import Batch, Sequence
from mitsuba_refscatter.culling import CULLINGS
from mitsuba_refscatter.integrators.prepared import prepare
from mitsuba_refscatter.light import light_samples

pytestmark = pytest.mark.usefixtures("rgb")


@pytest.fixture
def prepared(rgb):
    """A box of fog below two panels, the second of three times the power, and a lamp."""

    def panel(x, radiance):
        return {"type": "rectangle", "to_world": to(("translate", [x, 4, 0]), ("rotate", [1, 0, 0], 90)),
                "emitter": {"type": "area", "radiance": colour(radiance, radiance, radiance)}}  # fmt: skip

    scene = mi.load_dict({
        "type": "scene", "a_medium": medium(), "a": panel(-2, 1.0), "b": panel(2, 3.0), "lamp": point_light((0, 9, 0)),
        "body": {"type": "cube", "bsdf": {"type": "null"}, "interior": WITHIN},
    })  # fmt: skip
    return prepare(scene, options.Options(light_samples=8), Cache(), lambda: 0)


def place(point):
    return np.array(point.L).ravel()


def pool(prepared, k, points=8, sequence=None):
    """The light points of pass ``k`` with as many samples of a pixel."""
    numbers, _ = (sequence or prepared.sequence).shared(points, Batch(k * points, points), 1)
    return [light_samples.at(prepared.scene.emitters, u, v) for u, v in numbers]


def test_pools_share_the_lights_by_their_power(prepared):
    """Each pool, to one point; all light points of a panel together fill it evenly."""
    drawn = [emitter for emitter in prepared.scene.emitters if emitter.drawn]
    assert len(drawn) == 2 and sum(light.share for light in drawn) == pytest.approx(1)
    few, many = sorted(light.share for light in drawn)
    assert 2 < many / few < 3.5  # a tenth of the points is shared out evenly
    where = {light.name: [] for light in drawn}
    for k in range(32):
        points = pool(prepared, k)
        for light in drawn:
            mine = [place(point) for other, point in points if other is light]
            assert abs(len(mine) - 8 * light.share) <= 1
            where[light.name] += mine
    for light, points in zip(drawn, map(np.array, where.values())):
        assert abs(len(points) - 256 * light.share) <= 1
        u = points[:, [0, 2]] - [np.round(points[:, 0].mean()), 0]  # in [-1, 1]
        cells = np.histogram2d(*u.T, bins=4, range=[[-1, 1]] * 2)[0]
        # Random points have a chi-square of 15 in 16 cells, and one below 5 in less than one of 100 cases.
        expected = len(points) / 16
        assert ((cells - expected) ** 2 / expected).sum() < 5
        assert np.abs((u**2).mean(axis=0) - 1 / 3).max() < 0.015


def test_another_pool_for_the_next_pass(prepared):
    first, second = (pool(prepared, k) for k in range(2))
    assert len({tuple(place(point)) for _, point in first + second}) == 16
    again, other = (pool(prepared, 0, sequence=Sequence(seed)) for seed in (prepared.sequence.seed, 7))
    assert [tuple(place(p)) for _, p in again] == [tuple(place(p)) for _, p in first]
    assert [tuple(place(p)) for _, p in other] != [tuple(place(p)) for _, p in first]


def shares(prepared, n, batch):
    """The ``LightShare``s of ``n`` camera samples."""
    shared = prepared.light_samples if prepared.culling.for_one_light else 0
    return light_samples.shares(prepared.scene.emitters, prepared.sequence, shared, batch, n, mi.Color0f())


def slots(turns, n):
    """Which of the turns each camera sample takes part in (n, turns)."""
    return np.array([np.ones(n, bool) if t.slot is None else t.slot.numpy() != arrays.NONE for t in turns]).T


def test_neighbours_take_different_points(prepared):
    """The lamp is for all; of the pool each of eight consecutive pixels takes a point of its own, in another order
    than the next eight, in the next pass a further one."""
    n = 8 * 40
    taken, later = (slots(shares(prepared, n, Batch(k, 1)), n) for k in range(2))
    assert taken[:, 0].all() and (taken[:, 1:].sum(axis=1) == 1).all()
    chosen = taken[:, 1:].argmax(axis=1).reshape(-1, 8)
    assert (np.sort(chosen, axis=1) == np.arange(8)).all()
    assert len(np.unique(chosen[:, 0])) == 8
    assert (taken == later).all()  # of another pool


def test_samples_of_a_pixel_take_different_points(prepared):
    """With as many light points as samples all; with fewer consecutive ones the same."""
    n = 8 * 40
    chosen = slots(shares(prepared, n, Batch(0, 8)), n)[:, 1:].argmax(axis=1).reshape(-1, 8)
    assert (chosen == np.arange(8)).all()
    turns = shares(prepared, 4 * n, Batch(0, 32))
    assert len(turns) == 1 + 8
    chosen = slots(turns, 4 * n)[:, 1:].argmax(axis=1).reshape(-1, 32)
    assert (chosen == np.arange(32) // 4).all()


def test_each_sample_has_a_point_of_its_own(prepared):
    prepared.culling, n = CULLINGS["spindle"], 1000
    turns = shares(prepared, n, Batch(3, 1))
    taken = slots(turns, n)
    assert taken[:, 0].all() and (taken[:, 1:].sum(axis=1) == 1).all()
    places = np.concatenate([np.array(turn.sample.L).T for turn in turns[1:]])
    assert len(np.unique(places, axis=0)) == n
    found = taken[:, 1:].mean(axis=0)
    expected = [turn.emitter.share for turn in turns[1:]]
    assert np.abs(found - expected).max() < 4 * 0.5 / n**0.5
    for turn in turns[1:]:
        slot = turn.slot.numpy()
        lanes = slot[slot != arrays.NONE]
        assert (np.sort(lanes) == np.arange(dr.width(turn.sample.L))).all()

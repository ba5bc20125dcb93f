"""Camera segments that go through a tree together find what each finds alone; meshes are read once."""

import build
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from meshes import bumpy_sphere
from pairs import chords, one_body

from mitsuba_refscatter import tolerances
from mitsuba_refscatter.core.cache import Cache, fingerprint
from mitsuba_refscatter.culling import beams, bundles

LIGHT = np.array([-2.6, 2.4, -0.9])


def neighbours(mesh, rng, spacing):
    """Chords of a body, each followed by three others that start and run beside it."""
    o, d, t_max = (np.repeat(x, 4, axis=0) for x in chords(mesh, rng, 60))
    d = d + spacing * rng.normal(size=d.shape)
    return (
        build.rounded(o + 0.3 * spacing * rng.normal(size=o.shape)),
        build.rounded(d / np.linalg.norm(d, axis=1)[:, None]),
        t_max,
    )


@pytest.mark.parametrize("spacing", [1e-4, 1e-2, 0.1])
def test_bundles_find_what_segments_find(rgb, tmp_path, monkeypatch, spacing):
    mesh, rng = bumpy_sphere(3, 0.12, 6.0), np.random.default_rng(3)
    culling = one_body(mesh, 1.5, LIGHT, tmp_path)
    rays = tuple(x[:-1] for x in neighbours(mesh, rng, spacing))  # the last bundle is not full

    def scattered():
        sums, counts = culling.scatter(culling.segments(*rays))
        return np.array(sums.value), counts.leaves

    together, leaves = scattered()
    monkeypatch.setattr(beams.Beams, "bundle", 1)
    alone, more_leaves = scattered()
    assert alone.max() > 0
    np.testing.assert_allclose(together, alone, rtol=1e-5, atol=1e-6 * alone.max())
    if spacing < 1e-3:
        assert leaves < 0.4 * more_leaves


def test_segments_far_apart_are_not_bundled(rgb, tmp_path):
    mesh, rng = bumpy_sphere(2), np.random.default_rng(4)
    culling = one_body(mesh, 1.5, LIGHT, tmp_path)
    near, far = neighbours(mesh, rng, 1e-4), chords(mesh, rng, 9)
    segments = culling.segments(*(np.concatenate(pair) for pair in zip(near, far)))
    made = bundles.bundles_of(segments, 4, 0.1)
    first, count = np.array(made.first), np.array(made.count)
    covered = np.concatenate([np.arange(f, f + c) for f, c in zip(first, count)])
    assert sorted(covered) == list(range(len(segments)))
    assert (count[first < 240] == 4).mean() > 0.8 and (count[first >= 240] == 1).all()


def test_leaves_hold_places_of_the_order(rgb):
    """Beams of the same four places of the order share a leaf, also where some are cut and some are missing."""
    place, parent = mi.UInt32([0, 1, 3, 9, 10, 12]), mi.UInt32([0, 1, 2, 3, 3, 3, 3, 4, 5])
    code = level = dr.zeros(mi.UInt32, 9)
    parent, _, _, holds = beams._in_leaves(place, parent, code, level)
    cells = np.array(place)[np.array(parent)] // 4
    holds = np.array(holds)
    assert len(holds) == 16 and holds.sum() == 9
    assert [set(cells[4 * k : 4 * k + 4][holds[4 * k : 4 * k + 4]]) for k in range(4)] == [{0}, {2}, {2}, {3}]


def test_kept_things_are_made_once_and_dropped():
    made, cache = [], Cache()

    def get(key):
        return cache.once(lambda: made.append(key) or key, key)

    for keys in (["a", "b"], ["a"], ["a"], ["b"]):
        cache.next_round()
        assert [get(key) for key in keys] == keys
    assert made == ["a", "b", "b"]


def test_fingerprints_differ(rgb):
    base = np.arange(1000, dtype=np.float32)
    prints = {fingerprint(mi.Float(base))}
    for change in (base + 1e-3, base[::-1].copy(), np.roll(base, 1), base[:-1]):
        prints.add(fingerprint(mi.Float(change)))
    assert len(prints) == 5 and fingerprint(mi.Float(base)) in prints


def test_a_changed_mesh_is_read_anew(rgb, tmp_path):
    """One integrator, a mesh that is changed between two renders, and then a second scene."""
    shape = {**build.mesh_shape(bumpy_sphere(2), tmp_path / "mesh.ply"), "id": "body"}
    parts = {"type": "scene", "body": shape, "light": build.point_light(LIGHT)}
    o, d = build.rays_at((0.0, 1.1, 5.2), 0.6, 40, seed=7)

    def render(scene, integrator):
        ray = mi.Ray3f(*(kind(x.astype(np.float32).T) for kind, x in ((mi.Point3f, o), (mi.Vector3f, d))))
        return np.array(integrator.sample(scene, mi.load_dict({"type": "independent"}), ray)[0])

    def fresh():
        return mi.load_dict({"type": "refscatter", "surfaces": False})

    one, scene = fresh(), mi.load_dict(parts)
    before = render(scene, one)
    parameters = mi.traverse(scene)
    parameters["body.vertex_positions"] = 0.8 * mi.Float(parameters["body.vertex_positions"])
    parameters.update()
    after, other = render(scene, one), render(mi.load_dict(parts), one)
    np.testing.assert_allclose(after, render(scene, fresh()), rtol=1e-5)
    np.testing.assert_allclose(other, before, rtol=1e-5)
    assert np.abs(after - before).max() > 0.1 * before.max()


@pytest.mark.parametrize("count", [200, 800])
def test_memory_follows_the_buffer_not_the_work(rgb, tmp_path, monkeypatch, count):
    """The half GiB that is said of the full buffer, in proportion, and little per camera segment: 800 have 25 times
    as many pairs as the small buffer has places."""
    mesh, most, places = bumpy_sphere(3, 0.12, 6.0), (1 << 29) / tolerances.CHUNK_PAIRS, 1 << 11
    culling = one_body(mesh, 1.5, LIGHT, tmp_path)
    segments = culling.segments(*chords(mesh, np.random.default_rng(3), count))
    monkeypatch.setattr(tolerances, "PIECES", tolerances.PIECES * places // tolerances.CHUNK_PAIRS)
    monkeypatch.setattr(tolerances, "CHUNK_PAIRS", places)
    backend = dr.backend_v(mi.Float)

    def leaves():
        sums, counts = culling.scatter(segments)
        dr.eval(sums.value)
        dr.sync_thread()
        return counts.leaves

    assert leaves() > 50 * count
    dr.flush_malloc_cache()
    dr.detail.malloc_clear_statistics()
    before = dr.detail.malloc_watermark(backend)
    leaves()
    used = dr.detail.malloc_watermark(backend) - before
    print(f"{used / places:.0f} bytes per place")
    assert 8 * places < used < most * places + 256 * count

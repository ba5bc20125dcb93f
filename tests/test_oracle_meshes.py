"""The meshes and the ray tracer that the oracle stands on."""

import meshes
import numpy as np
import pytest
from meshes import BoxTree, Mesh, bumpy_sphere, dot, icosphere, unit


@pytest.mark.parametrize("mesh", [icosphere(3), bumpy_sphere(5, 0.1), meshes.box([0] * 3, [1] * 3)])
def test_meshes_are_closed_and_wound_outward(mesh):
    edges = list(map(tuple, np.concatenate([mesh.faces[:, [k, (k + 1) % 3]] for k in range(3)])))
    assert len(set(edges)) == len(edges) and {(b, a) for a, b in edges} == set(edges)
    p = mesh.corners
    assert dot(p[:, 0], np.cross(p[:, 1], p[:, 2])).sum() > 0
    if mesh.normals is not None:
        assert dot(mesh.normals[mesh.faces], mesh.facet_normals[:, None]).min() > 0.99


def test_box_tree_finds_the_hits_of_a_plain_loop():
    rng = np.random.default_rng(0)
    parts = [bumpy_sphere(2, 0.2), Mesh(icosphere(1).vertices + [2, 0, 0], icosphere(1).faces)]
    tree, p = BoxTree(parts), np.concatenate([m.corners for m in parts])
    o, d = rng.normal(size=(500, 3)), unit(rng.normal(size=(500, 3)))
    d[:3] = np.eye(3)
    length, skip = rng.uniform(0.5, 4, 500), rng.integers(-1, len(p), 500)
    ray, tri, tuv = tree.hits(o, d, length, skip)
    a = p[None] - o[:, None, None]
    volume = np.array([dot(np.cross(a[:, :, i], a[:, :, j]), d[:, None])[..., 0] for i, j in ((0, 1), (1, 2), (2, 0))])
    normals = np.concatenate([m.facet_normals for m in parts])
    slope = d @ normals.T
    t = dot(a[:, :, 0], normals)[..., 0] / np.where(slope == 0, 1e-300, slope)
    crossed = ((volume > 0).all(0) | (volume < 0).all(0)) & (t > 0) & (t < length[:, None])
    crossed[np.arange(500), skip] &= skip < 0
    assert len(ray) > 200 and sorted(zip(ray, tri)) == sorted(zip(*np.nonzero(crossed)))
    weights = np.column_stack([1 - tuv[:, 1:].sum(1), tuv[:, 1:]])
    point = np.einsum("nk,nkx->nx", weights, p[tri])
    assert np.allclose(tuv[:, 0], t[ray, tri], atol=1e-12)
    assert np.allclose(point, o[ray] + tuv[:, :1] * d[ray], atol=1e-12)

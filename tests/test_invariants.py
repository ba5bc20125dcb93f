"""What holds for any body, light, camera and option: finite, not negative, linear in the light, the same when all
is moved."""

import build
import mitsuba as mi
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from meshes import Mesh
from pairs import cut_box, wavy

RAYS = 200
SETTINGS = {"deadline": None, "suppress_health_check": list(HealthCheck), "phases": [Phase.explicit, Phase.generate]}

bodies = st.one_of(
    st.tuples(
        st.just("wavy"),
        st.integers(0, 3),
        st.sampled_from([0.0, 0.05, 0.3]),
        st.sampled_from([1.0, 3.0]),
        st.booleans(),
    ),
    st.tuples(st.just("box"), st.integers(0, 2)),
)
options = st.sampled_from([
    {}, {"tolerance": 0.1}, {"tolerance": 0.0}, {"culling": "spindle"}, {"estimator": "interval", "culling": "spindle"},
    {"estimator": "point", "culling": "spindle", "samples": 4},
])  # fmt: skip


def mesh_of(body, rng):
    mesh = wavy(rng, *body[1:]) if body[0] == "wavy" else cut_box(rng, body[1])
    return Mesh(build.rounded(mesh.vertices), mesh.faces, mesh.normals)


SCENES = {
    "body": bodies,
    "seed": st.integers(0, 2**32 - 1),
    "eta": st.sampled_from([0.4, 0.75, 0.999, 1.0, 1.0001, 1.33, 1.5, 2.5]),
    "density": st.sampled_from([0.0, 1e-6, 0.5, 20.0, 1e4]),
    "albedo": st.sampled_from([0.0, 0.5, 1.0]),
    "g": st.sampled_from([None, -0.99, 0.5, 0.99]),
    "far": st.sampled_from([1.05, 1.5, 4.0, 1e3]),
    "option": options,
    "bounces": st.integers(0, 3),
}


@settings(max_examples=8, derandomize=True, **SETTINGS)
@given(**SCENES)
def test_any_scene(tmp_path_factory, **scene):
    check(tmp_path_factory.mktemp("any"), **scene)


@pytest.mark.slow
@settings(max_examples=300, print_blob=True, **SETTINGS)
@given(**SCENES)
def test_any_scene_at_length(tmp_path_factory, **scene):
    check(tmp_path_factory.mktemp("any"), **scene)


def check(folder, *, body, seed, eta, density, albedo, g, far, option, bounces):
    from mitsuba_refscatter import platform

    mi.set_variant(platform.default_variant())
    rng = np.random.default_rng(seed)
    mesh = mesh_of(body, rng)
    centre = mesh.vertices.mean(0)
    size = np.linalg.norm(mesh.vertices - centre, axis=1).max()
    way = rng.normal(size=3)
    light = centre + far * size * way / np.linalg.norm(way)
    eye = rng.normal(size=3)
    o = np.tile(centre + 3 * size * eye / np.linalg.norm(eye), (RAYS, 1))
    d = centre + rng.uniform(-0.6, 0.6, (RAYS, 3)) * size - o
    d /= np.linalg.norm(d, axis=1, keepdims=True)

    def radiance(intensity):
        shape = build.mesh_shape(mesh, folder / "m.ply", eta, (1.0, 0.5, 0.1), (albedo,) * 3, g)
        shape["interior"]["scale"] = density / size
        scene = mi.load_dict({"type": "scene", "body": shape, "light": build.point_light(light, (intensity,) * 3)})
        return build.single_scattering(scene, o, d, internal_bounces=bounces, **option)

    one, four = radiance(1.0), radiance(4.0)
    for found in (one, four):
        assert np.isfinite(found).all() and (found >= 0).all()
    assert np.abs(four - 4 * one).sum() <= 1e-5 * four.sum()
    assert radiance(0.0).sum() == 0
    if albedo == 0 or density == 0:
        assert one.sum() == 0
    elif eta >= 0.999 and density <= 20:  # else light may be reflected totally, or absorbed on the lit side
        assert one.sum() > 0

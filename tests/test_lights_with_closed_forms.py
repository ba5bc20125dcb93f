"""Lights and places for which there is a closed form or the float64 oracle; against volpath:
test_scene_kinds_against_volpath.py."""

import build
import closed_forms
import mitsuba as mi
import numpy as np
import oracle
import pytest
import references
from against_volpath import colour, glass, to
from comparison import bias
from meshes import Mesh, box, bumpy_sphere
from test_rays_against_oracle_and_formulas import body_of

pytestmark = pytest.mark.usefixtures("rgb")

CAMERA, FAR = (0.0, 1.1, 5.2), 1e7


def sigma():
    """sigma_s and sigma_t of the test medium."""
    sigma_t = np.array(build.SIGMA_T)
    return sigma_t * build.ALBEDO, sigma_t


def amber(g=None):
    phase = {"type": "isotropic"} if g is None else {"type": "hg", "g": g}
    return {"type": "homogeneous", "id": "amber", "phase": phase, "sigma_t": colour(*build.SIGMA_T),
            "albedo": colour(*build.ALBEDO)}  # fmt: skip


def error(ours, truth):
    return np.abs(ours - truth).sum(axis=1) / truth.sum(axis=1)


# ---- Spots and directional lights through a refracting boundary -------------------------------


def spot(origin, target, beam_width, cutoff):
    """A spot of radiant intensity 10, and that intensity as a function of directions, as Mitsuba documents it: even
    up to the beam's width, then linear in the angle down to the cutoff."""
    shape = {
        "type": "spot",
        "intensity": colour(10, 10, 10),
        "beam_width": beam_width,
        "cutoff_angle": cutoff,
        "to_world": mi.ScalarTransform4f().look_at(origin=list(origin), target=list(target), up=[0, 1, 0]),
    }
    axis = np.subtract(target, origin) / np.linalg.norm(np.subtract(target, origin))

    def intensity(direction):
        angle = np.degrees(np.arccos(np.clip(direction @ axis, -1, 1)))
        return 10 * np.clip((cutoff - angle) / (cutoff - beam_width), 0, 1)[..., None]

    return shape, intensity


def kept(name, bodies, light, o, d, bounces):
    """The oracle's radiance, as it is kept."""
    place, intensity = light
    described = [bodies, place, o, d, bounces, intensity(np.eye(3)) if callable(intensity) else intensity]
    return references.array(
        f"oracle {name}", described, lambda: oracle.camera_radiance(bodies, [light], o, d, bounces, subdivisions=6)
    )


@pytest.mark.parametrize("eta", [1.5, 0.8])
def test_spot(tmp_path, eta):
    """A spot that lights a part of a bumpy body, its rim soft, against the oracle."""
    mesh, origin = build.rounded_mesh(bumpy_sphere(2)), (-2.6, 2.4, -0.9)
    lamp, intensity = spot(origin, (0.1, 0.2, 0.1), 6.0, 14.0)
    shape = build.mesh_shape(mesh, tmp_path / "m.ply", eta=eta)
    o, d = build.rays_at(CAMERA, 0.6, 100, seed=6)
    scene = mi.load_dict({"type": "scene", "body": shape, "lamp": lamp})
    ours = build.single_scattering(scene, o, d, internal_bounces=0, tolerance=1e-3)
    light = (np.array(origin), intensity)
    truth = kept(f"spot eta {eta}", [body_of(mesh, eta)], light, o, d, 0)
    seen = truth.sum(axis=1) > 0.1 * truth.sum(axis=1).max()
    assert np.median(error(ours[seen], truth[seen])) < 1e-3
    assert abs(bias(ours, truth)) < 1e-3


@pytest.mark.parametrize("eta", [1.5, 0.8])
def test_directional(tmp_path, eta):
    """A light in one direction is, for the oracle, a point at a distance of 10,000,000."""
    mesh, to_light = (
        build.rounded_mesh(bumpy_sphere(2)),
        np.array([-0.6, 0.7, -0.3]) / np.linalg.norm([-0.6, 0.7, -0.3]),
    )
    sun = {"type": "directional", "direction": list(-to_light), "irradiance": colour(2, 2, 2)}
    shape = build.mesh_shape(mesh, tmp_path / "m.ply", eta=eta)
    o, d = build.rays_at(CAMERA, 0.8, 100, seed=7)
    scene = mi.load_dict({"type": "scene", "body": shape, "sun": sun})
    ours = build.single_scattering(scene, o, d, internal_bounces=0, tolerance=1e-3)
    far = (FAR * to_light, np.full(3, 2 * FAR**2))
    truth = kept(f"directional eta {eta}", [body_of(mesh, eta)], far, o, d, 0)
    lit = truth.sum(axis=1) > 0
    assert np.median(error(ours[lit], truth[lit])) < 1e-3
    assert abs(bias(ours, truth)) < 1e-3


# ---- Light that comes straight ----------------------------------------------------------------


def fog(phase_g, light):
    """A scene of a point light in a medium without boundaries, and its medium."""
    film = {"type": "hdrfilm", "width": 4, "height": 4}
    sensor = {"type": "perspective", "medium": {"type": "ref", "id": "amber"}, "film": film}
    scene = mi.load_dict({"type": "scene", "a": amber(phase_g), "sensor": sensor, "light": build.point_light(light)})
    return scene, scene.sensors()[0].get_medium()


def rays_around(light, origin):
    """200 rays in all directions, some of them close by the light."""
    o, rng = np.tile(origin, (200, 1)), np.random.default_rng(8)
    d = rng.normal(size=(200, 3))
    d[:40] = light - o[:40] + 10.0 ** rng.uniform(-4, -1, (40, 1)) * d[:40]  # misses it by 1e-4 to 0.1
    return build.rounded(o), build.rounded(d / np.linalg.norm(d, axis=1, keepdims=True))


@pytest.mark.parametrize("g", [None, 0.9, -0.7])
def test_airlight(g):
    """Camera and light in one unbounded medium: rays towards and away from the light, and close by it."""
    light = np.array([0.5, -0.3, 2.0])
    o, d = rays_around(light, (0.0, 0.2, -1.0))
    scene, medium = fog(g, light)
    ours = build.single_scattering(scene, o, d, medium=medium, tolerance=1e-3)
    # ours starts at a float32 d, which is a unit vector to 1e-7
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    medium, rays = oracle.Medium(*sigma(), g or 0.0), oracle.CameraRays(o, d, np.full(200, 60.0))
    truth = closed_forms.airlight_radiance(medium, (light, np.full(3, 10.0)), rays)
    assert error(ours, truth).max() < 1e-3


def test_airlight_in_glass():
    """Camera and light in a cube of glass. Past the light rays see it so close that the variance of volpath is
    infinite."""
    light = np.array([0.2, 0.1, 0.0])
    o, d = rays_around(light, (0.0, 0.2, 0.9))
    sensor = {"type": "perspective", "medium": {"type": "ref", "id": "amber"}}
    cube = {"type": "cube", "bsdf": glass(1.3), "interior": {"type": "ref", "id": "amber"}}
    scene = mi.load_dict(
        {"type": "scene", "a": amber(), "sensor": sensor, "cube": cube, "light": build.point_light(light)}
    )
    medium = scene.sensors()[0].get_medium()
    ours = build.single_scattering(scene, o, d, medium=medium, internal_bounces=0, tolerance=1e-3)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    ends = ((np.sign(d) - o) / d).min(axis=1)
    rays = oracle.CameraRays(o, d, ends)
    truth = closed_forms.airlight_radiance(oracle.Medium(*sigma(), 0.0), (light, np.full(3, 10.0)), rays)
    assert error(ours, truth).max() < 1e-3


@pytest.mark.parametrize("bsdf", ["null", "dielectric"])
def test_light_in_an_index_matched_body(tmp_path, bsdf):
    """What a null boundary and a dielectric of index 1 around a light do: they end the medium."""
    mesh, light = build.rounded_mesh(box([-0.9, -0.8, -1], [0.9, 0.8, 1])), np.array([0.2, 0.3, -0.1])
    shape = build.mesh_shape(mesh, tmp_path / "m.ply", eta=1.0, g=0.5)
    if bsdf == "null":
        shape["bsdf"] = {"type": "null"}
    o, d = build.rays_at(CAMERA, 0.8, 200, seed=9)
    scene = mi.load_dict({"type": "scene", "body": shape, "light": build.point_light(light)})
    ours = build.single_scattering(scene, o, d, tolerance=1e-3)
    body = body_of(mesh, 1.0, 0.5)
    legs = oracle.camera_segments([body], o, d, 0)
    assert (legs.ray == np.arange(200)).all()
    truth = legs.weight * closed_forms.airlight_radiance(body, (light, np.full(3, 10.0)), legs)
    assert error(ours, truth).max() < 1e-3


# ---- Open surfaces ----------------------------------------------------------------------------


@pytest.mark.parametrize("eta", [1.33, 1.7])
def test_under_water(eta):
    """A plane of two triangles with the medium below, the camera in it, against the formula for a plane; rays down,
    which never end, and up, which end at the surface."""
    light, size = np.array([0.3, -0.2, 2.0]), 40.0
    water = {"type": "rectangle", "to_world": to(("scale", size)), "bsdf": glass(eta), "interior": amber()}
    sensor = {"type": "perspective", "medium": {"type": "ref", "id": "amber"}}
    scene = mi.load_dict({"type": "scene", "water": water, "light": build.point_light(light), "sensor": sensor})
    o = build.rounded(np.tile([1.0, -3.0, -2.5], (300, 1)))
    d = np.concatenate([np.zeros((300, 2)) - o[:, :2], np.zeros((300, 1))], axis=1)
    d = d + np.random.default_rng(3).uniform(-1.5, 1.5, (300, 3))
    d = build.rounded(d / np.linalg.norm(d, axis=1, keepdims=True))
    ours = build.single_scattering(
        scene, o, d, medium=scene.sensors()[0].get_medium(), internal_bounces=0, tolerance=1e-4
    )
    up = d[:, 2] > 0
    t_max = np.where(up, -o[:, 2] / np.where(up, d[:, 2], 1), 60.0)
    assert 50 < up.sum() < 250
    water, rays = oracle.Medium(*sigma(), 0.0), oracle.CameraRays(o, d, t_max)
    truth = closed_forms.plane_radiance(eta, water, (light, np.full(3, 10.0)), rays, steps=256)
    assert error(ours, truth).max() < 1e-3


def test_a_hole_is_an_open_surface(tmp_path):
    """A closed body with some triangles missing, on the side that is neither lit nor seen: nothing else changes, as
    rays end there. On the lit side, light that would come through the missing triangles is missing."""
    mesh = build.rounded_mesh(bumpy_sphere(2))
    centre = mesh.corners.mean(axis=1)
    light, o, d = (0.0, 4.0, 3.0), *build.rays_at(CAMERA, 0.5, 200, seed=10)

    def image(kept, name):
        part = Mesh(mesh.vertices, mesh.faces[kept], mesh.normals)
        shape = build.mesh_shape(part, tmp_path / f"{name}.ply")
        scene = mi.load_dict({"type": "scene", "body": shape, "light": build.point_light(light)})
        return build.single_scattering(scene, o, d, internal_bounces=0, tolerance=1e-3)

    whole = image(np.full(len(centre), True), "whole")
    lit = np.linalg.norm(centre - [0, 0.8, 0.6], axis=1) < 0.3
    assert lit.sum() > 3
    assert image(~lit, "lit").sum() < 0.9 * whole.sum()


# ---- Which side is inside ----------------------------------------------------------------------


@pytest.mark.parametrize("change", ["mirrored", "flipped", "both"])
def test_inside_is_what_a_body_encloses(tmp_path, change):
    """A mirrored transform turns the triangles' winding, and ``flip_normals`` the normals: the image is that of the
    same body given as it is."""
    mesh, light = build.rounded_mesh(bumpy_sphere(2)), (-2.6, 2.4, -0.9)
    o, d = build.rays_at(CAMERA, 0.8, 100, seed=11)
    mirrored = change != "flipped"
    given = Mesh(mesh.vertices * [-1, 1, 1], mesh.faces[:, ::-1], mesh.normals * [-1, 1, 1]) if mirrored else mesh
    more = {"flip_normals": change != "mirrored", "to_world": to(("scale", [-1 if mirrored else 1, 1, 1]))}
    images = []
    for part, extra in ((mesh, {}), (given, more)):
        shape = build.mesh_shape(part, tmp_path / "m.ply", **extra)
        scene = mi.load_dict({"type": "scene", "body": shape, "light": build.point_light(light)})
        images.append(build.single_scattering(scene, o, d))
    assert images[0].mean() > 0
    np.testing.assert_allclose(images[1], images[0], rtol=1e-3, atol=1e-4 * images[0].mean())


# ---- Bodies that touch, and bodies in bodies ----------------------------------------------------


def test_bodies_that_touch(tmp_path):
    """Two glued halves of an index-matched box, each with a boundary of its own on the common face, are the box."""
    light, (o, d) = np.array([0.3, 2.5, 0.4]), build.rays_at(CAMERA, 0.6, 200, seed=12)
    low, high = np.array([-1.0, -0.8, -0.9]), np.array([1.0, 0.8, 0.9])
    middle_high, middle_low = high * [0, 1, 1], low * [0, 1, 1]
    whole, left, right = box(low, high), box(low, middle_high), box(middle_low, high)
    images = []
    for parts in ((whole,), (left, right)):
        shapes = {
            f"part{k}": build.mesh_shape(part, tmp_path / f"{len(parts)}{k}.ply", eta=1.0)
            for k, part in enumerate(parts)
        }
        for shape in shapes.values():
            shape["bsdf"] = {"type": "null"}
        scene = mi.load_dict({"type": "scene", **shapes, "light": build.point_light(light)}, optimize=False)
        images.append(build.single_scattering(scene, o, d, tolerance=1e-3))
    assert images[0].mean() > 0
    assert error(images[1], images[0]).max() < 2e-3


def test_hollow_shell(tmp_path):
    """A glass sphere with a spherical cavity, one mesh of two parts, against the oracle."""
    outer, inner = build.rounded_mesh(bumpy_sphere(2)), build.rounded_mesh(bumpy_sphere(1))
    count = len(outer.vertices)
    shell = Mesh(
        np.concatenate([outer.vertices, 0.5 * inner.vertices]),
        np.concatenate([outer.faces, count + inner.faces[:, ::-1]]),
        np.concatenate([outer.normals, -inner.normals]),
    )
    shell = build.rounded_mesh(shell)
    light, (o, d) = (-2.6, 2.4, -0.9), build.rays_at(CAMERA, 0.9, 150, seed=13)
    shape = build.mesh_shape(shell, tmp_path / "m.ply", eta=1.3)
    scene = mi.load_dict({"type": "scene", "body": shape, "light": build.point_light(light)})
    ours = build.single_scattering(scene, o, d, internal_bounces=1, tolerance=1e-3)
    truth = kept("hollow shell", [body_of(shell, 1.3)], (np.array(light), np.full(3, 10.0)), o, d, 1)
    some = truth.sum(axis=1) > 0.01 * truth.sum(axis=1).mean()
    assert np.median(error(ours[some], truth[some])) < 2e-3
    assert abs(bias(ours, truth)) < 3e-3


def test_every_variant_takes_every_light(variant):
    """What lights send in a colour's wavelengths or in grey: a grey scene is the same in all variants."""
    if not (mi.is_spectral or mi.is_monochromatic):
        pytest.skip("the variant that the others are compared with")
    current = mi.variant()

    def image(name):
        mi.set_variant(name)
        grey = lambda x: {"type": "rgb", "value": [x] * 3}  # noqa: E731
        up = mi.ScalarTransform4f().look_at(origin=[0.5, 4, 1], target=[0.1, 0, 0], up=[1, 0, 0])
        # In several threads Mitsuba 3.9.1 ended in std::bad_array_new_length once.
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "refscatter", "surfaces": False, "culling": "spindle"},
                "sensor": {
                    "type": "perspective",
                    "to_world": mi.ScalarTransform4f().look_at([0, 1, 5], [0, 0, 0], [0, 1, 0]),
                    "fov": 30,
                    "film": {
                        "type": "hdrfilm",
                        "width": 16,
                        "height": 16,
                        "rfilter": {"type": "box"},
                        "pixel_format": "luminance",
                    },
                },
                "spot": {"type": "spot", "to_world": up, "cutoff_angle": 16.0, "intensity": grey(30.0)},
                "sun": {"type": "directional", "direction": [-0.4, -1, -0.6], "irradiance": grey(1.0)},
                "sky": {"type": "constant", "radiance": grey(0.3)},
                "panel": {
                    "type": "rectangle",
                    "to_world": to(("translate", [0, 3, 0]), ("rotate", [1, 0, 0], 90)),
                    "emitter": {"type": "area", "radiance": grey(2.0)},
                },
                "body": {
                    "type": "cube",
                    "bsdf": glass(1.3, specular_transmittance=grey(0.8)),
                    "interior": {
                        "type": "homogeneous",
                        "sigma_t": grey(0.5),
                        "albedo": grey(0.8),
                        "phase": {"type": "rayleigh"},
                    },
                },
            },
            parallel=False,
        )
        return np.array(mi.render(scene, spp=64))

    ours, rgb = image(current), image("llvm_ad_rgb")
    # A white of 1 in a spectral variant is D65's, whose luminance is 1 but for the film's own integration.
    assert abs(ours.mean() / rgb.mean() - 1) < 0.02

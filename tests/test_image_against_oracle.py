"""A scene that nothing was tuned on: two concave bodies, scaled and mirrored transforms, two lights, two media, a
gaussian filter, a crop window, 4 samples a pixel; the whole image against the float64 oracle."""

import build
import mitsuba as mi
import numpy as np
import oracle
import references
from meshes import Mesh

from mitsuba_refscatter.example_scenes import make_body

LIGHTS = [((-2.2, 2.9, 1.4), (30.0, 24.0, 18.0)), ((2.7, 1.1, -2.4), (9.0, 14.0, 25.0))]
MEDIA = [  # eta, sigma_t, albedo, g
    (1.45, (0.5, 0.9, 0.8), (0.9, 0.6, 0.3), 0.35),
    (1.7, (0.7, 0.3, 0.2), (0.4, 0.8, 0.9), None),
]


def sensor_dict():
    return {
        "type": "thinlens", "fov": 38, "aperture_radius": 0.03, "focus_distance": 5.0,
        "to_world": mi.ScalarTransform4f().look_at([0.6, 1.4, 5.0], [0.05, 0, 0], [0, 1, 0]),
        "sampler": {"type": "multijitter", "sample_count": 4},
        "film": {"type": "hdrfilm", "width": 60, "height": 48, "crop_offset_x": 15, "crop_offset_y": 14,
                 "crop_width": 14, "crop_height": 9, "component_format": "float32", "rfilter": {"type": "gaussian"}},
    }  # fmt: skip


def scene_dict(tmp_path):
    T = mi.ScalarTransform4f
    transforms = [
        T().translate([-0.95, 0.1, 0.2]).rotate([0.3, 1, 0.2], 40).scale([-0.8, 0.9, 0.7]),
        T().translate([0.95, -0.15, -0.3]).rotate([1, 0.1, 0.4], -70).scale([0.85, 0.55, -0.75]),
    ]
    scene = {"type": "scene", "sensor": sensor_dict()}
    for k, (name, triangles) in enumerate((("bumpy_sphere", 1280), ("rounded_cube", 2000))):
        eta, sigma_t, albedo, g = MEDIA[k]
        mesh, path = Mesh(*make_body(name, triangles)), tmp_path / f"{k}.ply"
        scene[f"body{k}"] = build.mesh_shape(mesh, path, eta, sigma_t, albedo, g, to_world=transforms[k])
    for k, (position, intensity) in enumerate(LIGHTS):
        scene[f"light{k}"] = build.point_light(position, intensity)
    return scene


def oracle_bodies(scene):
    """The bodies in world space as Mitsuba has them; both transforms mirror, which turns the winding."""
    bodies = []
    for shape in scene.shapes():  # in any order
        eta, sigma_t, albedo, g = MEDIA[int(shape.id()[-1])]
        parameters = mi.traverse(shape)
        vertices, normals = (
            np.array(parameters[f"vertex_{x}"], float).reshape(-1, 3) for x in ("positions", "normals")
        )
        faces = np.array(parameters["faces"], int).reshape(-1, 3)[:, ::-1]
        sigma_t = np.array(sigma_t)
        bodies.append(oracle.Body(Mesh(vertices, faces, normals), eta, sigma_t * albedo, sigma_t, g or 0.0))
    return bodies


def rays(scene, seed):
    """Places on the film (Point2f), weights, and rays (n, 6) of the sensor as ``refscatter`` draws them."""
    sensor = scene.sensors()[0]
    film, sampler = sensor.film(), sensor.sampler().clone()
    width, height, spp = *film.crop_size(), sampler.sample_count()
    sampler.set_samples_per_wavefront(spp)
    sampler.seed(seed, width * height * spp)
    pixel = np.arange(width * height * spp) // spp
    corner = np.stack([pixel % width, pixel // width]) + np.array(film.crop_offset())[:, None]
    position = mi.Point2f(corner.astype(np.float32)) + sampler.next_2d()
    in_crop = (position - mi.Point2f(film.crop_offset())) / mi.Point2f(film.crop_size())
    ray, weight = sensor.sample_ray(0.0, 0.5, in_crop, sampler.next_2d())
    return position, weight, np.concatenate([np.array(ray.o, float), np.array(ray.d, float)]).T


def oracle_image(scene, bounces, seed):
    """The image as Mitsuba's film makes it from the oracle's radiance along the rays of the sensor."""
    position, weight, found = rays(scene, seed)
    lines = references.array("unseen rays", [sensor_dict(), seed], lambda: found)
    np.testing.assert_allclose(found, lines, rtol=0, atol=16 * np.spacing(np.float32(np.abs(lines).max())))
    o, d = lines[:, :3], lines[:, 3:] / np.linalg.norm(lines[:, 3:], axis=1, keepdims=True)
    lights = [tuple(np.array(x) for x in light) for light in LIGHTS]
    bodies = oracle_bodies(scene)
    L = references.array("unseen", [bodies, lights, bounces, lines],
                         lambda: oracle.camera_radiance(bodies, lights, o, d, bounces, subdivisions=4))  # fmt: skip
    film = scene.sensors()[0].film()
    film.prepare([])
    block = film.create_block()
    value = mi.Color3f(L.T.astype(np.float32)) * weight
    block.put(position, [value.x, value.y, value.z, mi.Float(1)])
    film.put_block(block)
    return np.array(film.develop())


def test_unseen_scene(rgb, tmp_path):
    """The error of the image is below the tolerance, and no pixel is off by 5 %; at tolerance 0 none by 1 %."""
    scene = mi.load_dict(scene_dict(tmp_path))
    truth = oracle_image(scene, 1, 5)
    bright = truth.sum(axis=2) > 0.05 * truth.sum(axis=2).mean()
    assert bright.mean() > 0.5
    for tolerance, least in ((0.01, 0.01), (0.001, 0.001), (0.0, 0.001)):
        settings = {"surfaces": False, "internal_bounces": 1, "tolerance": tolerance}
        integrator = mi.load_dict({"type": "refscatter", **settings})
        ours = np.array(mi.render(scene, integrator=integrator, seed=5))
        assert ours.shape == truth.shape == (9, 14, 3)
        difference = np.abs(ours - truth)
        assert difference.sum() / truth.sum() < least
        worst = (difference.sum(axis=2)[bright] / truth.sum(axis=2)[bright]).max()
        print(f"tolerance {tolerance:g}: {difference.sum() / truth.sum():.1e}, worst pixel {worst:.1e}")
        assert worst < 0.05
    assert worst < 1e-2

"""The image that ``refscatter compare`` measures errors against, on the shipped scenes with a point light: against the float64
oracle, and against long photon beams, whose way to the image is another one. The figures stand in reports."""

import build
import mitsuba as mi
import numpy as np
import oracle
import pytest
from meshes import Mesh

from mitsuba_refscatter import scenes
from mitsuba_refscatter.compare import methods, race

SIZES = {"bumpy_sphere": 5120, "sphere": 1280, "rounded_cube": 5000, "branches": 8000}


def scene_and_rays(name, folder, n):
    path, _ = scenes.write_scene(name, folder, SIZES[name])
    scene = scenes.load(path)
    ray, _ = scene.sensors()[0].sample_ray(
        0, 0.5, mi.Point2f(*np.random.default_rng(2).uniform(0.25, 0.75, (2, n))), mi.Point2f(0.5)
    )
    return scene, np.array(ray.o, dtype=float).T, np.array(ray.d, dtype=float).T


def oracle_body(scene):
    shape = next(s for s in scene.shapes() if s.id() == "body")
    mesh, medium = mi.traverse(shape), mi.traverse(shape.interior_medium())
    x = [np.array(mesh[key], dtype=float).reshape(-1, 3) for key in ("vertex_positions", "vertex_normals")]
    sigma_t = np.ravel(np.array(medium["sigma_t.value.value"], dtype=float)) * float(medium["scale"])
    g = float(np.ravel(medium["phase_function.g"])[0]) if "phase_function.g" in medium else 0.0
    eta = float(np.ravel(mi.traverse(shape.bsdf())["eta"])[0])
    albedo = np.ravel(np.array(medium["albedo.value.value"], dtype=float))
    return oracle.Body(
        Mesh(x[0], np.array(mesh["faces"], dtype=int).reshape(-1, 3), x[1]), eta, sigma_t * albedo, sigma_t, g
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", SIZES)
def test_reference_against_oracle(rgb, tmp_path, name):
    """sum |a - b| / sum b over 200 camera rays."""
    scene, o, d = scene_and_rays(name, tmp_path, 200)
    emitter = mi.traverse(scene.emitters()[0])
    light = (np.array(emitter["position"]).ravel(), np.array(emitter["intensity.value"]).ravel())
    ours = build.single_scattering(scene, o, d, internal_bounces=0, tolerance=race.REFERENCE_TOLERANCE)
    truth = oracle.camera_radiance([oracle_body(scene)], [light], o, d, 0, subdivisions=8)
    error = np.abs(ours - truth).sum() / truth.sum()
    print(f"{name}: {error:.1e}")
    assert truth.sum() > 0 and error <= race.CHECKED[name][0]


@pytest.mark.slow
@pytest.mark.parametrize("name", SIZES)
def test_reference_against_photon_beams(rgb, tmp_path, name):
    """Means over 2000 camera rays, of 40 clouds of beams."""
    scene, o, d = scene_and_rays(name, tmp_path, 2000)
    ours = build.single_scattering(scene, o, d, internal_bounces=0, tolerance=race.REFERENCE_TOLERANCE)
    beams = {**methods.METHODS["photon_beams"], "radius": 0.01, "internal_bounces": 0}
    found = np.array([build.single_scattering(scene, o, d, seed=k, **beams).sum() for k in range(40)]) / ours.sum()
    error = found.std(ddof=1) / len(found) ** 0.5
    print(f"{name}: {found.mean() - 1:+.1e} +- {error:.1e}")
    assert error < 2e-3 and abs(found.mean() - 1) <= race.CHECKED[name][1]

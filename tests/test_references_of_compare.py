"""The image that ``refscatter compare`` measures errors against, on the shipped scenes with a point light.

It is compared with the float64 oracle, and with long photon beams. These take camera rays and boundaries from the
package, but not how light comes to them. The figures stand in reports on these very scenes, with their own meshes.
"""

import shutil
from pathlib import Path

import build
import mitsuba as mi
import numpy as np
import oracle
import pytest
from comparison import bias, l1
from meshes import Mesh

from mitsuba_refscatter import example_scenes
from mitsuba_refscatter.benchmarks import duel, methods, race

SHIPPED = Path(__file__).parent.parent / "scenes"


def scene_and_rays(name, n):
    scene = example_scenes.load(SHIPPED / name / "scene.xml")
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
@pytest.mark.parametrize("name", race.CHECKED)
def test_reference_against_oracle(rgb, name):
    """L1 over 200 camera rays."""
    scene, o, d = scene_and_rays(name, 200)
    emitter = mi.traverse(scene.emitters()[0])
    light = (np.array(emitter["position"]).ravel(), np.array(emitter["intensity.value"]).ravel())
    ours = build.single_scattering(scene, o, d, internal_bounces=0, tolerance=race.REFERENCE_TOLERANCE)
    truth = oracle.camera_radiance([oracle_body(scene)], [light], o, d, 0, subdivisions=4)
    print(f"{name}: L1 {l1(ours, truth):.1e}, bias {bias(ours, truth):+.1e}")
    assert truth.sum() > 0 and l1(ours, truth) <= race.CHECKED[name].l1


@pytest.mark.slow
@pytest.mark.parametrize("name", race.CHECKED)
def test_reference_against_photon_beams(rgb, name):
    """Bias of 40 clouds of beams over 2000 camera rays.

    What the radius blurs is in it and falls with it (rounded_cube: 7e-3 at 0.02, 4e-3 at 0.01).
    """
    scene, o, d = scene_and_rays(name, 2000)
    ours = build.single_scattering(scene, o, d, internal_bounces=0, tolerance=race.REFERENCE_TOLERANCE)
    beams = {**methods.METHODS["photon_beams"], "radius": 0.005, "internal_bounces": 0}
    found = np.array([build.single_scattering(scene, o, d, seed=k, **beams).sum() for k in range(40)]) / ours.sum()
    error = found.std(ddof=1) / len(found) ** 0.5
    print(f"{name}: bias {found.mean() - 1:+.1e} +- {error:.1e}")
    assert error < 2e-3 and abs(found.mean() - 1) <= race.CHECKED[name].bias


def test_a_scene_is_known_by_its_file_and_its_mesh(tmp_path):
    """The shipped ones are known; with another light, another mesh, or another number of triangles none is."""
    for name, known in race.CHECKED.items():
        assert race.checked(SHIPPED / name / "scene.xml") is known
        shutil.copytree(SHIPPED / name, tmp_path / name)
        file, mesh = tmp_path / name / "scene.xml", tmp_path / name / "meshes" / f"{name}.ply"
        assert race.checked(file) is known
        text = file.read_text()
        file.write_text(text.replace('name="position" value="-', 'name="position" value="'))
        assert text != file.read_text() and race.checked(file) is None
        file.write_text(text)
        mesh.write_bytes(mesh.read_bytes()[:-1] + b"!")
        assert race.checked(file) is None
        mesh.unlink()
        assert race.checked(file) is None
    assert race.checked(example_scenes.write_scene("sphere", tmp_path / "small", 80)[0]) is None


@pytest.mark.parametrize(
    "known, bounces", [(True, 0), (False, 0), (True, 1)], ids=["checked", "another", "with reflections"]
)
def test_reports_tell_the_figures_of_checked_scenes_alone(rgb, monkeypatch, known, bounces):
    made = race.Run("reference", {}, image=np.ones((8, 8, 3)), samples=3)
    monkeypatch.setattr(race, "reference", lambda *arguments: made)
    scene, figures = example_scenes.load(SHIPPED / "sphere" / "scene.xml", res="8"), race.CHECKED["sphere"]
    subject = duel.Subject("sphere", lambda: scene, 5120, figures if known else None)
    about = duel.compare(subject, [], race.Setup(rgb, internal_bounces=bounces)).about
    told = f"within {figures.l1:g} (L1)" in about and f"within {figures.bias:g} (bias)" in about
    assert told == (known and bounces == 0) and ("not checked" in about) == (not told)

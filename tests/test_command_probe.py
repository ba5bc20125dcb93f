"""``refscatter probe``: the radiance along one camera ray, against the integrator, the oracle and Snell's law."""

import json
import re

import closed_forms
import mitsuba as mi
import numpy as np
import oracle
import pytest
from build import point_light, single_scattering
from test_commands import SPHERE, assert_one_sentence, needs_variant, refscatter
from test_references_of_compare import oracle_body

import mitsuba_refscatter
from mitsuba_refscatter import example_scenes, platform
from mitsuba_refscatter.probing import ProbeError, curves, numbers, picture, view

PIXEL = 40, 30
"""Of 64 x 64: its ray has two folds inside triangles."""


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory):
    return example_scenes.write_scene("bumpy_sphere", tmp_path_factory.mktemp("probe"), 1280)[0]


@pytest.fixture(scope="module")
def scene(scene_file):
    mi.set_variant(platform.default_variant())
    return example_scenes.load(scene_file, res="64")


@pytest.fixture(scope="module")
def probe(scene):
    return mitsuba_refscatter.probe(scene, *PIXEL, internal_bounces=0)


@pytest.fixture(scope="module")
def truth(scene):
    """The body and the light as the oracle takes them: ``(Body, position, intensity)``."""
    light = mi.traverse(scene.emitters()[0])
    return oracle_body(scene), np.array(light["position"], float).ravel(), np.array(light["intensity.value"]).ravel()


def parts(probe, n):
    """Radiance (n, 3) of n equal parts of the segment."""
    length = probe.segments[probe.segment].length
    return probe.radiance.reshape(n, -1, 3).sum(axis=1) * length / len(probe.radiance)


@needs_variant
def test_the_parts_are_what_the_integrator_finds(rgb, scene, probe, truth):
    """The integrator's radiance from one point of the segment on, less what is left of it from the next on.

    All of it is the integral, the sum over the triangles, and what the estimator finds.
    """
    segment, n = probe.segments[0], 16
    t = np.arange(1, n) * segment.length / n
    medium = next(s for s in scene.shapes() if s.id() == "body").interior_medium()
    o, d = segment.origin + t[:, None] * segment.direction, np.tile(segment.direction, (n - 1, 1))
    from_here = single_scattering(scene, o, d, medium, internal_bounces=0, tolerance=0.0)
    from_here *= segment.weight * np.exp(-truth[0].sigma_t * t[:, None])
    expected = from_here - np.vstack([from_here[1:], np.zeros((1, 3))])
    found = parts(probe, n)[1:]
    assert np.abs(found - expected).sum() < 1e-3 * expected.sum()
    bright = expected > 0.1 * expected.max()
    np.testing.assert_allclose(found[bright], expected[bright], rtol=3e-3)
    np.testing.assert_allclose(probe.integral, probe.estimated, rtol=1e-3)
    np.testing.assert_allclose(probe.triangles.integral.sum(axis=0), probe.integral, rtol=1e-5)
    assert probe.unresolved < 1e-3 and not probe.straight.any()


@needs_variant
def test_against_the_oracle(probe, truth):
    """All of the segment and eight parts of it."""
    (body, *light), segment, n = truth, probe.segments[0], 8
    t = np.arange(n) * segment.length / n
    o, d = segment.origin + t[:, None] * segment.direction, np.tile(segment.direction, (n, 1))
    length = np.full(n, segment.length / n)
    value = oracle.segment_radiance(body, light, oracle.CameraRays(o, d, length), 16)
    value *= segment.weight * np.exp(-body.sigma_t * t[:, None])
    np.testing.assert_allclose(probe.integral, value.sum(axis=0), rtol=1e-4)
    assert np.abs(parts(probe, n) - value).sum() < 2e-4 * value.sum()


def lines(probe, truth):
    """In float64, for the points of all cells (n, 3): barycentric coordinates (n, 3, 3), and three more by Snell's law.

    They are the distance at which their light meets the segment's line, by how much it misses it, and the light's
    cosine.
    """
    body, light, _ = truth
    corners = body.mesh.vertices[body.mesh.faces[probe.curve.triangle]]
    normals = body.mesh.normals[body.mesh.faces[probe.curve.triangle]]
    edges = (corners[:, 1:] - corners[:, :1]).swapaxes(1, 2)
    uv = np.einsum("nij,nkj->nki", np.linalg.pinv(edges), probe.curve.position - corners[:, :1])
    weights = np.concatenate([1 - uv.sum(axis=2, keepdims=True), uv], axis=2)
    P, n = (np.einsum("nkc,ncj->nkj", weights, x) for x in (corners, normals))
    n /= np.linalg.norm(n, axis=2, keepdims=True)
    to_light = light - P
    w = to_light / np.linalg.norm(to_light, axis=2, keepdims=True)
    cosine = (w * n).sum(axis=2, keepdims=True)
    omega = -w / body.eta + n * (cosine / body.eta - np.sqrt(1 - (1 - cosine**2) / body.eta**2))
    segment = probe.segments[0]
    across, away = np.cross(segment.direction, omega), P - segment.origin
    t = (np.cross(away, omega) * across).sum(axis=2) / (across**2).sum(axis=2)
    return weights, t, np.abs((away * across).sum(axis=2)) / np.linalg.norm(across, axis=2), cosine[..., 0]


@needs_variant
def test_points_obey_snell_and_intervals_end_where_they_must(rgb, scene, probe, truth):
    """Every point sends light onto the segment, at the distance that is said.

    Intervals end on triangles' edges, at folds, with the segment, or where light grazes or a shadow begins.
    """
    weights, t, miss, cosine = lines(probe, truth)
    assert len(probe.triangles.triangle) > 40 and weights.min() > -1e-4
    assert miss.max() < 2e-5 and np.abs(t - probe.curve.distance).max() < 1e-4
    of, length = probe.triangles, probe.segments[0].length
    assert (of.x_min >= 0).all() and (of.x_max <= length).all() and (of.x_min < of.x_max).all()
    beyond = 2 * probe.curve.position[:, [0, 2]] - probe.curve.position[:, [1, 1]]  # half a cell behind its ends
    dark = np.array(scene.ray_test(mi.Ray3f(*shadow_rays(beyond.reshape(-1, 3), truth[1]))))
    dark = np.insert(dark.reshape(-1, 2), 1, False, axis=1)
    for k in range(len(of.triangle)):
        own = np.flatnonzero(of.of == k)
        for end in (of.x_min[k], of.x_max[k]):
            if (np.abs(probe.curve.fold[own] - end) < 2e-6).any() or end in (0, length):
                continue
            cell, point = np.argwhere(probe.curve.distance[own] == end)[0]
            why = weights[own[cell], point].min() < 1e-4, cosine[own[cell], point] < 1e-2, dark[own[cell], point]
            assert any(why), (of.triangle[k], end)


def shadow_rays(points, light):
    """From a little above points (n, 3) of a body around 0 to the light: origins and directions."""
    start = points + 1e-3 * (light - points) / np.linalg.norm(light - points, axis=1, keepdims=True)
    d = light - start
    return mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(d.T.astype(np.float32))


@needs_variant
def test_point_form_and_curve_form_agree(probe):
    """Simpson's rule for the radiance per unit length over each cell is what the cell brings.

    Left out are cells with a fold, where it is infinite, and those next to them, where the rule is not good for it.
    """
    curve = probe.curve
    mean = np.tensordot(curve.radiance, [1 / 6, 4 / 6, 1 / 6], axes=([1], [0]))
    error = np.abs(mean * np.abs(curve.distance[:, 2] - curve.distance[:, 0])[:, None] - curve.integral)
    folded = np.isfinite(curve.fold)
    near = folded | np.roll(folded, 1) | np.roll(folded, -1)
    smooth = ~near
    assert error[smooth].sum() < 5e-3 * curve.integral.sum() and error[smooth].max() < 1e-4 * curve.integral.sum()


@needs_variant
def test_folds_are_where_the_curve_turns_back(probe, truth):
    """By distances in float64 the curve of a triangle with a fold lies on one side of it, comes to it, is bright
    there."""
    _, t, _, _ = lines(probe, truth)
    folded = np.flatnonzero(np.isfinite(probe.curve.fold))
    assert len(folded) == 2
    for cell in folded:
        own = probe.curve.triangle == probe.curve.triangle[cell]
        beyond = t[own] - probe.curve.fold[cell]
        side = np.sign(beyond.ravel()[np.abs(beyond).argmax()])
        assert np.abs(beyond).min() < 2e-6 and np.abs(beyond).max() > 1e-4 and (side * beyond).min() > -2e-6
        density = curves.luminance(probe.curve.radiance)
        assert density[cell].max() > 10 * np.median(density[own])


@needs_variant
def test_point_samples_lie_on_the_total(probe):
    """Between the smallest and the largest of the total in the parts around them; their mean comes near the
    integral."""
    y = curves.luminance(probe.radiance)
    part = np.minimum((probe.samples.distance / probe.segments[0].length * len(y)).astype(int), len(y) - 1)
    around = np.stack([y[np.clip(part + k, 0, len(y) - 1)] for k in (-1, 0, 1)])
    slack = 0.02 * y.max()
    found = curves.luminance(probe.samples.radiance)
    assert (
        len(found) == 64 and (found > around.min(axis=0) - slack).all() and (found < around.max(axis=0) + slack).all()
    )
    np.testing.assert_allclose(probe.samples.estimate, probe.integral, rtol=0.2)


def test_peaks_are_those_that_stand_out():
    x = np.arange(9.0)
    y = np.array([0, 1, 0.97, 1.2, 0.2, 0.5, 0.5, 0.1, 0.4])
    np.testing.assert_array_equal(curves.peaks(x, y[:, None]), [3, 5, 8])
    assert len(curves.peaks(x, np.zeros((9, 1)))) == 0


@needs_variant
def test_errors_say_what_to_do(rgb, scene, scene_file):
    for changes, words in (
        ({"x": 64}, ["(64, 30)", "64 x 64", "0 to 63"]),
        ({"x": 0, "y": 0}, ["(0, 0)", "meets no body", "choose"]),
        ({"segment": 30}, ["segment number 30"]),
        ({"parts": 1}, ["at least 2"]),
        ({"sensor": 1}, ["no sensor number 1"]),
    ):
        with pytest.raises(ProbeError) as error:
            mitsuba_refscatter.probe(scene, **{"x": PIXEL[0], "y": PIXEL[1], **changes})
        assert all(word in str(error.value) for word in words)
    text = re.sub(
        r'<emitter type="point">.*?</emitter>', '<emitter type="constant"/>', scene_file.read_text(), flags=re.S
    )
    other = scene_file.with_name("constant.xml")
    other.write_text(text)
    with pytest.raises(ProbeError, match="Constant.*add a point"):
        mitsuba_refscatter.probe(example_scenes.load(other, res="64"), *PIXEL)


@needs_variant
def test_the_command_writes_picture_view_and_numbers(tmp_path, scene_file):
    """All of them complete, the view without anything to load; and nothing else."""
    done = refscatter(
        "probe", scene_file, "--pixel", *PIXEL, "-D", "res=64", "--internal-bounces", 0, "-o", tmp_path / "out"
    )
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["probe.html", "probe.json", "probe.png"]
    assert "folds: 2" in done.stdout and str(tmp_path / "out" / "probe.html") in done.stdout
    data = json.loads((tmp_path / "out" / "probe.json").read_text())
    assert data["schema"] == numbers.SCHEMA and data["pixel"] == list(PIXEL) and len(data["folds"]) == 2
    length = data["segments"][data["segment"]]["length"]
    np.testing.assert_allclose(np.mean(data["total"]["radiance"], axis=0) * length, data["integral"], rtol=1e-4)
    assert all(0 <= x["x_min"] < x["x_max"] <= length * (1 + 1e-6) for x in data["triangles"])
    picture = np.array(mi.Bitmap(str(tmp_path / "out" / "probe.png")))
    assert picture.shape[:2] == (1000, 1280) and picture.std() > 5
    page = (tmp_path / "out" / "probe.html").read_text(encoding="utf-8")
    assert "Plotly.newPlot" in page and "points that light it" in page
    assert not re.findall(r"<(?:script|link|img|iframe)[^>]*(?:src|href)=", page)


@needs_variant
def test_the_command_says_what_is_wrong(tmp_path):
    assert_one_sentence(refscatter("probe", tmp_path / "no.xml", "--pixel", 1, 1, "-o", tmp_path), "no scene file")
    done = refscatter("probe", SPHERE, "--pixel", 7, 70, "-D", "res=16", "-o", tmp_path)
    assert_one_sentence(done, "(7, 70)", "16 x 16")
    assert not list(tmp_path.iterdir())


def probe_with(loaded, lights, **options):
    """The probe of a loaded scene with these lights in place of its own, if there are any."""
    shapes = {f"shape{i}": shape for i, shape in enumerate(loaded.shapes())}
    lamps = {f"light{i}": light for i, light in enumerate(lights or loaded.emitters())}
    scene = mi.load_dict({"type": "scene", "sensor": loaded.sensors()[0], **shapes, **lamps})
    return mitsuba_refscatter.probe(scene, *PIXEL, **options)


LAMP_INSIDE = (0.2, 0.3, 0.1)


@needs_variant
def test_light_inside_gives_airlight(rgb, scene_file):
    """A light in the body reaches the segment straight: its parts, and all of it, are as the airlight integral has
    them."""
    loaded, intensity, n = example_scenes.load(scene_file, res="64"), np.array([10.0, 6.0, 3.0]), 64
    body = oracle_body(loaded)
    probe = probe_with(loaded, [point_light(LAMP_INSIDE, intensity)], parts=n)
    segment = probe.segments[probe.segment]
    t = np.arange(n)[:, None] * segment.length / n
    o, d, length = segment.origin + t * segment.direction, np.tile(segment.direction, (n, 1)), segment.length / n
    rays = oracle.CameraRays(o, d, np.full(n, length))
    expected = closed_forms.airlight_radiance(body, (np.array(LAMP_INSIDE), intensity), rays)
    expected *= segment.weight * np.exp(-body.sigma_t * t)
    np.testing.assert_allclose(probe.radiance * length, expected, rtol=2e-4)
    np.testing.assert_array_equal(probe.straight, probe.radiance)
    for found in (probe.integral, probe.estimated):
        np.testing.assert_allclose(found, expected.sum(axis=0), rtol=1e-4)


@needs_variant
@pytest.mark.slow
@pytest.mark.parametrize("case", ["spindle", "inside", "several"])
def test_other_lights_and_the_other_culling(rgb, scene_file, case, tmp_path):
    """The integral is the estimator's: with the culling ``spindle``, a light inside of the body, and several lights."""
    sun = {"type": "directional", "direction": [0.3, -1, 0.2], "irradiance": {"type": "rgb", "value": [1, 1, 2]}}
    lights = {"spindle": [], "inside": [point_light(LAMP_INSIDE)], "several": [point_light((-3, 2, 1)), sun]}[case]
    probe = probe_with(
        example_scenes.load(scene_file, res="64"), lights, culling="spindle" if case == "spindle" else "beams"
    )
    np.testing.assert_allclose(probe.integral, probe.estimated, rtol=2e-3)
    assert probe.integral.min() > 0 and (probe.straight.any() == (case == "inside"))
    refracted = {"spindle": {0}, "inside": set(), "several": {0, 1}}[case]
    assert set(probe.samples.light) == set(probe.triangles.light) == refracted
    picture.draw(probe, tmp_path / "probe.png")
    view.write(probe, tmp_path / "probe.html")
    assert np.array(mi.Bitmap(str(tmp_path / "probe.png"))).std() > 5
    assert np.isfinite(json.loads(numbers.text_of(probe))["integral"]).all()

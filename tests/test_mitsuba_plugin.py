"""The plugin inside Mitsuba: film, wrappers, alpha, variants, import orders, refusals."""

import subprocess
import sys
import textwrap

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from comparison import z_values
from meshes import bumpy_sphere
from test_commands import HANGS

import mitsuba_refscatter
from mitsuba_refscatter import tolerances
from mitsuba_refscatter.example_scenes import write_ply


@pytest.fixture(scope="module")
def body(tmp_path_factory):
    """A bumpy sphere of 320 triangles in a PLY file."""
    path, mesh = tmp_path_factory.mktemp("plugin") / "body.ply", bumpy_sphere(2)
    write_ply(path, mesh.vertices, mesh.faces, mesh.normals)
    return str(path)


def grey(value):
    return {"type": "rgb", "value": [value] * 3}


MEDIUM = {"type": "homogeneous", "sigma_t": grey(0.7), "albedo": grey(0.8)}


def scene(body, integrator, medium=MEDIUM, extra=None, **film):
    """A grey body over a grey floor, seen by a film with a gaussian filter, a crop window and 4 samples.

    ``film``: properties that replace these; ``extra``: more objects of the scene."""
    transform = mi.ScalarTransform4f()
    pixels = "luminance_alpha" if mi.is_monochromatic else "rgba"
    crop = {"crop_offset_x": 5, "crop_offset_y": 3, "crop_width": 20, "crop_height": 14}
    return mi.load_dict({
        "type": "scene", "integrator": integrator, **(extra or {}),
        "sensor": {
            "type": "perspective", "fov": 30, "to_world": transform.look_at([0.3, 0.8, 5], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 32, "height": 24, **crop, "rfilter": {"type": "gaussian"},
                     "component_format": "float32", "pixel_format": pixels, **film},
            "sampler": {"type": "independent", "sample_count": 4},
        },
        "light": {"type": "point", "position": [1.5, 2.5, 0], "intensity": grey(20.0)},
        "floor": {"type": "rectangle", "bsdf": {"type": "diffuse"},
                  "to_world": transform.translate([0, -1.1, 0]).rotate([1, 0, 0], -90).scale(2)},
        "body": {
            "type": "ply", "filename": body, "bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
            "interior": medium,
        },
    })  # fmt: skip


def refscatter(surfaces=False, **properties):
    return {"type": "refscatter", "surfaces": surfaces, "internal_bounces": 2, **properties}


def image(loaded, seed=3, **arguments):
    return np.array(mi.render(loaded, seed=seed, **arguments))


@pytest.mark.parametrize("surfaces", (False, True))
def test_same_image_alone_and_as_a_child(variant, surfaces, body):
    """``aov`` and ``moment`` render through Mitsuba's own film code, with the same camera samples for the same
    seed.  What differs is the order in which filtered samples are summed: a few roundings of float32."""
    ours = refscatter(surfaces)
    alone = image(scene(body, ours))
    inside_aov = image(scene(body, {"type": "aov", "aovs": "distance:depth", "image": ours}))
    inside_moment = image(scene(body, {"type": "moment", "image": ours}))
    assert np.isfinite(alone).all()
    channels = 2 if mi.is_monochromatic else 4
    assert alone.shape == (14, 20, channels)
    brightest = alone[..., :-1].max()
    assert brightest > 0.01
    for other in (inside_aov, inside_moment):
        np.testing.assert_allclose(other[..., :channels], alone, rtol=1e-5, atol=1e-6 * brightest)


@pytest.mark.parametrize("surfaces", (False, True))
def test_alpha_is_where_the_camera_ray_hits(variant, surfaces, body):
    """``depth`` reports a hit as its alpha and gets the same camera rays; the floor counts too."""
    alpha = image(scene(body, refscatter(surfaces)))[..., -1]
    expected = image(scene(body, {"type": "depth"}))[..., -1]
    assert expected.min() < 0.1 and expected.max() > 0.9
    np.testing.assert_allclose(alpha, expected, atol=1e-6)


def test_alpha_is_zero_or_one_for_one_sample_in_a_box(rgb, body):
    alpha = image(scene(body, refscatter(), rfilter={"type": "box"}), spp=1)[..., 3]
    assert set(np.unique(alpha)) == {0.0, 1.0}


@pytest.mark.parametrize("hidden", (False, True))
def test_alpha_under_a_sky_is_that_of_path(rgb, hidden, body):
    """With ``surfaces`` a visible sky counts as seen, as in Mitsuba's own integrators; a hidden one does not."""
    dark = {"type": "homogeneous", "sigma_t": grey(0.7), "albedo": grey(0.0)}
    seen = []
    for integrator in (refscatter(True, hide_emitters=hidden), {"type": "path", "hide_emitters": hidden}):
        loaded = scene(body, integrator, medium=dark, extra={"sky": {"type": "constant"}})
        sampler, steps = mi.load_dict({"type": "independent"}), (dr.arange(mi.Float, 40) + 0.5) / 40
        places = mi.Point2f(*dr.meshgrid(steps, steps))
        sampler.seed(0, 1600)
        ray, _ = loaded.sensors()[0].sample_ray_differential(0, 0.5, places, mi.Point2f(0.5))
        seen.append(np.array(loaded.integrator().sample(loaded, sampler, ray)[1]))
    assert (seen[0] == seen[1]).all() and seen[0].any() and seen[0].all() != hidden


def test_single_scattering_does_not_depend_on_what_the_nested_integrator_draws(rgb, body):
    """The single-scattering part of an image is a function of the camera samples alone."""
    names = "single_scatter, surfaces"
    both = image(scene(body, refscatter(True, aovs=names), pixel_format="rgb"))
    only = image(scene(body, refscatter(False, aovs=names), pixel_format="rgb"))
    scattered, surfaces = both[..., 3:6], both[..., 6:9]
    largest = both[..., :3].max()
    np.testing.assert_allclose(scattered + surfaces, both[..., :3], rtol=1e-5, atol=1e-6 * largest)
    np.testing.assert_allclose(only[..., :3], only[..., 3:6], rtol=1e-5, atol=1e-6 * largest)
    np.testing.assert_allclose(only[..., 6:9], 0)
    # Legs that leave the body are not followed where nothing can scatter behind them: weights stay the same.
    np.testing.assert_allclose(scattered, only[..., :3], rtol=1e-4, atol=1e-5 * largest)


def test_counts(rgb, body):
    """Contributing pairs are some of the candidate pairs; ``unresolved`` is a share of samples."""
    result = image(scene(body, refscatter(aovs="candidates, contributions, unresolved")))
    candidates, contributions, unresolved = result[..., 4:].transpose(2, 0, 1)
    assert contributions.max() > 1
    assert (candidates >= contributions * (1 - 1e-5)).all()
    assert unresolved.min() >= 0 and unresolved.max() <= 1


@pytest.mark.parametrize("most, share", [(tolerances.MOST_UNRESOLVED, None), (-1.0, "%")])
def test_what_is_not_resolved_is_told_once(rgb, body, monkeypatch, capfd, most, share):
    """With the share that the AOV shows, and only where it is larger than usual."""
    monkeypatch.setattr(tolerances, "MOST_UNRESOLVED", most)
    film = {"rfilter": {"type": "box"}}
    result = image(scene(body, refscatter(tolerance=0.0, aovs="unresolved"), **film))
    told = [line for line in "".join(capfd.readouterr()).splitlines() if "are not known to the tolerance" in line]
    assert len(told) == (share is not None)
    assert result[..., -1].mean() < tolerances.MOST_UNRESOLVED or share is not None
    if told:
        assert f"{result[..., -1].mean():.1%}" in told[0]


@pytest.mark.parametrize(
    ("integrator", "aside", "told"), [
        (refscatter(), 0.0, 1), (refscatter(estimator="interval", samples=1), 0.002, 1), (refscatter(), 0.02, 0),
        (refscatter(estimator="point", samples=1), 0.0, 0), ({"type": "refscatter_photons", "photons": 1000}, 0.0, 0),
        ({"type": "refscatter_straight"}, 0.0, 0),
    ], ids=["curve", "interval", "beside", "point", "photons", "straight"],
)  # fmt: skip
def test_a_light_at_the_camera_is_told(rgb, body, capfd, integrator, aside, told):
    """Once, where its light cannot be found; ``tests/test_rays_against_oracle_and_formulas.py`` holds what is found
    of one just beside to a formula."""
    lamp = {"type": "point", "position": [0.3 + aside, 0.8, 5], "intensity": grey(1.0)}
    image(scene(body, integrator, extra={"lamp": lamp}))
    lines = "".join(capfd.readouterr()).splitlines()
    assert sum('"lamp" is at the camera' in line for line in lines) == told


def test_extra_channels_are_the_same_inside_aov(rgb, body):
    """``aov`` appends the child's channels to its own, with the child's name in front."""
    ours = refscatter(aovs="single_scatter, candidates")
    inside = scene(body, {"type": "aov", "aovs": "distance:depth", "image": ours})
    alone, result = image(scene(body, ours)), image(inside)
    names = [field.name for field in inside.sensors()[0].film().bitmap().struct_()]
    np.testing.assert_allclose(result[..., names.index("image.candidates")], alone[..., 7], rtol=1e-5)


def test_mono_equals_rgb_in_a_grey_scene(body):
    results = []
    for variant in ("llvm_ad_rgb", "llvm_ad_mono"):
        mi.set_variant(variant)
        results.append(image(scene(body, refscatter())))
    rgba, luminance = results
    np.testing.assert_allclose(luminance, rgba[..., [1, 3]], rtol=1e-4, atol=1e-6)


def test_spectral_agrees_with_rgb_in_a_grey_scene(body):
    """Spectral renders draw four wavelengths per camera sample: the mean over seeds is compared, per channel,
    within 3 standard errors, which must be below 2 %."""
    samples = []
    for variant in ("llvm_ad_rgb", "llvm_ad_spectral"):
        mi.set_variant(variant)
        loaded = scene(body, refscatter())
        samples.append(np.array([image(loaded, seed=k)[..., :3].mean((0, 1)) for k in range(8)]))
    _, error, z = z_values(*samples)
    assert (error < 0.02 * samples[0].mean(0)).all()
    assert (np.abs(z) < 3).all()


def test_crop_window_shows_the_same_picture(rgb, body):
    """A crop window is a part of the whole film: same expectation, different camera samples."""
    part = image(scene(body, refscatter()), spp=64)
    whole = image(scene(body, refscatter(), crop_offset_x=0, crop_offset_y=0, crop_width=32, crop_height=24), spp=64)
    level = part[..., :3].mean()
    assert np.abs(whole[3:17, 5:25] - part)[..., :3].mean() < 0.03 * level
    assert np.abs(whole[3:17, 8:28] - part)[..., :3].mean() > 0.1 * level  # three pixels beside


def test_same_seed_same_image(rgb, body):
    loaded = scene(body, refscatter(True))
    first, again, other = image(loaded, seed=5), image(loaded, seed=5), image(loaded, seed=6)
    np.testing.assert_allclose(again, first, rtol=1e-5, atol=1e-6)
    assert np.abs(other - first).max() > 1e-4


def test_variant_changes_back_and_forth(body):
    """A class keeps the variant it was made under: the plugin is made anew for each."""
    kept = {}
    for variant in ("llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_rgb", "llvm_ad_spectral", "llvm_ad_mono"):
        mi.set_variant(variant)
        result = image(scene(body, refscatter()), spp=1)
        if variant in kept:
            np.testing.assert_allclose(result, kept[variant], rtol=1e-5, atol=1e-6)
        kept[variant] = result


@pytest.mark.parametrize(
    "variant", ("scalar_rgb", "scalar_spectral", "llvm_ad_mono_polarized", "llvm_ad_spectral_polarized")
)
def test_refused_variants(variant):
    """Setting such a variant is harmless; only to make the integrator is refused, with the way out."""
    mi.set_variant(variant)
    with pytest.raises(RuntimeError, match=f"the variant {variant} cannot be used: refscatter .*: choose "):
        mi.load_dict({"type": "refscatter"})
    mi.set_variant("llvm_ad_rgb")
    assert "RefscatterIntegrator" in str(mi.load_dict({"type": "refscatter"}))


SCRIPT = """
    import sys
    import mitsuba as mi
    {first}
    {second}
    sys.path.insert(0, {tests!r})
    from test_mitsuba_plugin import image, refscatter, scene
    assert image(scene({body!r}, refscatter()), spp=1)[..., :3].max() > 0.01
    print("rendered")
"""


@pytest.mark.parametrize("package_first", (True, False))
def test_both_import_orders(package_first, body):
    """In a process of its own: here the package was imported long ago."""
    lines = ["import mitsuba_refscatter", "mi.set_variant('llvm_ad_rgb')"]
    first, second = lines if package_first else lines[::-1]
    script = textwrap.dedent(SCRIPT.format(first=first, second=second, tests=sys.path[0], body=body))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=HANGS)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("rendered\n")


def test_import_needs_no_variant_and_sets_none():
    script = "import mitsuba as mi, mitsuba_refscatter; print(mi.variant(), mitsuba_refscatter.__version__)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=HANGS)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["None", mitsuba_refscatter.__version__]

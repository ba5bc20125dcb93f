"""Photon points and photon beams: they converge to the curve's image as photons grow in number and their radius
shrinks.

Camera rays, boundaries and media are those of the package on both sides; how light comes to the camera's segments is
not.
"""

from dataclasses import replace

import build
import mitsuba as mi
import numpy as np
import pytest
from against_volpath import glass, medium, to
from comparison import bias, l1
from meshes import bumpy_sphere
from test_scene_kinds_against_volpath import ball_light, panel, spot, sun

from mitsuba_refscatter.estimators import photons
from mitsuba_refscatter.integrators.hooks import Hooks

pytestmark = pytest.mark.usefixtures("rgb")

LAMP = (-2.6, 2.4, -0.9)
MODES = ("points", "beams")
BLUR = 0.005
"""Light that the blur takes out of a body, or to where it is attenuated otherwise, relative."""
MANY = {"points": 200000, "beams": 10000}


def body(folder, **more):
    return build.mesh_shape(bumpy_sphere(3, 0.12, 6.0), folder / "body.ply", **more)


def load(folder, **parts):
    return mi.load_dict(
        {"type": "scene", "light": build.point_light(LAMP), **parts, "body": parts.get("body") or body(folder)}
    )


def rays(n=600, seed=3):
    return build.rays_at((0.2, 1.1, 5.2), 0.8, n, seed)


def by_photons(scene, mode, number, seeds, radius=0.01, **options):
    """Radiance (seeds, rays, 3)."""
    settings = {
        "type": "refscatter_photons",
        "mode": mode,
        "photons": number,
        "radius": radius,
        "internal_bounces": 1,
        **options,
    }
    return np.array([build.single_scattering(scene, *rays(), seed=k, **settings) for k in range(seeds)])


def ratio_of_means(a, b):
    """Ratio of the means of two samples, and its standard error."""
    error = np.hypot(*(x.std(ddof=1) / len(x) ** 0.5 / x.mean() if len(x) > 1 else 0 for x in (a, b)))
    return a.mean() / b.mean(), error


def assert_means_agree(what, found, expected, within=0.01):
    """Within that share, and within three standard errors of the mean over independent photons and what a radius
    blurs out of bodies."""
    ratio, error = ratio_of_means(found, expected)
    print(f"{what}: {ratio:.4f} +- {error:.4f}")
    assert error < 0.4 * within and abs(ratio - 1) < min(within, 3 * error + BLUR)


def by_curve(scene, **options):
    return build.single_scattering(scene, *rays(), **{"internal_bounces": 1, **options})


def means_by_curve(scene):
    """The same of a light that is drawn, several times over, each ray with light points of its own: eight means
    over all rays."""
    o, d = (np.tile(x, (12, 1)) for x in rays())
    options = {"internal_bounces": 1, "culling": "spindle"}
    return np.array([build.single_scattering(scene, o, d, seed=k, **options).mean() for k in range(8)])


@pytest.mark.parametrize("mode", MODES)
def test_means_agree_with_the_curve(tmp_path, mode):
    scene = load(tmp_path)
    expected, found = by_curve(scene), by_photons(scene, mode, MANY[mode], 8)
    assert_means_agree(mode, found.mean(axis=(1, 2)), expected.mean(keepdims=True).ravel())


@pytest.mark.parametrize("mode", MODES)
def test_variance_falls_with_the_number_of_photons(tmp_path, mode):
    """As its inverse, at a fixed radius: 16 times as many, a sixteenth of the variance."""
    scene, few = load(tmp_path), MANY[mode] // 32
    variance = [by_photons(scene, mode, n, 10, radius=0.03).var(axis=0, ddof=1).mean() for n in (few, 16 * few)]
    print(f"{mode}: {variance[0] / variance[1]:.1f}")
    assert 16 / 1.5 < variance[0] / variance[1] < 16 * 1.5


@pytest.mark.parametrize("mode", MODES)
def test_bias_is_a_blur_that_shrinks_with_the_radius(tmp_path, mode):
    """Bright caustics become darker; a smaller radius brings less of that, and a smaller error."""
    scene = load(tmp_path)
    expected = by_curve(scene)
    bright = expected[:, 0] > np.percentile(expected[:, 0], 97)
    darker, error = [], []
    for radius in (0.12, 0.03):
        found = by_photons(scene, mode, MANY[mode], 4, radius=radius).mean(axis=0)
        darker.append(bias(found[bright], expected[bright]))
        error.append(l1(found, expected))
    print(f"{mode}: {darker} {error}")
    assert darker[0] < -0.05 and darker[0] < 2 * darker[1] and error[1] < 0.7 * error[0]


LIGHTS = {
    "sphere": lambda: {"light": ball_light(LAMP, 0.5)},
    "disk": lambda: {"light": panel("disk")},
    "spot": lambda: {"light": spot()},
    "sun": lambda: {"light": sun()},
    "sky": lambda: {"light": {"type": "constant"}},
    "two": lambda: {"light": build.point_light(LAMP), "other": sun()},
}


LONG = ("sphere", "disk", "sky", "two")


@pytest.mark.parametrize("name", build.slow_ones(LIGHTS, LONG))
def test_lights(tmp_path, name):
    """Every kind of light sends photons; several at once share them. Lights that are drawn have the noise of both
    sides: 3 %."""
    scene, drawn = load(tmp_path, **LIGHTS[name]()), name in ("sphere", "disk", "sky")
    ours = means_by_curve(scene) if drawn else by_curve(scene).mean(keepdims=True).ravel()
    for mode in MODES:
        radius = 0.01 if name == "spot" else 0.02  # its checkerboard has rims that a radius blurs
        theirs = by_photons(scene, mode, MANY[mode], 16 if drawn else 8, radius=radius).mean(axis=(1, 2))
        assert_means_agree(f"{mode}, {name}", theirs, ours, 0.03 if drawn else 0.01)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    "place", ["opaque inside", "bubble", "phase function", "outer medium", "facets", "eta below 1"]
)
def test_places(tmp_path, mode, place):
    """What is in the way of photons, what they scatter by, and where they go."""
    coarse = replace(bumpy_sphere(2, 0.1, 5.0), normals=None)
    amber, fog = ({"type": "ref", "id": name} for name in ("amber", "medium"))
    more = {
        "opaque inside": lambda: {"block": {"type": "sphere", "radius": 0.3, "bsdf": {"type": "diffuse"}}},
        "bubble": lambda: {
            "medium": {"type": "homogeneous", "id": "amber", "sigma_t": 0.5, "albedo": 0.8},
            "body": {**body(tmp_path), "interior": amber},
            "bubble": {"type": "cube", "bsdf": glass(1 / 1.5), "to_world": to(("scale", 0.3)), "exterior": amber},
        },
        "phase function": lambda: {"body": body(tmp_path, g=0.7)},
        "outer medium": lambda: {
            "medium": medium(albedo=(0, 0, 0)),
            "body": body(tmp_path, exterior=fog),
            "fog": {"type": "cube", "bsdf": {"type": "null"}, "to_world": to(("scale", 1.6)), "interior": fog},
        },
        "facets": lambda: {"body": build.mesh_shape(coarse, tmp_path / "body.ply")},
        "eta below 1": lambda: {"body": body(tmp_path, eta=0.8)},
    }[place]()
    scene = load(tmp_path, **more)
    # Without internal reflections: where they are total, in corners, nearly all light that is seen is next to a
    # boundary. Through the boundary of another medium the body is the second that is hit from outside.
    bounces = 1 if place == "outer medium" else 0
    theirs = by_photons(scene, mode, MANY[mode], 8, radius=0.02, internal_bounces=bounces).mean(axis=(1, 2))
    assert np.ptp(theirs) > 0  # of what comes straight photons bring nothing, and nothing would be compared
    assert_means_agree(
        f"{mode}, {place}", theirs, by_curve(scene, internal_bounces=bounces).mean(keepdims=True).ravel()
    )


@pytest.mark.parametrize("mode", MODES)
def test_radius_shrinks_from_pass_to_pass(mode):
    """As the published recurrences say, and not at all for alpha = 1."""
    radii, alpha = [photons.radius_of(0.5, k, 0.7, mode) for k in range(6)], 0.7
    assert radii[0] == 0.5
    power = 2 if mode == "points" else 1
    for i in range(1, 6):
        assert (radii[i] / radii[i - 1]) ** power == pytest.approx((i + alpha) / (i + 1))
    assert photons.radius_of(0.5, 5, 1.0, mode) == 0.5


@pytest.mark.parametrize("mode", MODES)
def test_a_progressive_render_comes_nearer(tmp_path, mode):
    """More passes, each with fresh photons and a smaller radius: less error, in an image by ``render``."""
    sensor = {
        "type": "perspective",
        "fov": 24,
        "to_world": mi.ScalarTransform4f().look_at([0, 1, 5], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
    }
    scene = load(tmp_path, sensor=sensor)
    common = {"surfaces": False, "internal_bounces": 0}
    expected = np.array(mi.load_dict({"type": "refscatter", **common}).render(scene, spp=64))
    integrator, errors = (
        mi.load_dict({"type": "refscatter_photons", "mode": mode, "photons": MANY[mode] // 10, "alpha": 0.6, **common}),
        [],
    )

    def watch(samples, image):
        errors.append(l1(np.array(image), expected))
        return 1 if samples < 24 else 0

    integrator.render(scene, spp=1000, hooks=Hooks(watch=watch))
    print(errors[0], errors[-1])
    assert len(errors) == 24 and errors[-1] < 0.5 * errors[0]


def test_spectral_variants_are_refused(rgb):
    if "llvm_ad_spectral" not in mi.variants():
        pytest.skip("no spectral variant")
    mi.set_variant("llvm_ad_spectral")
    with pytest.raises(RuntimeError, match="rgb or mono"):
        mi.load_dict({"type": "refscatter_photons"})

"""What a picture lacks is told, once and by name; nothing is told where nothing is missing; and the shares are
about right."""

import re
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
import test_scene_kinds_against_volpath as real
from against_volpath import WITHIN, camera, colour, glass, to
from build import point_light

from mitsuba_refscatter import missing
from mitsuba_refscatter.core import cache
from mitsuba_refscatter.integrators.hooks import Hooks
from mitsuba_refscatter.missing import walk
from mitsuba_refscatter.missing.emission import photons
from mitsuba_refscatter.scene import read, surfaces

pytestmark = pytest.mark.usefixtures("rgb")


FAINT = 0.02
"""Albedo at which what scatters again is less than a few percent."""

LAMP = point_light((-2.2, 2.5, 1.0))


def loaded(albedo=FAINT, sigma_t=0.4, integrator=None, **parts):
    medium = {"type": "homogeneous", "id": "medium", "sigma_t": float(sigma_t), "albedo": float(albedo)}
    integrator = integrator or {"type": "refscatter"}
    return mi.load_dict(
        {"type": "scene", "a_medium": medium, "integrator": integrator, "sensor": camera(), **parts}, optimize=False
    )


def floor():
    at = to(("translate", [0, -1.1, 0]), ("rotate", [1, 0, 0], -90), ("scale", 10))
    return {"type": "rectangle", "to_world": at, "bsdf": {"type": "diffuse", "reflectance": 0.5}}


def ball(radius=1.0, bsdf=None, interior=WITHIN, **more):
    media = {} if interior is None else {"interior": interior}
    return {"type": "sphere", "radius": radius, "bsdf": bsdf or glass(1.2), **media, **more}


def box(*steps, bsdf=None, **more):
    return {"type": "cube", "bsdf": bsdf or glass(1.5), "to_world": to(*steps), **more}


def shares(scene):
    """Shares of the light in the first medium that scatters, by kind."""
    scene = read(scene, 0.01, cache.Cache())
    left, _ = walk.follow(scene, photons(scene), 0)
    (first, *_) = [region.index for region in scene.regions if region.scatters]
    return left[:, first] / left[:, first].sum()


# ---- Something is missing --------------------------------------------------------------------

MISSING = {
    "a window between lamp and body": (
        lambda: {
            "light": point_light((-3.4, 0.7, 0.5)),
            "body": ball(),
            "pane": box(("translate", [-1.9, 0, 0]), ("scale", [0.04, 1.7, 1.7])),
        },
        'it passes through shape "pane" first',
    ),
    "a liquid in a shell": (
        lambda: {
            "light": LAMP,
            "shell": ball(1.0, glass(1.5), None),
            "liquid": ball(0.8, {"type": "dielectric", "int_ior": 1.33, "ext_ior": 1.5}),
        },
        'it passes through shape "shell" first',
    ),
    "a film that lies on a slab": (
        lambda: {
            "light": LAMP,
            "film": box(("translate", [0, 0.02, 0]), ("scale", [2, 0.02, 2])),
            "slab": box(("translate", [0, -0.5, 0]), ("scale", [2, 0.5, 2]), interior=WITHIN),
        },
        'it passes through shape "film" first',
    ),
    "fog behind a ball of glass": (
        lambda: {
            "light": point_light((-1.2, 1.7, 0.2)),
            "room": box(("scale", 2.0), bsdf={"type": "null"}, interior=WITHIN),
            "ball": ball(0.6, glass(1.5), None, exterior=WITHIN),
        },
        'it passes through shape "ball" first',
    ),
    "a cube": (lambda: {"light": LAMP, "body": box(interior=WITHIN)}, 'it is reflected inside shape "body" first'),
    "a mirror": (
        lambda: {
            "light": point_light((-2.6, 0.4, 2.2)),
            "body": ball(),
            "mirror": {
                "type": "rectangle",
                "to_world": to(("translate", [0, 0, -2.6]), ("scale", 1.6)),
                "bsdf": {"type": "conductor"},
            },
        },
        'it is reflected by shape "mirror" first',
    ),
    "a wall": (
        lambda: {
            "light": point_light((-2.2, 1.5, 0)),
            "body": ball(),
            "wall": {
                "type": "rectangle",
                "to_world": to(("translate", [1.5, 0, 0]), ("rotate", [0, 1, 0], -90), ("scale", 2)),
                "bsdf": {"type": "diffuse", "reflectance": colour(0.2, 0.8, 0.2)},
            },
        },
        'it comes from surfaces such as shape "wall"',
    ),
}
"""Parts of a scene, and the one reason that is to be told."""


@pytest.mark.parametrize("name", MISSING)
def test_what_is_missing_is_told_by_name(name):
    parts, reason = MISSING[name]
    told = missing.in_media(read(loaded(**parts()), 0.01, cache.Cache()))
    assert any(reason in sentence for sentence in told), told
    assert all('in the medium "medium" is missing' in sentence for sentence in told)
    others = [sentence for sentence in told if reason not in sentence and "reflected" not in sentence]
    assert not others, "a reason too many"


def test_further_scattering_is_told():
    milk = read(loaded(albedo=0.998, sigma_t=6.0, light=LAMP, body=ball()), 0.01, cache.Cache())
    (told,) = missing.in_media(milk)
    assert "it has scattered before" in told and 70 < int(re.search(r"about (\d+)%", told)[1]) <= 100


# ---- Nothing is missing ----------------------------------------------------------------------

COMPLETE = [
    *(
        f"light {name}"
        for name in (
            "point",
            "spot",
            "directional",
            "sphere",
            "rectangle",
            "disk",
            "cylinder",
            "mesh",
            "constant",
            "envmap",
            "several",
            "pool",
        )
    ),
    *(
        f"boundary {name}"
        for name in (
            "eta below 1",
            "eta of 1",
            "null",
            "thin from behind",
            "open water",
            "sphere",
            "sphere of air in medium",
        )
    ),
    *(
        f"place {name}"
        for name in (
            "camera under water",
            "no boundary",
            "light in a bubble",
            "opaque outside",
            "in a mirror",
            "one behind the other",
            "standing on another",
        )
    ),
    *(f"phase {name}" for name in real.PHASES),
]
"""Of ``test_scene_kinds_against_volpath`` those that lack less than a few percent, but for what scatters again."""


@pytest.mark.parametrize("name", COMPLETE)
def test_nothing_is_told_where_nothing_is_missing(name):
    scene = real.CASES[name].scene({"type": "refscatter"}, albedo=FAINT)
    assert missing.in_media(read(scene, 0.01, cache.Cache())) == []


def test_the_table_is_long_enough():
    assert len(set(COMPLETE)) >= 20


# ---- The shares are about right --------------------------------------------------------------


def test_light_reflected_inside_a_sphere_against_its_formula():
    """Parallel light: all chords of a path through a sphere are alike, and so is what is reflected at their ends."""
    eta, sigma_t = 1.5, 0.4
    b = (np.arange(10000) + 0.5) / 10000  # distance from the axis
    cos_i, cos_t = np.sqrt(1 - b**2), np.sqrt(1 - (b / eta) ** 2)
    F = 0.5 * (
        ((cos_i - eta * cos_t) / (cos_i + eta * cos_t)) ** 2 + ((eta * cos_i - cos_t) / (eta * cos_i + cos_t)) ** 2
    )
    left = np.exp(-sigma_t * 2 * cos_t)
    first = b * (1 - F) * (1 - left)
    later = first * F * left / (1 - F * left)
    expected = later.sum() / (first + later).sum()
    sun = {"type": "directional", "direction": [0.3, -1, 0.2], "irradiance": 1.0}
    found = shares(loaded(albedo=1e-4, sigma_t=sigma_t, light=sun, body=ball(bsdf=glass(eta))))
    assert 0.03 < expected < 0.1
    assert abs(found[walk.INSIDE] - expected) < 0.2 * expected and found[walk.COMPUTED] == pytest.approx(
        1 - expected, rel=0.02
    )


def test_further_scattering_against_a_walk():
    """A lamp in the middle of a ball without a boundary, followed in float64."""
    sigma_t, albedo, n = 1.5, 0.8, 200000
    rng = np.random.default_rng(1)

    def directions():
        d = rng.normal(size=(n, 3))
        return d / np.linalg.norm(d, axis=1, keepdims=True)

    o, inside, orders = np.zeros((n, 3)), np.ones(n, bool), []
    for order in range(20):
        o = o + rng.exponential(1 / sigma_t, (n, 1)) * directions()
        inside &= np.linalg.norm(o, axis=1) < 1
        orders.append(albedo ** (order + 1) * inside.mean())
    expected = 1 - orders[0] / sum(orders)
    lamp = point_light((0, 0, 0))
    found = shares(loaded(albedo=albedo, sigma_t=sigma_t, light=lamp, body=ball(bsdf={"type": "null"})))
    assert 0.3 < expected < 0.6 and found[walk.FURTHER] == pytest.approx(expected, rel=0.1)


def test_all_of_it_is_missing_in_a_shell():
    found = shares(loaded(**MISSING["a liquid in a shell"][0]()))
    assert found[walk.COMPUTED] == 0 and found[walk.REFRACTED] > 0.7


SEEN = {
    **{
        name: real.CASES[name]
        for name in ("light point", "boundary sphere", "boundary eta above 1", "place two bodies")
    },
    "a thin sheet": real.Case(
        lambda: {"light": real.ball_light(), "body": real.cube({"type": "thindielectric", "int_ior": 1.7})}
    ),
}
"""Scenes in which volpath finds what refscatter lacks: mirror images of points it doesn't."""


@pytest.mark.slow
@pytest.mark.parametrize("name", SEEN)
def test_what_is_told_against_volpath(name):
    """All that volpath finds without a limit on depth, and all that refscatter does: what lacks is what is told,
    within 6 % of the light."""
    ours = {"type": "refscatter", "surfaces": False, "internal_bounces": 10, **SEEN[name].options}
    theirs = {"type": "volpath", "max_depth": 40, "rr_depth": 1000}
    scene, full, clear = (
        SEEN[name].scene(kind, albedo=albedo) for kind, albedo in ((ours, FAINT), (theirs, FAINT), (theirs, 0.0))
    )
    found = np.array([np.array(mi.render(scene, seed=k, spp=16)).mean() for k in range(8)])
    truth = np.array(
        [
            np.array(mi.render(full, seed=k, spp=256)).mean() - np.array(mi.render(clear, seed=k, spp=256)).mean()
            for k in range(8)
        ]
    )
    lacks = 1 - found.mean() / truth.mean()
    error = np.hypot(found.std() / found.mean(), truth.std() / truth.mean()) / np.sqrt(7)
    told = 1 - shares(scene)[walk.COMPUTED]
    print(f"{name}: lacks {lacks:.3f} +- {error:.3f}, told {told:.3f}")
    assert error < 0.03 and abs(lacks - told) < 0.06 + 3 * error


SUN = {"type": "directional", "direction": [0.3, -1, 0.2], "irradiance": 1.0}


def test_a_body_is_not_met_twice_in_a_large_scene():
    """Light of one sun in one ball is refracted once, however large the floor is."""
    black = {**floor(), "to_world": to(("translate", [0, -1.1, 0]), ("rotate", [1, 0, 0], -90), ("scale", 50))}
    black["bsdf"] = {"type": "diffuse", "reflectance": 0.0}
    assert shares(loaded(light=SUN, body=ball(), floor=black))[walk.REFRACTED] == 0


def test_light_of_the_sun_starts_above_small_water():
    """A pond in wide ground is lit by what the ground reflects, too."""
    pond = {
        "type": "rectangle",
        "to_world": to(("rotate", [1, 0, 0], -90), ("scale", 0.5)),
        "bsdf": glass(1.33),
        "interior": WITHIN,
    }
    ground = {**floor(), "to_world": to(("translate", [0, -0.5, 0]), ("rotate", [1, 0, 0], -90), ("scale", 100))}
    assert shares(loaded(sigma_t=2, light=SUN, pond=pond, ground=ground))[walk.SURFACES] > 0.1


def test_surfaces_that_are_instanced_are_not_black():
    wall = {"type": "rectangle", "to_world": to(("translate", [1.3, 0, 0]), ("rotate", [0, 1, 0], -90), ("scale", 3))}
    group = {"type": "shapegroup", "id": "group", "wall": wall}
    copy = {"type": "instance", "to_world": to(("scale", 1)), "group": {"type": "ref", "id": "group"}}
    assert shares(loaded(light=LAMP, body=ball(), group=group, copy=copy))[walk.SURFACES] > 0.05


def test_surfaces_that_cannot_say_what_they_reflect_end_no_render():
    parts = {"light": LAMP, "body": ball(), "floor": floor()}
    scene = read(loaded(**parts), 0.01, cache.Cache())
    kinds = [{"type": "hair"}, {"type": "mask", "opacity": 0.5, "bsdf": {"type": "diffuse"}}, {"type": "principled"}]
    for bsdf in kinds:
        parts["floor"] = {**floor(), "bsdf": bsdf}
        assert 0 < np.array(read(loaded(**parts), 0.01, cache.Cache()).albedos()).max() <= 1

    class Mute:
        def eval_diffuse_reflectance(self, si):
            raise RuntimeError("not in this variant")

    assert 0 < surfaces._reflected(Mute(), None) < 1
    assert np.array(scene.albedos()).max() == pytest.approx(0.5)


# ---- On surfaces, and in renders -------------------------------------------------------------

TOLD = re.compile(r"refscatter: (about .*missing.*|about .*wrong.*)")


def warnings_of(capfd, scene, **options):
    capfd.readouterr()
    scene.integrator().render(scene, **options)
    return TOLD.findall("".join(capfd.readouterr()))


def test_each_warning_comes_once_per_render(capfd, monkeypatch):
    """In several passes, in one render after the other, and where another integrator calls ``sample``."""
    monkeypatch.setattr("mitsuba_refscatter.tolerances.PASS_SAMPLES", 1024)
    parts = {"light": LAMP, "body": ball(bsdf={"type": "null"})}
    scene = loaded(albedo=0.9, **parts)
    once, again = (warnings_of(capfd, scene, spp=4) for _ in range(2))
    assert len(once) == 1 and once == again
    wrapped = {"type": "aov", "aovs": "depth:depth", "inside": {"type": "refscatter"}}
    assert warnings_of(capfd, loaded(albedo=0.9, integrator=wrapped, **parts), spp=4) == once


def test_measurements_say_nothing(capfd):
    scene = loaded(albedo=0.9, light=LAMP, body=ball(bsdf={"type": "null"}))
    integrator = mi.load_dict({"type": "refscatter"})
    integrator.render(scene, spp=1, hooks=Hooks(silent=True))
    assert "missing" not in capfd.readouterr().out
    integrator.render(scene, spp=1)
    assert "missing" in capfd.readouterr().out


def test_the_first_screen_of_the_readme_says_the_same():
    readme = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
    first = " ".join(readme.partition("\n## ")[0].split())
    for said in (
        "refracted again", "reflected inside or by mirrors", "scatters more than once", "surfaces send into media",
    ):  # fmt: skip
        assert said in first, said

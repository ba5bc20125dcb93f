"""Every kind of light, of boundary, of medium and of place that a scene may hold, against ``volpath``.

One scene each. ``volpath`` connects lights through null and thindielectric boundaries; through refracting ones it
only finds those that are large. Spots and directional lights behind refraction: test_lights_with_closed_forms.py.
"""

import build
import mitsuba as mi
import numpy as np
import pytest
from against_volpath import BLOCK, WITHIN, Case, camera, colour, glass, medium, to
from build import point_light
from comparison import check, compare

pytestmark = pytest.mark.usefixtures("rgb")

LAMP = (1.6, 2.2, 1.3)
OWN = {"culling": "spindle"}
"""A light point for each camera sample: less noise in the mean than a few for all."""


def cube(bsdf=None, *steps, **more):
    """A box with the medium inside, without a boundary to be seen unless one is given."""
    return {"type": "cube", "bsdf": bsdf or {"type": "null"}, "to_world": to(*steps), "interior": WITHIN, **more}


def empty(bsdf, *steps, **more):
    """A box without medium."""
    return {"type": "cube", "bsdf": bsdf, "to_world": to(*steps), **more}


def area(radiance=10.0, **shape):
    return {**shape, "emitter": {"type": "area", "radiance": radiance}}


def ball_light(centre=LAMP, radius=0.7):
    return area(type="sphere", center=list(centre), radius=radius)


def panel(kind, *steps, radiance=None):
    """A shape above the scene that shines downwards."""
    turn = to(("translate", [0.8, 2.5, 0.5]), ("rotate", [1, 0, 0], 90), *steps)
    return area(type=kind, to_world=turn, radiance=radiance or textured())


def textured():
    pixels = np.random.default_rng(4).uniform(0.5, 4, size=(3, 5, 3)).astype(np.float32)
    return {"type": "bitmap", "raw": True, "data": mi.TensorXf(pixels), "filter_type": "nearest"}


def sky():
    pixels = np.random.default_rng(3).uniform(0.2, 2, size=(4, 8, 3)).astype(np.float32)
    return {"type": "envmap", "bitmap": mi.Bitmap(pixels), "to_world": to(("rotate", [1, 0, 0], 20))}


def spot():
    up = mi.ScalarTransform4f().look_at(origin=[0.5, 4, 1], target=[0.1, 0, 0], up=[1, 0, 0])
    return {"type": "spot", "to_world": up, "cutoff_angle": 16.0, "beam_width": 6.0, "intensity": colour(90, 60, 30),
            "texture": {"type": "checkerboard", "to_uv": to(("scale", [3, 3, 1]))}}  # fmt: skip


def projector():
    down = mi.ScalarTransform4f().look_at(origin=[0.8, 4, 1], target=[0, 0, 0], up=[1, 0, 0])
    return {"type": "projector", "to_world": down, "fov": 26.0, "irradiance": textured(), "scale": 3.0}


def sun():
    return {"type": "directional", "direction": [-0.4, -1, -0.6], "irradiance": colour(3, 2, 1)}


SLOW = dict(ours=(8, 16), theirs=(48, 256))

LIGHTS = {
    "point": Case(lambda: {"light": point_light(LAMP), "body": cube()}),
    "spot": Case(lambda: {"light": spot(), "body": cube()}),
    "projector": Case(lambda: {"light": projector(), "body": cube()}),
    "directional": Case(lambda: {"light": sun(), "body": cube()}),
    "sphere": Case(lambda: {"light": ball_light(radius=0.3), "body": cube()}, options=OWN),
    "rectangle": Case(lambda: {"light": panel("rectangle"), "body": cube()}, options=OWN),
    "disk": Case(lambda: {"light": panel("disk"), "body": cube()}, options=OWN),
    "cylinder": Case(
        lambda: {"light": panel("cylinder", ("scale", 0.4)), "body": cube()},
        options=OWN,
        ours=(8, 16),
        theirs=(32, 256),
    ),
    "mesh": Case(lambda: {"light": panel("cube", ("scale", 0.4), radiance=4.0), "body": cube()}, options=OWN),
    "constant": Case(lambda: {"light": {"type": "constant", "radiance": colour(1, 2, 3)}, "body": cube()}, options=OWN),
    "envmap": Case(lambda: {"light": sky(), "body": cube()}, options=OWN),
    "sunsky": Case(
        lambda: {"light": {"type": "sunsky", "sun_direction": [0.5, 0.6, 0.4]}, "body": cube()}, options=OWN
    ),
    "several": Case(
        lambda: {
            "a": sky(),
            "b": sun(),
            "c": panel("disk"),
            "d": ball_light(),
            "e": spot(),
            "f": point_light(LAMP),
            "body": cube(),
        },
        options=OWN,
    ),
    "pool": Case(
        lambda: {"a": sky(), "c": panel("disk"), "d": ball_light(), "body": cube()},
        ours=(8, 4),
        options={"light_samples": 128},
    ),
    "sphere through glass": Case(
        lambda: {"light": ball_light(), "body": cube(glass(1.3))}, depth=4, options=OWN, **SLOW
    ),
    "envmap through glass": Case(lambda: {"light": sky(), "body": cube(glass(1.3))}, depth=4, options=OWN, **SLOW),
    "pool through glass": Case(
        lambda: {"a": sky(), "c": panel("disk"), "body": cube(glass(1.3))},
        depth=4,
        options={"light_samples": 64},
        ours=(8, 8),
        theirs=(32, 256),
    ),
}

TINTED = {"specular_transmittance": colour(0.9, 0.5, 0.3), "specular_reflectance": colour(0.3, 0.8, 0.6)}


def water(eta, size=40.0):
    """A plane that ends far outside of what matters, with the medium below."""
    return {"type": "rectangle", "to_world": to(("rotate", [1, 0, 0], -90), ("scale", size)), "bsdf": glass(eta),
            "interior": WITHIN}  # fmt: skip


def endless(scale=1.0):
    """A medium without end. volpath draws distances for one colour and weighs the others by it: the variance of a
    colour whose extinction is less than half of another's is infinite."""
    return medium(sigma_t=(0.5, 0.6, 0.8), scale=scale)


def dense():
    return endless(2.0)


BOUNDARIES = {
    "eta above 1": Case(lambda: {"light": ball_light(), "body": cube(glass(1.5))}, depth=4, options=OWN, **SLOW),
    "eta below 1": Case(
        lambda: {"light": ball_light(), "body": cube(glass(0.8))}, depth=4, options=OWN, ours=(8, 32), theirs=(48, 256)
    ),
    "eta of 1": Case(lambda: {"light": ball_light(), "body": cube(glass(1.0))}, depth=4, options=OWN, **SLOW),
    "tinted": Case(lambda: {"light": ball_light(), "body": cube(glass(1.3, **TINTED))}, depth=4, options=OWN, **SLOW),
    "null": Case(lambda: {"light": point_light(LAMP), "body": cube({"type": "null"}, ("rotate", [1, 2, 0], 30))}),
    "thin": Case(lambda: {"light": point_light(LAMP), "body": cube({"type": "thindielectric", "int_ior": 1.7})}),
    "thin and tinted": Case(lambda: {"light": sun(), "body": cube({"type": "thindielectric", **TINTED})}),
    "two straight ones": Case(
        lambda: {
            "light": point_light((0.4, 5, 0.2)),
            "body": cube(),
            "lid": empty({"type": "thindielectric"}, ("translate", [0, 2.6, 0])),
        }
    ),
    "thin from behind": Case(
        lambda: {
            "light": point_light(LAMP),
            "body": cube(),
            "pane": {
                "type": "rectangle",
                "to_world": to(("translate", [0, 0, 3.4]), ("rotate", [0, 1, 0], 125), ("scale", 3)),
                "bsdf": {"type": "thindielectric", "int_ior": 1.7},
            },
        }
    ),
    "open water": Case(
        lambda: {"light": ball_light((0.5, 1.6, 0.3), 0.6), "body": water(1.33), "sensor": camera((0, 2, 3), fov=40)},
        depth=4,
        medium=dense,
        options=OWN,
        **SLOW,
    ),
    "sphere": Case(
        lambda: {"light": ball_light(), "body": {**cube(glass(1.3)), "type": "sphere"}}, depth=4, options=OWN, **SLOW
    ),
    "sphere of air in medium": Case(
        lambda: {
            "light": point_light((0.2, 2.6, 1.5)),
            "sensor": camera(medium=WITHIN),
            "body": {"type": "sphere", "bsdf": {"type": "null"}, "exterior": WITHIN},
        },
        medium=endless,
    ),
    "closed cylinder": Case(
        lambda: {
            "light": ball_light(),
            "side": {**cube(glass(1.3), ("scale", [1, 1, 0.8])), "type": "cylinder"},
            "front": {**cube(glass(1.3), ("scale", [1, 1, 0.8]), ("translate", [0, 0, 1])), "type": "disk"},
            "back": {**cube(glass(1.3), ("scale", [1, 1, 0.8]), ("rotate", [1, 0, 0], 180)), "type": "disk"},
        },
        depth=4,
        options=OWN,
        optimize=False,
        **SLOW,
    ),
}

PLACES = {
    "camera inside": Case(
        lambda: {
            "light": ball_light(),
            "body": cube(glass(1.3)),
            "sensor": camera((0, 0.2, 0.9), fov=60, medium=WITHIN),
        },
        depth=3,
        options=OWN,
        **SLOW,
    ),
    "camera under water": Case(
        lambda: {
            "light": ball_light((0.5, 1.6, 0.3), 0.6),
            "body": water(1.33),
            "sensor": camera((0, -1, 3), (0, -0.5, 0), fov=40, medium=WITHIN),
        },
        depth=3,
        medium=dense,
        options=OWN,
        ours=(8, 16),
        theirs=(24, 512),
    ),
    "light inside": Case(
        lambda: {"light": ball_light((0.2, 0.1, 0), 0.3), "body": cube(glass(1.3))},
        depth=3,
        options=OWN,
        ours=(8, 64),
        theirs=(24, 64),
    ),
    # Not in view: past a point light in view volpath's variance is infinite
    # (test_lights_with_closed_forms.test_airlight_in_glass).
    "both inside": Case(
        lambda: {
            "light": point_light((-0.8, 0.2, 0.8)),
            "body": cube(glass(1.3)),
            "sensor": camera((0, 0.2, 0.9), fov=60, medium=WITHIN),
        }
    ),
    "no boundary": Case(
        lambda: {"light": point_light((0.2, 2.6, 1.5)), "sensor": camera(medium=WITHIN)},
        medium=endless,
        theirs=(24, 512),
    ),
    "light in a bubble": Case(
        lambda: {
            "light": ball_light((0, 0, 0), 0.8),
            "sensor": camera((0, 2, 5), (0, 3.6, 0), fov=40, medium=WITHIN),
            "body": empty(glass(0.9), exterior=WITHIN),
        },
        depth=3,
        medium=endless,
        options=OWN,
        ours=(8, 16),
        theirs=(64, 256),
    ),
    "bubble in glass": Case(
        lambda: {
            "light": ball_light(),
            "body": cube(glass(1.3)),
            "bubble": empty(glass(1 / 1.3), ("translate", [0.1, -0.2, 0.2]), ("scale", 0.4), exterior=WITHIN),
        },
        depth=4,
        options=OWN,
        **SLOW,
    ),
    "opaque outside": Case(
        lambda: {
            "light": point_light(LAMP),
            "body": cube(),
            "block": empty({"type": "diffuse", "reflectance": 0.0}, ("translate", [0.9, 1.4, 0.8]), ("scale", 0.3)),
        }
    ),
    "opaque inside": Case(
        lambda: {
            "light": ball_light(),
            "body": cube(glass(1.3)),
            "block": {"type": "sphere", "radius": 0.5, "bsdf": {"type": "diffuse", "reflectance": 0.0}},
        },
        depth=4,
        options=OWN,
        **SLOW,
    ),
    "in a mirror": Case(
        lambda: {
            "light": point_light((2, 2, 9)),
            "body": cube({"type": "null"}, ("translate", [0, 0, 7])),
            "mirror": {"type": "rectangle", "to_world": to(("scale", 5)), "bsdf": {"type": "conductor"}},
            "sensor": camera((0, 0.3, 4), (0, 0, 0), fov=20),
        },
        depth=3,
        options={"internal_bounces": 1},
    ),
    "through glass": Case(
        lambda: {
            "light": ball_light(),
            "body": cube(glass(1.2)),
            "sensor": camera((0, 0, 6), fov=15),
            "window": empty(glass(1.3), ("translate", [0, 0, 3])),
        },
        depth=6,
        options={**OWN, "internal_bounces": 1},
        **SLOW,
    ),
    "two bodies": Case(
        lambda: {
            "light": ball_light((0, 2.4, 0.6)),
            "a": cube(glass(1.3), ("translate", [-0.9, 0, 0]), ("scale", 0.8)),
            "b": cube(glass(1.6), ("translate", [0.9, 0, 0.4]), ("rotate", [0, 1, 0], 30), ("scale", 0.6)),
        },
        depth=4,
        options=OWN,
        **SLOW,
    ),
    "one behind the other": Case(
        lambda: {
            "light": point_light((0, 2.6, 0.4)),
            "a": cube({"type": "null"}, ("translate", [0, 0, 1.2]), ("scale", 0.4)),
            "b": cube({"type": "null"}, ("translate", [0.1, 0.1, -1]), ("scale", 0.7)),
        }
    ),
    "standing on another": Case(
        lambda: {
            "light": point_light((0.3, 2.9, 0.4)),
            "a": cube({"type": "null"}, ("translate", [0, -0.5, 0])),
            "b": cube({"type": "null"}, ("translate", [0.2, 1.0, 0]), ("scale", 0.5)),
        },
        optimize=False,
    ),
    "instances": Case(
        lambda: {
            "light": ball_light((0, 2.4, 0.6)),
            "group": {"type": "shapegroup", "id": "group", "a": cube(glass(1.3), ("scale", 0.7))},
            **{
                f"copy{k}": {
                    "type": "instance",
                    "group": {"type": "ref", "id": "group"},
                    "to_world": to(("translate", [x, 0, 0]), ("rotate", [0, 1, 0], 25), ("scale", [sign, 1, 1])),
                }
                for k, (x, sign) in enumerate(((-1, 1), (1, -1)))
            },
        },
        depth=4,
        options=OWN,
        **SLOW,
    ),
}

PHASES = {
    "rayleigh": {"type": "rayleigh"},
    "tabulated": {"type": "tabphase", "values": "0.2, 0.5, 1.0, 3.0"},
    "blend": {"type": "blendphase", "weight": 0.3, "a": {"type": "hg", "g": 0.8}, "b": {"type": "hg", "g": -0.3}},
    "sggx": {"type": "sggx", "S": {"type": "gridvolume", "grid": None}},
}


def phase(name):
    """A scene with a phase function."""

    def scattering():
        properties = dict(PHASES[name])
        if name == "sggx":
            fibres = np.array([0.9, 0.3, 0.1, 0.1, 0.05, -0.05], np.float32)
            properties["S"] = {"type": "gridvolume", "grid": mi.VolumeGrid(np.tile(fibres, (2, 2, 2, 1)))}
        return medium(phase=properties)

    return Case(lambda: {"light": point_light(LAMP), "body": cube()}, medium=scattering)


CASES = {
    **{f"light {name}": case for name, case in LIGHTS.items()},
    **{f"boundary {name}": case for name, case in BOUNDARIES.items()},
    **{f"place {name}": case for name, case in PLACES.items()},
    **{f"phase {name}": phase(name) for name in PHASES},
}


LONG = (
    "boundary open water", "boundary sphere", "light pool", "light pool through glass", "light projector",
    "light sunsky", "place light in a bubble", "place camera under water", "boundary closed cylinder",
    "place through glass",
)  # fmt: skip
"""Half a minute each, most of it for kernels: of a kind that others are of, too."""


@pytest.mark.parametrize("name", build.slow_ones(CASES, LONG))
def test_scene(name):
    check(CASES[name].agreement(name), mean_error=0.012, block_error=0.08)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_volpath_still_finds_what_is_kept(name):
    case = CASES[name]
    check(compare(case.by_volpath(seed=1000), case.kept(name), BLOCK), mean_error=0.02, block_error=0.12)

"""The list of what a scene may hold: each entry that is refused is refused with its words, each that is supported has
scenes that are compared with something else, and the README shows the list."""

import re
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import test_lights
import test_real_scenes as real
from faults import BALL, HONEY, Maker, amber, glass, moved, rectangle, refused, render, sensor, with_faces
from test_bad_input import FLIPPED
from test_camera_side import CUP
from test_refusals import with_fins
from test_unsupported import BOUNDARIES, MEDIA, OVERLAPPING

from mitsuba_refscatter.scene import support


@pytest.fixture
def make(rgb, tmp_path):
    return Maker(tmp_path)


def test_the_readme_shows_the_list():
    readme = Path(__file__).parent.parent / "README.md"
    assert support.table() in readme.read_text(encoding="utf-8")


# ---- Refused ---------------------------------------------------------------------------------


def with_gradients(make):
    scene = make.scene()
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters["lamp.position"])
    parameters.update()
    return scene


REFUSED = {
    "emitter": lambda make: make.scene(panel=rectangle(emitter={"type": "directionalarea", "radiance": 1.0})),
    "perturbed": lambda make: make.scene(ball=make.ball(bsdf=BOUNDARIES["bumpmap"][0]())),
    "bsdf": lambda make: make.scene(ball=make.ball(bsdf={"type": "roughdielectric"})),
    "tint varies": lambda make: make.scene(ball=make.ball(bsdf=BOUNDARIES["texture"][0]())),
    "shines": lambda make: make.scene(ball=make.ball(emitter={"type": "area", "radiance": 1.0})),
    "shape": lambda make: make.scene(
        other={"type": "sdfgrid", "grid": mi.TensorXf(np.linspace(-1, 1, 8, dtype=np.float32).reshape(2, 2, 2, 1)), "bsdf": glass(), "interior": amber()}
    ),
    "to_world": lambda make: make.scene(
        ball={"type": "sphere", "bsdf": glass(), "interior": amber(), "to_world": mi.ScalarTransform4f().scale([1, 1, 0.5])}
    ),
    "winding": lambda make: make.scene(ball=make.ball(with_faces(FLIPPED))),
    "crowded": lambda make: make.scene(ball=make.ball(with_fins(1))),
    "repeated": lambda make: make.scene(ball=make.ball(with_faces(np.concatenate([BALL.faces, BALL.faces[:1]])))),
    "hole": lambda make: make.scene(ball=make.ball(CUP), sensor=sensor((0, 3, 3))),
    "overlap": lambda make: make.scene(other=make.ball(OVERLAPPING, eta=1.3)),
    "exterior": lambda make: make.scene(inner=make.ball(moved(BALL, 0.1, scale=0.4), eta=1.3)),
    "straight inside": lambda make: make.scene(
        ball=make.ball(interior={"type": "ref", "id": "around"}),
        cloud={"type": "cube", "to_world": mi.ScalarTransform4f().scale(0.2), "bsdf": {"type": "null"}, "interior": amber(),
               "exterior": {"type": "ref", "id": "around"}},
        a_medium={**amber(), "id": "around"},
    ),
    "camera medium": lambda make: make.scene(sensor=sensor((0.1, 0.1, 0.2))),
    "sensor medium": lambda make: make.scene(sensor=sensor(medium=amber())),
    "sensor outside": lambda make: make.scene(
        a_medium={**amber(), "id": "honey"}, ball=make.ball(interior=HONEY), sensor=sensor(medium=HONEY)
    ),
    "medium": lambda make: make.scene(ball=make.ball(interior=MEDIA["heterogeneous"][0]())),
    "varies": lambda make: make.scene(ball=make.ball(interior=MEDIA["albedo varies"][0]())),
    "twice": lambda make: make.scene(integrator={"type": "refscatter", "inside": {"type": "volpath"}}),
    "gradients": with_gradients,
}  # fmt: skip
"""A scene for each entry."""


@pytest.mark.parametrize("key", support.REFUSED)
def test_refused(make, key):
    words = re.sub(r"\\{\w+\\}", ".+", re.escape(support.REFUSED[key].says))
    sentence = refused(lambda: REFUSED[key](make))
    assert re.search(words, sentence), sentence


# ---- Supported -------------------------------------------------------------------------------

SUPPORTED = {
    "point": [real.BOUNDARIES["null"], test_lights.test_airlight],
    "spot": [real.LIGHTS["spot"], test_lights.test_spot],
    "directional": [real.LIGHTS["directional"], test_lights.test_directional],
    "area": [real.LIGHTS[name] for name in ("sphere", "rectangle", "disk", "cylinder", "mesh", "sphere through glass")],
    "environment": [real.LIGHTS[name] for name in ("constant", "envmap", "envmap through glass")],
    "several": [real.LIGHTS[name] for name in ("several", "pool", "pool through glass")],
    "dielectric": [real.BOUNDARIES[name] for name in ("eta above 1", "eta below 1", "eta of 1")],
    "straight": [real.BOUNDARIES[name] for name in ("null", "thin", "thin from behind", "two straight ones")],
    "tints": [real.BOUNDARIES[name] for name in ("tinted", "thin and tinted")],
    "mesh": [real.BOUNDARIES["open water"], test_lights.test_under_water],
    "analytic": [real.BOUNDARIES[name] for name in ("sphere", "closed cylinder")],
    "instance": [real.PLACES["instances"]],
    "camera": [real.PLACES[name] for name in ("camera inside", "camera under water", "no boundary")],
    "light inside": [real.PLACES[name] for name in ("light inside", "both inside", "light in a bubble")],
    "opaque": [real.PLACES[name] for name in ("opaque outside", "opaque inside")],
    "bodies": [real.PLACES["two bodies"], real.PLACES["standing on another"], test_lights.test_bodies_that_touch],
    "nested": [real.PLACES["bubble in glass"], test_lights.test_hollow_shell],
    "seen": [real.PLACES["in a mirror"], real.PLACES["through glass"]],
    "glass between": ["test_glass_between_is_a_shadow"],
    "homogeneous": [real.BOUNDARIES["open water"]],
    "hg": [test_lights.test_airlight],
    "phase": list(real.PHASES),
}
"""Where each entry is compared with volpath, the oracle or a closed form."""


def test_every_entry_is_compared():
    assert SUPPORTED.keys() == support.SUPPORTED.keys() and all(SUPPORTED.values())


def test_glass_between_is_a_shadow(make):
    """A pane of clear glass between light and body is as dark as a board."""
    at = mi.ScalarTransform4f().translate([-1.5, 1.5, 0]).rotate([0, 0, 1], 45).rotate([1, 0, 0], 90).scale(0.3)
    panes = [{"type": "rectangle", "to_world": at, "bsdf": bsdf} for bsdf in (glass(), {"type": "diffuse"})]
    clear, board = (render(make.scene(pane=pane)) for pane in panes)
    assert 0 < board.sum() < 0.9 * render(make.scene()).sum()
    np.testing.assert_allclose(clear, board, rtol=1e-3, atol=1e-3 * board.max())

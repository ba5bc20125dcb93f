"""The list of what a scene may hold: each entry that is refused is refused with its words, each that is supported has
scenes that are compared with something else, and the README shows the list."""

import dataclasses
import inspect
import re
import struct
import zlib
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import test_lights_with_closed_forms
import test_scene_kinds_against_volpath as real
from faults import BALL, HONEY, Maker, amber, glass, moved, rectangle, refused, render, sensor, with_faces
from test_bad_input import FLIPPED
from test_camera_in_wrong_medium import CUP
from test_damaged_files import write_obj
from test_refusals_name_one_cause import with_fins
from test_refused_scenes import BOUNDARIES, MEDIA, OVERLAPPING

from mitsuba_refscatter.options import Options
from mitsuba_refscatter.scene import support


@pytest.fixture
def make(rgb, tmp_path):
    return Maker(tmp_path)


def test_the_readme_shows_the_list():
    readme = Path(__file__).parent.parent / "mitsuba_refscatter" / "README.md"
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
        other={
            "type": "sdfgrid",
            "grid": mi.TensorXf(np.linspace(-1, 1, 8, dtype=np.float32).reshape(2, 2, 2, 1)),
            "bsdf": glass(),
            "interior": amber(),
        }
    ),
    "to_world": lambda make: make.scene(
        ball={
            "type": "sphere",
            "bsdf": glass(),
            "interior": amber(),
            "to_world": mi.ScalarTransform4f().scale([1, 1, 0.5]),
        }
    ),
    "winding": lambda make: make.scene(ball=make.ball(with_faces(FLIPPED))),
    "crowded": lambda make: make.scene(ball=make.ball(with_fins(1))),
    "repeated": lambda make: make.scene(ball=make.ball(with_faces(np.concatenate([BALL.faces, BALL.faces[:1]])))),
    "hole": lambda make: make.scene(ball=make.ball(CUP), sensor=sensor((0, 3, 3))),
    "overlap": lambda make: make.scene(other=make.ball(OVERLAPPING, eta=1.3)),
    "exterior": lambda make: make.scene(inner=make.ball(moved(BALL, 0.1, scale=0.4), eta=1.3)),
    "straight inside": lambda make: make.scene(
        ball=make.ball(interior={"type": "ref", "id": "around"}),
        cloud={
            "type": "cube",
            "to_world": mi.ScalarTransform4f().scale(0.2),
            "bsdf": {"type": "null"},
            "interior": amber(),
            "exterior": {"type": "ref", "id": "around"},
        },
        a_medium={**amber(), "id": "around"},
    ),
    "camera medium": lambda make: make.scene(sensor=sensor((0.1, 0.1, 0.2))),
    "sensor medium": lambda make: make.scene(sensor=sensor(medium=amber())),
    "sensor outside": lambda make: make.scene(
        a_medium={**amber(), "id": "honey"}, ball=make.ball(interior=HONEY), sensor=sensor(medium=HONEY)
    ),
    "medium": lambda make: make.scene(ball=make.ball(interior=MEDIA["heterogeneous"][0]())),
    "varies": lambda make: make.scene(ball=make.ball(interior=MEDIA["albedo varies"][0]())),
    "gradients": with_gradients,
}
"""A scene for each entry."""


@pytest.mark.parametrize("key", support.REFUSED)
def test_refused(make, key):
    words = re.sub(r"\\{\w+\\}", ".+", re.escape(support.REFUSED[key].says))
    sentence = refused(lambda: REFUSED[key](make))
    assert re.search(words, sentence), sentence


# ---- Supported -------------------------------------------------------------------------------


def test_formats_of_meshes(make):
    """The same ball from all of them."""
    images = {"ply": render(make.scene())}
    write_obj(BALL, make.folder / "ball.obj")
    write_serialized(BALL, make.folder / "ball.serialized")
    for kind in ("obj", "serialized"):
        shape = make.ball(type=kind, filename=str(make.folder / f"ball.{kind}"))
        images[kind] = render(make.scene(ball=shape))
        np.testing.assert_allclose(images[kind], images["ply"], rtol=1e-4, atol=1e-5 * images["ply"].max())


def write_serialized(mesh, path):
    """One mesh with normals in the format of Mitsuba's documentation, version 4, single precision."""
    parts = struct.pack("<IBQQ", 0x1001, 0, len(mesh.vertices), len(mesh.faces))
    arrays = ((mesh.vertices, "<f4"), (mesh.normals, "<f4"), (mesh.faces, "<u4"))
    body = zlib.compress(parts + b"".join(np.asarray(x, kind).tobytes() for x, kind in arrays))
    path.write_bytes(struct.pack("<HH", 0x041C, 4) + body + struct.pack("<QI", 0, 1))


def test_glass_between_is_a_shadow(make):
    """A pane of clear glass between light and body is as dark as a board."""
    at = mi.ScalarTransform4f().translate([-1.5, 1.5, 0]).rotate([0, 0, 1], 45).rotate([1, 0, 0], 90).scale(0.3)
    panes = [{"type": "rectangle", "to_world": at, "bsdf": bsdf} for bsdf in (glass(), {"type": "diffuse"})]
    clear, board = (render(make.scene(pane=pane)) for pane in panes)
    assert 0 < board.sum() < 0.9 * render(make.scene()).sum()
    np.testing.assert_allclose(clear, board, rtol=1e-3, atol=1e-3 * board.max())


SUPPORTED = {
    "point": ["boundary null", test_lights_with_closed_forms.test_airlight],
    "spot": ["light spot", "light projector", test_lights_with_closed_forms.test_spot],
    "directional": ["light directional", test_lights_with_closed_forms.test_directional],
    "area": [f"light {name}" for name in ("sphere", "rectangle", "disk", "cylinder", "mesh", "sphere through glass")],
    "environment": [f"light {name}" for name in ("constant", "envmap", "sunsky", "envmap through glass")],
    "several": [f"light {name}" for name in ("several", "pool", "pool through glass")],
    "dielectric": [f"boundary {name}" for name in ("eta above 1", "eta below 1", "eta of 1")],
    "straight": [f"boundary {name}" for name in ("null", "thin", "thin from behind", "two straight ones")],
    "tints": [f"boundary {name}" for name in ("tinted", "thin and tinted")],
    "mesh": [
        "boundary open water",
        "boundary eta above 1",
        test_lights_with_closed_forms.test_under_water,
        test_formats_of_meshes,
    ],
    "analytic": [f"boundary {name}" for name in ("sphere", "closed cylinder")],
    "instance": ["place instances"],
    "camera": [f"place {name}" for name in ("camera inside", "camera under water", "no boundary")],
    "light inside": [f"place {name}" for name in ("light inside", "both inside", "light in a bubble")],
    "opaque": [f"place {name}" for name in ("opaque outside", "opaque inside")],
    "bodies": ["place two bodies", "place standing on another", test_lights_with_closed_forms.test_bodies_that_touch],
    "nested": ["place bubble in glass", test_lights_with_closed_forms.test_hollow_shell],
    "seen": ["place in a mirror", "place through glass"],
    "glass between": [test_glass_between_is_a_shadow],
    "homogeneous": ["boundary open water"],
    "hg": [test_lights_with_closed_forms.test_airlight],
    "phase": [f"phase {name}" for name in real.PHASES],
}
"""Where each entry is compared with volpath, the oracle or a closed form: names of cases of
``test_scene_kinds_against_volpath``, and tests."""


def described(place):
    """What a case or a test holds, as text: the scene, or the code of the test and of the helpers that it calls."""
    if isinstance(place, str):
        return str([real.CASES[place].parts(), real.CASES[place].medium()])
    todo, seen = [place], {}
    while todo:
        function = inspect.unwrap(todo.pop())
        if inspect.isfunction(function) and function not in seen:
            seen[function] = inspect.getsource(function)
            todo += [function.__globals__.get(name) for name in function.__code__.co_names]
    return "".join(seen.values())


@pytest.mark.parametrize("key", support.SUPPORTED)
def test_every_entry_is_compared(rgb, key):
    """Each plugin and property that the entry names stands in one of its scenes; and what pytest runs are all of
    them."""
    places = SUPPORTED[key]
    tests = [place for place in places if not isinstance(place, str)]
    assert places and all(
        hasattr(inspect.getmodule(test), test.__name__) and test.__name__.startswith("test_") for test in tests
    )
    text = "".join(map(described, places))
    options = {field.name for field in dataclasses.fields(Options)}
    for name in set(re.findall(r"`(\w+)`", support.SUPPORTED[key].name)) - options:
        assert re.search(rf"\b{name}\b", text), f"no scene with {name}"

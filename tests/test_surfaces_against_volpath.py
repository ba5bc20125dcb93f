"""Surfaces lit through media that absorb, whole images against ``volpath`` at the same depth: with albedo 0 there
is nothing else.

Blocks whose light ``volpath`` finds by rare paths alone have large standard errors, and are no worse for that.
"""

import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Callable

import build
import mitsuba as mi
import numpy as np
import pytest
import references
from against_volpath import BLOCK, RES, camera, colour, glass, to
from build import point_light
from comparison import block_means, check, compare

from mitsuba_refscatter.benchmarks import timing

pytestmark = pytest.mark.usefixtures("rgb")

FLOOR_TO = (("rotate", [1, 0, 0], -90), ("scale", 10))
SKY = {"type": "constant", "radiance": colour(0.7, 0.6, 0.5)}


def squares(a=0.2, b=0.7, size=12):
    return {
        "type": "diffuse",
        "reflectance": {
            "type": "checkerboard",
            "color0": colour(a, a, a),
            "color1": colour(b, b, b),
            "to_uv": mi.ScalarTransform4f().scale(size),
        },
    }


def floor(bsdf=None, y=0.0):
    return {"type": "rectangle", "to_world": to(("translate", [0, y, 0]), *FLOOR_TO), "bsdf": bsdf or squares()}


def dark(*sigma_t, **more):
    """A medium that absorbs."""
    return {"type": "homogeneous", "sigma_t": colour(*sigma_t), "albedo": colour(0, 0, 0), **more}


def ball(x, y=1.0, radius=1.0, bsdf=None, **more):
    return {"type": "sphere", "center": [x, y, 0], "radius": radius, "bsdf": bsdf or glass(1.5), **more}


def over_the_floor(**parts):
    return {"sensor": camera(origin=(0, 2.4, 7), target=(0, 0.6, 0)), "sky": SKY, "floor": floor(), **parts}


def black_drop():
    drop = ball(0, bsdf=glass(1.33), interior=dark(1, 1, 1, scale=40))
    return over_the_floor(drop=drop, floor=floor({"type": "diffuse", "reflectance": colour(0.5, 0.5, 0.5)}))


def tinted_glass():
    red = ball(1.1, interior=dark(0.02, 1, 1, scale=1.5))
    return over_the_floor(lamp=point_light((-3, 4, 2), (30, 30, 30)), clear=ball(-1.1), red=red)


def flash_under_water():
    """Lamp and camera under water, a chart before them."""
    sea = {"type": "ref", "id": "sea"}
    return {
        "sea": {**dark(0.35, 0.2, 0.15), "id": "sea"},
        "sensor": camera(origin=(0, -1.6, 6), target=(0, -2.2, 0), fov=60, medium=sea),
        "lamp": point_light((0.2, -1.6, 6), (6, 6, 6)),
        "water": {
            "type": "rectangle",
            "to_world": to(("rotate", [1, 0, 0], -90), ("scale", 60)),
            "bsdf": glass(1.33),
            "interior": sea,
        },
        "chart": {"type": "rectangle", "to_world": to(("translate", [0, -2.2, 0])), "bsdf": squares()},
        "ground": floor(y=-4.0),
    }


def lamp_in_fog():
    """A lamp and an opaque board in fog between null walls."""
    fog = {"type": "cube", "to_world": to(("scale", 2.0)), "bsdf": {"type": "null"}, "interior": dark(0.2, 0.4, 0.6)}
    board = {"type": "rectangle", "to_world": to(("translate", [0.4, 0, 0]), ("rotate", [0, 1, 0], 30), ("scale", 0.8)),
             "bsdf": {"type": "twosided", "nested": squares(size=4)}}  # fmt: skip
    return {
        "sensor": camera(origin=(0.3, 0.5, 7)),
        "lamp": point_light((-1.2, 0.6, 1.2), (3, 3, 3)),
        "fog": fog,
        "board": board,
        "sky": {"type": "constant", "radiance": colour(0.05, 0.05, 0.05)},
    }


def one_behind_the_other():
    """A textured sky through two tinted bodies, one behind the other."""
    rng = np.random.default_rng(3)
    sky = {"type": "envmap", "bitmap": mi.Bitmap(rng.uniform(0.1, 1, (4, 8, 3)).astype(np.float32))}
    return over_the_floor(sky=sky, near=ball(0, interior=dark(0.1, 0.3, 0.6)),
                          far={**ball(0.4, interior=dark(0.6, 0.3, 0.1)), "center": [0.4, 1.0, -2.4]})  # fmt: skip


def glass_box():
    """Total reflection on all sides."""
    box = {"type": "cube", "to_world": to(("translate", [0, 1.01, 0]), ("rotate", [0, 1, 0], 30)), "bsdf": glass(1.5),
           "interior": dark(0.1, 0.2, 0.3)}  # fmt: skip
    return over_the_floor(box=box)


def camera_inside():
    """In tinted glass, looking out at a board."""
    amber = {**dark(0.1, 0.2, 0.4), "id": "amber"}
    within = {"type": "ref", "id": "amber"}
    body = ball(0, radius=2.0, bsdf=glass(1.3), interior=within)
    return {
        "amber": amber,
        "sensor": camera(origin=(0, 1.0, 1.0), target=(0, 0.9, -5), fov=50, medium=within),
        "sky": SKY,
        "floor": floor(y=-1.0),
        "body": body,
        "board": {
            "type": "rectangle",
            "to_world": to(("translate", [0, 1, -4]), ("scale", 1.5)),
            "bsdf": squares(size=4),
        },
    }


def mirror_and_sheet():
    """A mirror behind a thin sheet, in the light of a panel that both show."""
    mirror = {
        "type": "rectangle",
        "to_world": to(("translate", [-1.2, 1, -1]), ("rotate", [0, 1, 0], 30)),
        "bsdf": {"type": "conductor"},
    }
    sheet = {"type": "rectangle", "to_world": to(("translate", [1.0, 1, 1]), ("rotate", [0, 1, 0], -20)),
             "bsdf": {"type": "thindielectric", "specular_transmittance": colour(0.9, 0.7, 0.5)}}  # fmt: skip
    panel = {"type": "rectangle", "to_world": to(("translate", [0, 4, 0]), ("rotate", [1, 0, 0], 90)),
             "emitter": {"type": "area", "radiance": colour(3, 3, 3)}}  # fmt: skip
    return over_the_floor(
        mirror=mirror, sheet=sheet, panel=panel, body=ball(0, radius=0.7, y=0.7, interior=dark(0.3, 0.6, 0.9))
    )


@dataclass
class Case:
    """``parts`` of a scene; ``depth`` of its paths; options of refscatter; renders (number, samples per pixel) of
    both sides."""

    parts: Callable
    depth: int = 12
    options: tuple = ()
    ours: tuple = (8, 32)
    theirs: tuple = (48, 128)


CASES = {
    "black drop": Case(black_drop),
    "tinted glass": Case(tinted_glass),
    "flash under water": Case(flash_under_water),
    "lamp in fog": Case(lamp_in_fog),
    "one behind the other": Case(one_behind_the_other),
    "glass box": Case(glass_box, depth=24),
    "camera inside": Case(camera_inside),
    "mirror and sheet": Case(mirror_and_sheet, ours=(8, 64)),
    "short chain": Case(glass_box, depth=24, options=(("internal_bounces", 1),)),
    "few edges": Case(tinted_glass, depth=3),
}

LONG = ("one behind the other", "camera inside", "lamp in fog", "mirror and sheet")
"""Mostly for kernels: of a kind that others are of, too."""


def load(case, integrator):
    return mi.load_dict({"type": "scene", "integrator": integrator, **case.parts()}, optimize=False)


def renders(scene, count, spp, first=0):
    return np.array([np.array(mi.render(scene, seed=first + k, spp=spp)) for k in range(count)])


def ours(case):
    scene = load(case, {"type": "refscatter", "max_depth": case.depth, **dict(case.options)})
    return renders(scene, *case.ours)


def theirs(case, first=0):
    return renders(load(case, {"type": "volpath", "max_depth": case.depth, "rr_depth": 1000}), *case.theirs, first)


def kept(name):
    case = CASES[name]
    return references.of(
        f"lit through media {name}",
        {**case.parts(), "depth": case.depth, "renders": case.theirs, "res": RES},
        lambda: theirs(case),
        BLOCK,
    )


@pytest.mark.parametrize("name", build.slow_ones(CASES, LONG))
def test_surfaces_through_media(name):
    check(compare(ours(CASES[name]), kept(name), BLOCK), mean_error=0.01, block_error=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_volpath_still_finds_what_is_kept(name):
    check(compare(theirs(CASES[name], first=1000), kept(name), BLOCK), mean_error=0.01, block_error=0.05)


def test_furnace():
    """White floor, white sky and clear glass: all of it looks like the sky, as long as total reflection does not
    trap light."""
    white = {"type": "diffuse", "reflectance": colour(1, 1, 1)}
    scene = mi.load_dict(
        {
            "type": "scene",
            "sensor": camera(origin=(0, 2.4, 7), target=(0, 0.6, 0)),
            "integrator": {"type": "refscatter"},
            "sky": {"type": "constant", "radiance": colour(1, 1, 1)},
            "floor": floor(white),
            "clear": ball(-1.1),
            "dense": ball(1.1, bsdf=glass(2.0)),
        }
    )
    images = renders(scene, 8, 64)
    mean, error = images.mean((1, 2)), images.mean((1, 2)).std(0, ddof=1) / 8**0.5
    assert (error < 1e-3).all() and np.abs(mean.mean(0) - 1).max() < 5e-3
    blocks = block_means(images, BLOCK)
    z = (blocks.mean(0) - 1) / np.maximum(blocks.std(0, ddof=1) / 8**0.5, 1e-6)
    assert np.abs(blocks.mean(0) - 1).max() < 0.02 and np.median(np.abs(z)) < 1.5


def test_a_scene_without_bodies_is_that_of_path():
    """Nothing but plain surfaces, under a panel and a sky; shown is what ``path`` shows. Prints what that costs."""

    def scene(integrator):
        panel = {"type": "rectangle", "to_world": to(("translate", [0, 4, 0]), ("rotate", [1, 0, 0], 90)),
                 "emitter": {"type": "area", "radiance": colour(3, 2, 1)}}  # fmt: skip
        block = {
            "type": "cube",
            "to_world": to(("translate", [0, 1, 0])),
            "bsdf": {"type": "roughconductor", "alpha": 0.2},
        }
        parts = {"sensor": camera(origin=(0, 2.4, 7), target=(0, 0.6, 0)), "sky": SKY, "panel": panel, "block": block}
        return mi.load_dict({"type": "scene", "integrator": integrator, "floor": floor(), **parts})

    scenes = [scene({"type": name, "max_depth": 8}) for name in ("refscatter", "path")]
    ours, expected = (renders(one, 8, spp) for one, spp in zip(scenes, (64, 128)))
    check(compare(ours, expected, BLOCK), mean_error=0.003, block_error=0.02)
    works = [lambda one=one: mi.render(one, spp=256, seed=1) for one in scenes]
    timing.medians(works, 1)  # compiles
    (a, _), (b, _) = timing.medians(works, 7)
    print(f"a sample costs {a / b:.2f} times one of path")


def test_nothing_to_show_is_refused(rgb):
    """Without media and without surfaces."""
    scene = mi.load_dict({"type": "scene", "sensor": camera(), "sky": SKY, "floor": floor(),
                          "integrator": {"type": "refscatter", "surfaces": False}})  # fmt: skip
    with pytest.raises(RuntimeError, match="no body with a medium.*or set surfaces to true"):
        scene.integrator().render(scene, spp=1)


@pytest.mark.slow
def test_no_fireflies_that_volpath_lacks():
    """Of a million paths each: none brings more than a hundred times what the brightest thousandth of volpath's do."""
    found, parts = [], CASES["tinted glass"].parts()
    parts["sensor"]["film"] |= {"width": 1024, "height": 1024}
    for name in ("refscatter", "volpath"):
        scene = mi.load_dict({"type": "scene", "integrator": {"type": name, "max_depth": 12}, **parts}, optimize=False)
        found.append(np.sort(np.array(mi.render(scene, seed=1, spp=1)).max(-1).ravel()))
    a, b = found
    assert len(a) > 1e6
    bright = b[-len(b) // 1000]
    print(a[-3:], b[-3:], bright)
    assert (a > 4 * b[-1]).sum() == 0 and (a > 100 * bright).sum() <= (b > 100 * bright).sum()


@pytest.mark.slow
def test_a_spectral_variant(rgb):
    """Tinted glass under a coloured sky: ``volpath`` in the same variant."""
    if "llvm_ad_spectral" not in mi.variants():
        pytest.skip("no spectral variant")
    mi.set_variant("llvm_ad_spectral")
    body = ball(0, interior=dark(0.2, 0.4, 0.8, scale=2.0))
    parts = over_the_floor(body=body, sky={"type": "constant", "radiance": colour(0.5, 0.4, 0.3)})

    def images(integrator, count, spp):
        scene = mi.load_dict({"type": "scene", "integrator": integrator, **parts}, optimize=False, parallel=False)
        return renders(scene, count, spp)

    found = images({"type": "refscatter", "max_depth": 8}, 8, 64)
    expected = images({"type": "volpath", "max_depth": 8, "rr_depth": 1000}, 24, 64)
    mi.set_variant(rgb)
    check(compare(found, expected, BLOCK), mean_error=0.01, block_error=0.05)


SHIPPED = sorted(path.parent.name for path in (Path(__file__).parent.parent / "scenes").glob("*/scene.xml"))


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenes_without_scattering(name, tmp_path):
    """Their media absorb all that they scattered; the whole images."""
    folder = Path(__file__).parent.parent / "scenes" / name
    text = (folder / "scene.xml").read_text(encoding="utf-8")
    text, count = re.subn(r'(<\w+ name="albedo" value=")[^"]*"', r'\g<1>0"', text)
    assert count == 1
    shutil.copytree(folder, tmp_path / name)
    (tmp_path / name / "scene.xml").write_text(text, encoding="utf-8")
    scene = mi.load_file(str(tmp_path / name / "scene.xml"), res=32, optimize=False, parallel=False)

    def images(integrator, count, spp):
        return np.array(
            [np.array(mi.load_dict(integrator).render(scene, seed=k, spp=spp))[..., :3] for k in range(count)]
        )

    found = images({"type": "refscatter", "max_depth": 16}, 8, 64)
    expected = images({"type": "volpath", "max_depth": 16, "rr_depth": 1000}, 24, 128)
    if expected.max() == 0:  # a body alone, before nothing
        assert found.max() == 0
        return
    check(compare(found, expected, BLOCK), mean_error=0.02, block_error=0.1)

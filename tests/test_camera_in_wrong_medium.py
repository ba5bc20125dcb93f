"""A camera on a side of a boundary whose medium its sensor does not name is refused, from a share of its first hits
on."""

import mitsuba as mi
import numpy as np
import pytest
from faults import BALL, HONEY, Maker, amber, at, glass, moved, points_of, refused, sensor
from meshes import Mesh, box

from mitsuba_refscatter.core.cache import Cache
from mitsuba_refscatter.scene import NONE, SceneError, read, region_of_camera
from mitsuba_refscatter.transport import camera_paths
from mitsuba_refscatter.transport.camera_refusals import refuse_other_medium
from mitsuba_refscatter.transport.crossing import Hit

UP, DOWN, SIDEWAYS = (0.1, 1, 0.2), (0.1, -1, 0.2), (1, 0, 0)
CUBE = box([-1] * 3, [1] * 3)
CUP = Mesh(CUBE.vertices, CUBE.faces[(CUBE.corners[..., 1] < 0).any(axis=1)], None)
"""A cube without its top."""


@pytest.fixture
def make(rgb, tmp_path):
    return Maker(tmp_path)


def sheet(height, normal=1, size=60, **parts):
    """A square that faces up, or down."""
    turn = mi.ScalarTransform4f().translate([0, height, 0]).rotate([1, 0, 0], -90 * normal).scale(size)
    return {"type": "rectangle", "to_world": turn, **parts}


def sea(make, **parts):
    """A scene of water below y = 0, with a floor; ``parts`` in place of those of ``Maker`` or besides."""
    water = sheet(0, bsdf=glass(int_ior=1.33), interior=HONEY)
    floor = sheet(-4, bsdf={"type": "diffuse"})
    return make.scene(**{"a_medium": {**amber(), "id": "honey"}, "ball": None, "water": water, "floor": floor, **parts})


def follow(scene, o, d, medium=None):
    """Segments of camera rays o, d (n, 3) in a scene, whose sensor names a medium: sum of weight times length."""
    found = read(scene, 0.01, Cache())
    ray = mi.Ray3f(*(kind(np.asarray(x, np.float32).T) for kind, x in ((mi.Point3f, o), (mi.Vector3f, d))))
    paths = camera_paths.trace(
        found, ray, True, region_of_camera(found, medium, o[0]), camera_paths.ChainLimits(1, False, 0.0)
    )
    found = [np.array(part.weight) * np.array(part.length) for parts in paths.parts for part in parts]
    return float(sum(x.sum() for x in found))


def from_below(scene, *ways, medium=None):
    """The same for rays from y = -1, of each direction some: pairs (number, direction)."""
    d = np.concatenate([np.tile(np.array(d) / np.linalg.norm(d), (n, 1)) for n, d in ways])
    return follow(scene, np.tile([0.3, -1.0, 0.4], (len(d), 1)), d, medium)


def interior(scene, name):
    return next(shape for shape in scene.shapes() if shape.id() == name).interior_medium()


# ---- Open boundaries -------------------------------------------------------------------------


def test_a_camera_under_water(make):
    """As a user has it: the sensor forgets the medium."""
    below = sensor((0, -1.6, 6), (0, -2.2, 0))
    words = '"water"', "from its inside", 'the medium "honey"', "names no medium", "flip_normals"
    refused(lambda: sea(make, sensor=below), *words)
    scene = sea(make)
    assert from_below(scene, (50, UP), medium=interior(scene, "water")) > 1


def test_the_share_of_first_hits(make):
    """More than 1 % of the rays that hit anything, in one call; what hits nothing does not count."""
    scene = sea(make)
    from_below(scene, (1, UP), (99, DOWN), (900, SIDEWAYS))
    with pytest.raises(SceneError, match="by 2 % of the camera rays that hit anything"):
        from_below(scene, (2, UP), (98, DOWN), (900, SIDEWAYS))
    with pytest.raises(SceneError, match="by 100 % of"):
        from_below(scene, (1, UP))


def test_water_that_faces_down(make):
    """``flip_normals`` or not: the camera above it is on its inner side."""
    above, words = sensor((0, 2, 6), (0, 0, 0)), ('"water"', "from its inside", '"honey"', "flip_normals")
    down = sheet(0, -1, bsdf=glass(int_ior=1.33), interior=HONEY)
    turned = {**sheet(0, bsdf=glass(int_ior=1.33), interior=HONEY), "flip_normals": True}
    for water in (down, turned):
        refused(lambda: sea(make, sensor=above, water=water), *words)
    o, d = np.tile([0, 2.0, 0], (9, 1)), np.tile([0.6, -0.8, 0], (9, 1))
    right, twice = (follow(sea(make, **x), o, d) for x in ({}, {"water": {**down, "flip_normals": True}}))
    assert right > 1 and abs(twice / right - 1) < 1e-5


def test_another_medium_without_end(make):
    """It is named, and the boundary's; where the sensor's is right nothing is refused."""
    scene = sea(make, sensor=sensor(medium={**amber(), "id": "oil"}))
    oil, honey = scene.sensors()[0].get_medium(), interior(scene, "water")
    words = '"water" .*inside .*the medium "honey" there, but the sensor names the medium "oil"'
    with pytest.raises(SceneError, match=words):
        from_below(scene, (50, UP), (50, DOWN), medium=oil)
    assert from_below(scene, (50, UP), (50, DOWN), medium=honey) > 1


def test_above_water_with_its_medium(make):
    """Any hit is enough from outside: no ray can have slipped out of a medium without end."""
    scene = sea(make, roof=sheet(3, bsdf={"type": "diffuse"}))
    d = np.tile([0.0, 1, 0], (400, 1))
    d[7] = [0, -1, 0]
    words = '"water" .*outside by 0.25 % .*no medium there, but the sensor names the medium "honey": remove that'
    with pytest.raises(SceneError, match=words):
        follow(scene, np.tile([0.3, 1.0, 0.4], (400, 1)), d, interior(scene, "water"))


def test_panes_from_behind(make):
    """A pane without media: nothing is named and nothing refused where no medium is around; where one is, it must
    name it."""
    pane, ball = sheet(2, bsdf={"type": "null"}), make.ball(moved(BALL, 0, 5))
    o, d = np.tile([0, 1.0, 0], (9, 1)), np.tile([0.06, 0.998, 0], (9, 1))
    seen, alone = (follow(sea(make, water=None, ball=ball, **x), o, d) for x in ({"pane": pane}, {}))
    assert alone > 1 and abs(seen / alone - 1) < 1e-5
    fog = {"water": None, "pane": pane, "sensor": sensor((0, 1, 5), (0, 2, 0), medium=HONEY)}
    words = '"pane"', "from its inside", "no medium there", 'names the medium "honey"', "as its interior"
    refused(lambda: sea(make, **fog), *words)


def test_a_body_in_fog(make):
    """Its exterior says so and the sensor does not."""
    ball = make.ball(exterior=HONEY)
    words = '"ball"', "from its outside", 'the medium "honey" there', "names no medium", "exterior"
    refused(lambda: sea(make, water=None, ball=ball), *words)
    scene = sea(make, water=None, ball=ball, sensor=sensor(medium=HONEY))
    assert follow(scene, np.array([[0, 0, 3.0]]), np.array([[0, 0, -1.0]]), scene.sensors()[0].get_medium()) > 1


def test_an_open_mesh_seen_from_both_sides(make):
    """Its open edges are counted and the first is named: on the rim of a cup."""
    cup = make.ball(moved(CUP, 0, -2), interior=HONEY)
    looking = sensor((0, 3, 3), (0, -2, 0))
    words = '"ball"', "from inside", '"honey"', "fill", "4 open edges"
    rim = points_of(refused(lambda: sea(make, water=None, ball=cup, sensor=looking), *words))
    assert (rim[:, 1] == -1).all() and (np.abs(rim[:, [0, 2]]) == 1).all()
    assert np.abs(rim[1] - rim[0]).sum() == 2


# ---- Closed bodies ---------------------------------------------------------------------------


def test_rays_that_start_inside_a_closed_body(make):
    """Where the first does not: rays of an orthographic camera."""
    scene = make.scene(a_medium={**amber(), "id": "honey"}, ball=make.ball(interior=HONEY))
    o = np.array([[0, 0, 3.0]] * 60 + [[0.1, 0, 0.2]] * 40)
    words = '"ball" .*from its inside by 40 % .*the medium "honey" .*no medium: .*move it out'
    with pytest.raises(SceneError, match=words):
        follow(scene, o, np.tile([0, 0, -1.0], (100, 1)))


@pytest.mark.parametrize("inside", [True, False])
def test_a_ray_that_slips_into_a_closed_body(make, inside):
    """Found at a boundary's inside although it starts outside, even when traced again: it alone is no reason to
    refuse."""
    found = read(make.scene(), 0.01, Cache())
    leg = camera_paths.Legs(mi.Point3f(0, 0, 0.5 if inside else 3), mi.Vector3f(0, 0, -1), mi.Spectrum(1), mi.UInt32(0),
                      mi.UInt32(NONE), mi.UInt32(0), mi.UInt32(0), mi.UInt32(0), mi.Vector3f(0))  # fmt: skip
    yes, zero = mi.Bool(True), mi.UInt32(0)
    region = mi.UInt32(found.bodies[0].inside)
    hit = Hit(pi=None, valid=yes, target=zero, boundary=yes, tri=None, leaving=yes, near=region, behind=region)
    if not inside:
        return refuse_other_medium(found, leg, hit, yes)
    with pytest.raises(SceneError, match='"ball" .*inside by 100 %'):
        refuse_other_medium(found, leg, hit, yes)


def test_a_body_that_touches_the_one_around_the_camera(make):
    """By rounding rays that leave through the common face meet the other body's first: nothing is wrong with them."""
    null = {"bsdf": {"type": "null"}, "interior": HONEY}
    beside = {"type": "cube", "to_world": at(0, 0, -2 + 1e-6), "bsdf": {"type": "null"}}
    o, d = np.tile([0.1, 0.2, 0.5], (9, 1)), np.tile([0, 0, -1.0], (9, 1))
    for other in (beside, {**beside, "interior": HONEY}):
        scene = make.scene(a_medium={**amber(), "id": "honey"}, beside=other, ball=make.ball(CUBE, **null))
        assert follow(scene, o, d, interior(scene, "ball")) > 1


def test_where_the_sensor_names_a_medium_that_is_not_there(make):
    """Clear glass around the camera; a medium of a body that it is outside of; one that nothing has."""
    inside = sensor((0.1, 0.1, 0.2), medium=HONEY)
    other = {"a_medium": {**amber(), "id": "honey"}, "other": make.ball(moved(BALL, 4), interior=HONEY)}
    words = '"ball"', "around the camera", "no medium there", 'names the medium "honey"', "remove that", "interior"
    refused(lambda: make.scene(sensor=inside, ball=make.ball(interior=None), **other), *words)
    words = '"other"', 'the medium "honey"', "outside of it", "remove", "move it in"
    refused(lambda: make.scene(sensor=sensor(medium=HONEY), **other), *words)
    oil = mi.load_dict({**amber(), "id": "oil"})
    with pytest.raises(SceneError, match='the sensor names the medium "oil", which no part of the scene has'):
        follow(make.scene(), np.array([[0, 0, 5.0]]), np.array([[0, 0, -1.0]]), oil)

"""Spheres, cylinders, disks and instances become meshes: against the shapes themselves, as Mitsuba intersects them."""

import build
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from comparison import l1
from meshes import Mesh

from mitsuba_refscatter.geometry import mesh as mesh_facts
from mitsuba_refscatter.scene import tessellation
from mitsuba_refscatter.scene.errors import SceneError

GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
PAINT = {"type": "diffuse"}
MEDIUM = {"type": "homogeneous", "albedo": 0.5, "sigma_t": 1.0}


def is_glass(shape):
    return shape.bsdf().class_name() == "SmoothDielectric"


def expand(scene, tolerance=0.03):
    return tessellation.expand(scene, is_glass, tolerance)


def load(**parts):
    return mi.load_dict({"type": "scene", **parts}, optimize=False)


def turned():
    return mi.ScalarTransform4f().translate([1, -2, 3]).rotate([0.6, 0, 0.8], 70)


def transform(name):
    """Transforms by name: Mitsuba's exist only once a variant is set."""
    return {
        "none": mi.ScalarTransform4f(),
        "scaled": turned().scale(2.5),
        "mirrored": turned().scale([1, -1, 1]),
        "shrunk and mirrored": turned().scale(-0.02),
        "uneven": turned().scale([2, 2, 0.7]),
        "uneven, mirrored": turned().scale([-2, 2, 0.7]),
        "sheared": turned() @ mi.ScalarTransform4f([[1, 0.5, 0, 0], [0, 1.5, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),
    }[name]


def arrays(shape):
    """Positions, normals and faces of a ``mi.Mesh``."""
    parameters = mi.traverse(shape)
    x = [np.array(parameters[key], dtype=float).reshape(-1, 3) for key in ("vertex_positions", "vertex_normals")]
    return (*x, np.array(parameters["faces"], dtype=int).reshape(-1, 3))


def rays(o, d):
    return mi.Ray3f(*(kind(np.asarray(x, np.float32).T) for kind, x in ((mi.Point3f, o), (mi.Vector3f, d))))


def random_rays(scene, n=4000, seed=0):
    """From around the scene to points in its box."""
    rng, box = np.random.default_rng(seed), scene.bbox()
    low, high = np.array(box.min), np.array(box.max)
    target = low + (high - low) * rng.random((n, 3))
    out = rng.normal(size=(n, 3))
    out *= 2 * np.linalg.norm(high - low) / np.linalg.norm(out, axis=1, keepdims=True)
    return rays(target + out, -out / np.linalg.norm(out, axis=1, keepdims=True))


def hits(scene, ray, depth=6):
    """All hits along rays: whether there is one, distance from the start, n, sh_n, uv; each (depth, n, ...)."""
    found, travelled = [], dr.opaque(mi.Float, 0, dr.width(ray))
    for _ in range(depth):
        si = scene.ray_intersect(ray)
        travelled = travelled + dr.select(si.is_valid(), si.t, 0)
        ray = si.spawn_ray(ray.d)
        record = si.is_valid(), travelled, si.n, si.sh_frame.n, si.uv
        dr.eval(ray, record)
        found.append([np.array(x).T for x in record])
    return [np.array(x) for x in zip(*found)]


def assert_same_hits(old, new, n=4000, curved=False, uv=True):
    """Rays hit the same all the way through, but for few that meet edges."""
    ray = random_rays(old, n)
    a, b = hits(old, ray), hits(new, ray)
    same = (a[0] == b[0]).all(axis=0)
    assert same.mean() > (0.98 if curved else 0.998)
    assert a[0].sum() > n / 4
    hit = a[0] & same
    t_off, n_off, sh_off, uv_off = (np.abs(x - y)[hit] for x, y in zip(a[1:], b[1:]))
    near, share = (0.01, 0.98) if curved else (2e-4, 0.998)
    assert (t_off < near * np.ptp([old.bbox().min, old.bbox().max])).mean() > share
    assert (n_off.max(axis=1) < (0.2 if curved else 1e-3)).mean() > share
    assert (sh_off.max(axis=1) < (0.03 if curved else 3e-3)).mean() > share
    if uv:
        assert (uv_off.max(axis=1) < 1e-3).mean() > 0.99


CASES = [
    (kind, name, flip)
    for kind in ("sphere", "cylinder", "disk")
    for name in ("none", "scaled", "mirrored", "shrunk and mirrored", "uneven", "uneven, mirrored", "sheared")
    for flip in (False, True)
    if not (kind == "sphere" and "uneven" in name) and (kind == "disk" or name != "sheared")
]


@pytest.mark.parametrize(("kind", "name", "flip"), CASES)
def test_vertices_are_where_the_renderer_sees_the_shape(rgb, kind, name, flip):
    extra = {"p0": [0, 0.2, -1], "p1": [0.4, 0, 1], "radius": 0.6} if kind == "cylinder" and name == "scaled" else {}
    shape = {"type": kind, "to_world": transform(name), "flip_normals": flip, "bsdf": GLASS, **extra}
    scene = load(s=shape)
    mesh, original = expand(scene).shapes()[0], scene.shapes()[0]
    v, n, f = arrays(mesh)
    matrix = np.array(mi.traverse(original)["to_world"].matrix, dtype=float).reshape(4, 4)
    local = np.linalg.inv(matrix)
    x = v @ local[:3, :3].T + local[:3, 3]
    r2 = (x[:, :2] ** 2).sum(axis=1)
    rounding = 3e-7 * np.abs(v).max() * np.linalg.norm(local[:3, :3], 2)
    on_surface = {"sphere": r2 + x[:, 2] ** 2 - 1, "cylinder": r2 - 1, "disk": x[:, 2]}[kind]
    middle = {"sphere": x, "cylinder": x * (1, 1, 0) + (0, 0, 0.5), "disk": 0 * x}[kind]
    assert np.abs(on_surface).max() < 4 * rounding
    if kind == "cylinder":
        assert np.ptp(x[:, 2]) == pytest.approx(1, abs=4 * rounding)
    if kind == "disk":
        assert r2.max() == pytest.approx(1, abs=4 * rounding)
    x = 0.999 * (x - middle) + middle  # rays miss the very rims of open shapes
    there = v if kind == "sphere" else x @ matrix[:3, :3].T + matrix[:3, 3]
    size = np.ptp(v, axis=0).max()
    ray = rays(there + 0.1 * size * n, -n)
    si = original.compute_surface_interaction(ray, original.ray_intersect_preliminary(ray))
    assert np.array(si.is_valid()).all()
    assert np.abs(np.array(si.p).T - there).max() < 1e-5 * (size + np.abs(v).max())
    assert np.abs(np.array(si.n).T - n).max() < 1e-4
    assert np.abs(np.array(si.sh_frame.n).T - n).max() < 1e-4
    corners = v[f]
    winding = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    winding /= np.linalg.norm(winding, axis=1, keepdims=True)
    assert np.einsum("fi,fki->fk", winding, n[f]).min() > 0.9
    assert not mesh.has_flipped_normals()


def test_positions_are_float64_rounded_once(rgb):
    """Far from the origin, where a float32 computation would lose digits."""
    centre, radius = np.array([100.0, -50.0, 25.0]), 0.5
    mesh = expand(load(s={"type": "sphere", "center": centre.tolist(), "radius": radius, "bsdf": GLASS})).shapes()[0]
    v, n, _ = arrays(mesh)
    half_an_ulp = np.spacing(np.abs(v).astype(np.float32)).astype(float) / 2
    assert (np.abs(v - (centre + radius * n)) <= half_an_ulp + 6e-8 * radius).all()


def test_meshes_are_closed_or_open_as_the_shapes_are(rgb):
    scene = expand(load(s={"type": "sphere", "bsdf": GLASS}, c={"type": "cylinder", "bsdf": GLASS},
                        d={"type": "disk", "bsdf": GLASS}), tolerance=0.01)  # fmt: skip
    sphere, tube, disk = (arrays(s) for s in scene.shapes())
    rims = {}
    for name, (v, _, f) in (("sphere", sphere), ("tube", tube), ("disk", disk)):
        twin = mesh_facts.twins(f)
        assert twin is not None and len(np.unique(f)) == len(v)
        assert mesh_facts.components(f).max() == 0
        edge = np.flatnonzero(twin < 0)
        rims[name] = v[f.ravel()[edge]]
        side = np.linalg.norm(v[np.roll(f, -1, axis=1)] - v[f], axis=2)
        assert (side.max(axis=1) / side.min(axis=1)).max() < 6
    assert len(rims["sphere"]) == 0
    assert mesh_facts.volume(sphere[0][sphere[2]]) == pytest.approx(4 / 3 * np.pi, rel=0.01 / 3)
    # The rim of a disk fits that of a tube.
    assert len(rims["tube"]) == 2 * len(rims["disk"])
    lower = rims["tube"][rims["tube"][:, 2] == 0]
    assert set(map(tuple, lower)) == set(map(tuple, rims["disk"]))


def test_nothing_to_do(rgb):
    scene = load(g={"type": "shapegroup", "cube": {"type": "cube", "bsdf": PAINT}}, i=at("g"),
                 unused={"type": "shapegroup", "ball": {"type": "sphere", "bsdf": GLASS}},
                 ball={"type": "sphere", "bsdf": PAINT}, box={"type": "cube", "bsdf": GLASS})  # fmt: skip
    assert expand(scene) is scene


def at(group, where="none", **more):
    to_world = transform(where) if isinstance(where, str) else mi.ScalarTransform4f().translate(where)
    return {"type": "instance", "to_world": to_world, "g": {"type": "ref", "id": group}, **more}


def ref(name):
    return {"type": "ref", "id": name}


def test_ids_materials_and_the_rest_of_the_scene(rgb):
    down = mi.ScalarTransform4f().translate([0, -3, 0])
    film = {"type": "hdrfilm", "rfilter": {"type": "box"}}
    scene = load(
        water={**MEDIUM}, glass=GLASS, camera={"type": "perspective"},
        group={"type": "shapegroup", "ball": {"type": "sphere", "bsdf": ref("glass"), "interior": ref("water")},
               "box": {"type": "cube", "bsdf": ref("glass"), "exterior": ref("water")}},
        copy=at("group", [4, 0, 0]), other=at("group", [8, 0, 0]),
        ball={"type": "sphere", "bsdf": ref("glass"), "interior": ref("water"), "exterior": {**MEDIUM, "albedo": 0.1}},
        lamp={"type": "sphere", "center": [0, 5, 0], "bsdf": PAINT, "light": {"type": "area"}},
        meter={"type": "rectangle", "to_world": down, "sensor": {"type": "irradiancemeter", "film": film}},
        last={"type": "perspective"}, point={"type": "point", "position": [0, 0, 9]}, sky={"type": "constant"},
    )  # fmt: skip
    before = [node.id() for node in mi.traverse(scene).hierarchy]
    new = expand(scene)
    assert [node.id() for node in mi.traverse(scene).hierarchy] == before
    old, made = ({s.id(): s for s in x.shapes()} for x in (scene, new))
    assert set(made) == {"copy/ball", "copy/box", "other/ball", "other/box", "ball", "lamp", "meter"}
    assert made.pop("lamp") is old["lamp"] and made.pop("meter") is old["meter"]
    glass, water, around = old["ball"].bsdf(), old["ball"].interior_medium(), old["ball"].exterior_medium()
    assert all(s.bsdf() is glass and s.is_mesh() for s in made.values())
    media = {name: (s.interior_medium(), s.exterior_medium()) for name, s in made.items()}
    balls, boxes = (
        {f"{i}/ball": (water, None) for i in ("copy", "other")},
        {f"{i}/box": (None, water) for i in ("copy", "other")},
    )
    assert media == {"ball": (water, around), **balls, **boxes} and around is not None and around is not water
    assert [s.id() for s in new.sensors()] == ["camera", "sensor", "last"]
    assert all(a is b for a, b in zip(new.sensors(), scene.sensors()))
    assert sorted(map(id, new.emitters())) == sorted(map(id, scene.emitters()))
    assert {e.id() for e in new.emitters()} == {"point", "sky", "light"}
    assert expand(new) is new


@pytest.mark.parametrize("where", ["none", "scaled", "mirrored", "uneven", "uneven, mirrored", "sheared"])
@pytest.mark.parametrize("flip", [False, True])
def test_instanced_meshes_are_hit_where_they_were(rgb, where, flip):
    """Normals on the same side, geometric and shading, texture coordinates too; also of facets and of open meshes."""
    box = {"type": "cube", "bsdf": GLASS, "flip_normals": flip}
    facets = {**box, "face_normals": True, "to_world": mi.ScalarTransform4f().translate([3, 0, 0])}
    aside = mi.ScalarTransform4f().translate([0, 4, 0]).rotate([1, 0, 0], 50)
    sheet = {"type": "rectangle", "bsdf": GLASS, "flip_normals": flip, "to_world": aside}
    scene = load(g={"type": "shapegroup", "box": box, "facets": facets, "sheet": sheet}, i=at("g", where))
    new = expand(scene)
    assert [s.id() for s in new.shapes()] == ["i/box", "i/facets", "i/sheet"]
    assert [s.has_vertex_normals() for s in new.shapes()] == [True, False, True]
    assert_same_hits(scene, new)


@pytest.mark.parametrize("flip", [False, True])
def test_instanced_smooth_mesh_has_the_renderers_normals(rgb, tmp_path, flip):
    """Shading normals that are not those of the triangles, under an uneven, mirrored transform."""
    v, n, f = arrays(expand(load(s={"type": "sphere", "bsdf": GLASS})).shapes()[0])
    ball = build.mesh_shape(Mesh(v, f, n), tmp_path / "ball.ply")
    scene = load(g={"type": "shapegroup", "ball": {**ball, "flip_normals": flip}}, i=at("g", "uneven, mirrored"))
    new = expand(scene)
    assert_same_hits(scene, new, uv=False)
    v, n, f = arrays(new.shapes()[0])
    corners = v[f]
    assert (
        np.einsum("fi,fki->fk", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), n[f]).min() > 0
    )
    assert (mesh_facts.volume(corners) < 0) == flip


@pytest.mark.parametrize("where", ["scaled", "mirrored", "uneven", "uneven, mirrored"])
def test_instanced_analytic_shapes(rgb, where):
    """An ellipsoid is no sphere of Mitsuba's, but an instance of one is."""
    left, right, below = (mi.ScalarTransform4f().translate(x) for x in ([0, 2, 0], [0, -2, 0], [2, 0, 0]))
    scene = load(
        g={"type": "shapegroup", "ball": {"type": "sphere", "radius": 0.5, "bsdf": GLASS},
           "tube": {"type": "cylinder", "flip_normals": True, "bsdf": GLASS, "to_world": left},
           "mirror": {"type": "sphere", "bsdf": GLASS, "to_world": right.scale(-1)},
           "disk": {"type": "disk", "bsdf": GLASS, "to_world": below}},
        i=at("g", where),
    )  # fmt: skip
    new = expand(scene, 3e-3)
    assert all(s.is_mesh() for s in new.shapes())
    assert_same_hits(scene, new, curved=True, uv=False)


def test_what_is_no_boundary_stays_instanced(rgb):
    """Mixed groups: an analytic member keeps its exact surface, a mesh its texture coordinates."""
    above = mi.ScalarTransform4f().translate([0, 0, 3])
    group = {"type": "shapegroup", "box": {"type": "cube", "bsdf": GLASS},
             "ball": {"type": "sphere", "center": [0, 3, 0], "bsdf": PAINT, "flip_normals": True},
             "plate": {"type": "rectangle", "bsdf": PAINT, "to_world": above}}  # fmt: skip
    scene = load(g=group, i=at("g", "uneven, mirrored"), j=at("g", [9, 0, 0]))
    before = [m.id() for m in mi.traverse(scene).hierarchy]
    new = expand(scene)
    assert [m.id() for m in mi.traverse(scene).hierarchy] == before
    assert [(s.id(), s.class_name()) for s in new.shapes()] == [
        ("i/box", "Mesh"), ("i", "Instance"), ("j/box", "Mesh"), ("j", "Instance")
    ]  # fmt: skip
    assert_same_hits(scene, new)
    ids = {n.id() for n in mi.traverse(new).hierarchy}
    assert {"g", "ball", "plate"} <= ids and "box" not in ids


def test_groups_of_equal_boxes_are_told_apart(rgb):
    """Also where their members, sizes and ids are equal: only one of them is of glass."""

    def group(bsdf, kind="shapegroup"):
        return mi.load_dict(
            {"type": kind, "ball": {"type": "sphere", "bsdf": bsdf}, "box": {"type": "cube", "bsdf": PAINT}}
        )

    first, second, third = group(PAINT), group(GLASS), group(PAINT)
    for g in (first, second, third):
        g.set_id("g")
    instances = {
        f"i{k}": mi.load_dict({"type": "instance", "to_world": mi.ScalarTransform4f().translate([3 * k, 0, 0]), "g": g})
        for k, g in enumerate([third, first, second, first, second])
    }
    scene = load(a=first, b=second, c=third, **instances)
    for g in (first, second, third):
        g.set_id("g")
    new = expand(scene)
    assert [s.id() for s in new.shapes()] == ["i0", "i1", "i2/ball", "i2", "i3", "i4/ball", "i4"]
    assert_same_hits(scene, new, curved=True, uv=False)
    assert [g.id() for g in (first, second, third)] == ["g", "g", "g"]


def test_nested_materials(rgb):
    """A ball in a ball in a box, the box instanced: all three boundaries are met one after the other."""
    scene = load(outer={"type": "sphere", "radius": 2, "bsdf": GLASS, "interior": MEDIUM},
                 inner={"type": "sphere", "radius": 1, "bsdf": GLASS, "exterior": MEDIUM},
                 g={"type": "shapegroup", "box": {"type": "cube", "bsdf": GLASS}}, i=at("g", "scaled"))  # fmt: skip
    assert_same_hits(scene, expand(scene, 3e-3), curved=True, uv=False)


def test_instances_and_members_without_ids(rgb):
    """In files they are optional; what has none is described in messages."""
    scene = mi.load_string(
        """<scene version="3.0.0">
             <shape type="shapegroup" id="group"><shape type="cube"><bsdf type="dielectric"/></shape></shape>
             <shape type="instance"><ref id="group"/></shape>
             <shape type="instance" id="named"><ref id="group"/></shape>
             <shape type="sphere"><bsdf type="dielectric"/></shape>
           </scene>"""
    )
    assert [s.id() for s in expand(scene).shapes()] == ["", "named", ""]


def test_meshes_that_are_boundaries_stay_the_same_objects(rgb):
    scene = load(box={"type": "cube", "bsdf": GLASS}, ball={"type": "sphere", "center": [4, 0, 0], "bsdf": GLASS})
    new = expand(scene)
    assert new.shapes()[0] is scene.shapes()[0]
    assert [s.id() for s in new.shapes()] == ["box", "ball"]


def uneven_sphere():
    return {"type": "sphere", "to_world": mi.ScalarTransform4f().scale([1, 2, 3]), "bsdf": GLASS}


def distance_field():
    grid = mi.TensorXf(np.linspace(-1, 1, 8, dtype=np.float32).reshape(2, 2, 2, 1))
    return {"type": "sdfgrid", "grid": grid, "bsdf": GLASS}


def lamp():
    return {"type": "sphere", "bsdf": GLASS, "light": {"type": "area"}}


@pytest.mark.parametrize(
    ("shape", "words"),
    [(uneven_sphere, 'shape "odd".*unevenly.*ply or obj'), (distance_field, 'shape "odd".*sdfgrid.*ply or obj'),
     (lamp, 'shape "odd".*emitter.*remove')],
)  # fmt: skip
def test_refused(rgb, shape, words):
    with pytest.raises(SceneError, match=words) as caught:
        expand(load(odd=shape()))
    assert str(caught.value).count(". ") == 0


def test_errors_of_the_caller_pass(rgb):
    def refuse(shape):
        raise SceneError("no")

    scene = load(g={"type": "shapegroup", "box": {"type": "cube", "bsdf": GLASS}}, i=at("g"))
    with pytest.raises(SceneError, match="no"):
        tessellation.expand(scene, refuse, 0.01)
    assert [n.id() for n in mi.traverse(scene).hierarchy if n.class_name() == "ShapeGroupPlugin"] == ["g"]


def test_fineness_follows_the_tolerance(rgb):
    tolerances = [1, 0.1, 0.01, 1e-3, 1e-4, 0]
    f, n = [tessellation.frequency(x) for x in tolerances], [tessellation.segments(x) for x in tolerances]
    assert f == sorted(f) and n == sorted(n)
    assert f[0] >= 4 and 20 * f[-1] ** 2 <= 330_000
    assert n[0] >= 16 and all(x & (x - 1) == 0 for x in n)
    assert f[3] / f[2] == pytest.approx(10**0.5, rel=0.05)  # an error of second order


def test_long_tubes_stay_below_the_cap(rgb):
    tube = {"type": "cylinder", "p1": [0, 0, 5000], "radius": 0.1, "bsdf": GLASS}
    assert 100_000 < expand(load(s=tube), tolerance=0).shapes()[0].face_count() <= 330_000


def test_image_error_of_the_default_tolerance(rgb):
    """Single scattering in a sphere of the fineness that 0.01 selects, against a much finer one."""
    light = build.point_light((-2.6, 2.4, -0.9))
    medium = {"type": "homogeneous", "albedo": 0.8, "sigma_t": 0.7}
    scene = load(ball={"type": "sphere", "bsdf": GLASS, "interior": medium}, light=light)
    o, d = build.rays_at((0.0, 1.1, 5.2), 0.95, 400, seed=3)
    fine, default, coarse = (
        build.single_scattering(expand(scene, x), o, d, tolerance=1e-4, internal_bounces=0) for x in (1e-3, 0.01, 1)
    )
    assert l1(default, fine) < 0.01 / 3
    assert l1(coarse, fine) > 0.01 / 3

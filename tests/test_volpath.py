"""``refscatter`` against Mitsuba's ``volpath``, which shares no code with it.

``volpath`` needs an emitter of finite size: a sphere of constant radiance L_e and radius r.  Point
lights stand in for it exactly, without a far-field approximation: isotropic emission of j(y) per
volume, spread through the ball, sends along each line the radiance that is the integral of j on the
line.  For j = L_e / (pi sqrt(r^2 - |y|^2)) that is L_e on every line that meets the ball (Abel's
integral equation), as for the sphere, from wherever it is seen.  This density is the uniform one on
the 3-sphere of radius r in four dimensions with one coordinate dropped; seen from anywhere (a second
coordinate dropped) it is the uniform disc that the sphere presents.  The total intensity is pi r^2 L_e.
What stays is the quadrature over the positions; its error is estimated from independent replicates
(one good point set, rotated at random) and enters the standard error.

Direct single scattering is what ``volpath`` yields with ``max_depth = 4`` (camera, enter, scatter,
leave, light) minus the same with albedo 0, where the light is seen without scattering.  With equal
seeds both renders follow the same paths up to the first scattering, so unscattered light cancels
exactly and adds no noise: a difference is never negative.
"""
from itertools import combinations, product

import mitsuba as mi
import numpy as np
import pytest
from comparison import check, compare
from meshes import bumpy_sphere, icosphere
from scipy.stats import special_ortho_group

RES = 32
BLOCK = 4                 # edge of the blocks of pixels that are compared
RADIANCE = 10.0
VIEW = {"origin": [0.3, 0.5, 5], "target": [0, 0, 0], "up": [0, 1, 0]}


@pytest.fixture(autouse=True)
def variant():
    mi.set_variant("llvm_ad_rgb")
    import mitsuba_refscatter  # noqa: F401 - registers the plugin


def rgb(*values):
    return {"type": "rgb", "value": list(values)}


def write_mesh(path, mesh):
    """Writes a ``meshes.Mesh`` to a PLY file by Mitsuba's own writer."""
    normals = mesh.normals is not None
    shape = mi.Mesh("body", len(mesh.vertices), len(mesh.faces), has_vertex_normals=normals)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = np.ravel(mesh.vertices).astype(np.float32)
    parameters["faces"] = np.ravel(mesh.faces).astype(np.uint32)
    if normals:
        parameters["vertex_normals"] = np.ravel(mesh.normals).astype(np.float32)
    parameters.update()
    shape.write_ply(str(path))
    return str(path)


def cell_24():
    """The 24 vertices of the regular 24-cell on the unit 3-sphere, (24,4): a spherical 5-design, so their mean
    of any polynomial of degree 5 is the sphere's."""
    points = np.zeros((24, 4))
    for k, ((i, j), signs) in enumerate(product(combinations(range(4), 2), product((-1, 1), repeat=2))):
        points[k, [i, j]] = signs
    return points / np.sqrt(2)


def ball_points(rng):
    """24 points in the unit ball, (24,3), each with the density 1 / (pi^2 sqrt(1 - |y|^2)): points uniform on
    the 3-sphere, rotated at random together, one of four coordinates dropped."""
    return (cell_24() @ special_ortho_group.rvs(4, random_state=rng))[:, :3]


BODIES = {
    "sphere": dict(
        mesh=icosphere(4), facets=False, eta=1.5, centre=(-1.7, 1.5, -0.9), radius=0.4,
        sigma_t=(0.3, 0.5, 0.8), scale=1.5, albedo=(0.9, 0.6, 0.4), phase={"type": "isotropic"},
    ),
    "bumpy": dict(
        mesh=bumpy_sphere(3), facets=False, eta=1.4, centre=(-1.4, 1.7, 0.9), radius=0.4,
        sigma_t=(0.3, 0.6, 0.9), scale=2.0, albedo=(0.95, 0.7, 0.5), phase={"type": "hg", "g": 0.4},
    ),
    "facets": dict(
        mesh=bumpy_sphere(2, 0.08, 4.0), facets=True, eta=1.5, centre=(2.0, 0.6, 1.0), radius=0.4,
        sigma_t=(0.5, 0.5, 0.5), scale=2.0, albedo=(0.8, 0.8, 0.3), phase={"type": "hg", "g": -0.3},
    ),
    "bubble": dict(
        mesh=bumpy_sphere(3, 0.04, 4.0), facets=False, eta=1 / 1.33, centre=(-1.4, 1.7, 0.9), radius=0.4,
        sigma_t=(0.3, 0.6, 0.9), scale=1.0, albedo=(0.95, 0.7, 0.5), phase={"type": "isotropic"},
    ),
}


def build(case, path, integrator, sampler, lights, albedo):
    """The scene of a case with an integrator, a sampler (names or dicts), lights (dict) and albedo."""
    return mi.load_dict({
        "type": "scene", "integrator": integrator, **lights,
        "sensor": {
            "type": "perspective", "fov": 26, "to_world": mi.ScalarTransform4f().look_at(**VIEW),
            "film": {"type": "hdrfilm", "width": RES, "height": RES, "rfilter": {"type": "box"},
                     "component_format": "float32", "pixel_format": "rgb"},
            "sampler": {"type": sampler},
        },
        "body": {
            "type": "ply", "filename": path, "face_normals": case["facets"],
            "bsdf": {"type": "dielectric", "int_ior": case["eta"], "ext_ior": 1.0},
            "interior": {"type": "homogeneous", "sigma_t": rgb(*case["sigma_t"]), "scale": case["scale"],
                         "albedo": rgb(*albedo), "phase": case["phase"]},
        },
    })  # fmt: skip


def volpath_renders(case, path, replicates, spp):
    """Direct single scattering by ``volpath``: (replicates,H,W,3)."""
    light = {"light": {"type": "sphere", "center": list(case["centre"]), "radius": case["radius"],
                       "emitter": {"type": "area", "radiance": rgb(*[RADIANCE] * 3)}}}
    integrator = {"type": "volpath", "max_depth": 4}
    scattering, clear = (build(case, path, integrator, "independent", light, albedo)
                         for albedo in (case["albedo"], (0, 0, 0)))
    images = []
    for seed in range(replicates):
        with_medium, without = (np.array(mi.render(s, seed=seed, spp=spp)) for s in (scattering, clear))
        images.append(with_medium - without)
    return np.array(images)


def our_renders(case, path, replicates, spp):
    """The same by ``refscatter``, from 24 point lights per replicate: (replicates,H,W,3)."""
    integrator = {"type": "refscatter", "surfaces": False, "internal_bounces": 0}
    intensity = np.pi * case["radius"] ** 2 * RADIANCE / 24
    images = []
    for seed in range(replicates):
        points = np.array(case["centre"]) + case["radius"] * ball_points(np.random.default_rng(seed))
        lights = {f"light_{k}": {"type": "point", "position": p.tolist(), "intensity": rgb(*[intensity] * 3)}
                  for k, p in enumerate(points)}
        scene = build(case, path, integrator, "multijitter", lights, case["albedo"])
        images.append(np.array(mi.render(scene, seed=seed, spp=spp)))
    return np.array(images)


def test_points_present_a_uniform_disc():
    """Seen along any axis, the light points fill the disc evenly: mean of r^2 is 1/2, of r^4 1/3, of r^6 1/4."""
    rng = np.random.default_rng(1)
    points = np.concatenate([ball_points(rng) for _ in range(4000)])
    for axis in np.eye(3):
        r2 = (points ** 2).sum(1) - (points @ axis) ** 2
        assert r2.mean() == pytest.approx(1 / 2, abs=1e-12)           # degrees up to 5 are exact
        assert (r2 ** 2).mean() == pytest.approx(1 / 3, abs=1e-12)
        assert (r2 ** 3).mean() == pytest.approx(1 / 4, abs=4e-3)


@pytest.mark.parametrize("name", BODIES)
def test_single_scattering(name, tmp_path):
    case = BODIES[name]
    path = write_mesh(tmp_path / "body.ply", case["mesh"])
    agreement = compare(our_renders(case, path, 8, 4), volpath_renders(case, path, 96, 256), BLOCK)
    check(agreement, mean_error=0.02, block_error=0.12)


@pytest.mark.slow
@pytest.mark.parametrize("name", BODIES)
def test_single_scattering_long(name, tmp_path):
    """Ten times the samples of both."""
    case = BODIES[name]
    path = write_mesh(tmp_path / "body.ply", case["mesh"])
    agreement = compare(our_renders(case, path, 20, 16), volpath_renders(case, path, 240, 1024), BLOCK)
    check(agreement, mean_error=0.006, block_error=0.04)

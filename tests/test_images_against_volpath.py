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

from dataclasses import replace

import build
import mitsuba as mi
import numpy as np
import pytest
import references
from build import mesh_shape, point_light
from comparison import check, compare
from meshes import box, bumpy_sphere, icosphere
from scipy.stats import special_ortho_group

pytestmark = pytest.mark.usefixtures("rgb")

RES = 32
BLOCK = 4  # edge in pixels of the blocks that are compared
RADIANCE = 10.0


def colour(*values):
    return {"type": "rgb", "value": list(values)}


def view(fov, sampler):
    """The sensor; ``sampler`` is a name."""
    return {
        "type": "perspective", "fov": fov,
        "to_world": mi.ScalarTransform4f().look_at(origin=[0.3, 0.5, 5], target=[0, 0, 0], up=[0, 1, 0]),
        "film": {"type": "hdrfilm", "width": RES, "height": RES, "rfilter": {"type": "box"},
                 "component_format": "float32", "pixel_format": "rgb"},
        "sampler": {"type": sampler},
    }  # fmt: skip


def renders(scene, replicates, spp):
    """Renders with the seeds 0, 1, ...: (replicates,H,W,3)."""
    return np.array([np.array(mi.render(scene, seed=seed, spp=spp)) for seed in range(replicates)])


# ---- Single scattering ------------------------------------------------------------------------


def ball_points(rng):
    """8 points in the unit ball, (8,3), each with the density 1 / (pi^2 sqrt(1 - |y|^2)): a cross-polytope on
    the 3-sphere, rotated at random, one of four coordinates dropped.  Its vertices are a spherical 3-design:
    their mean of any polynomial of degree 3 is the sphere's."""
    rotation = special_ortho_group.rvs(4, random_state=rng)
    return np.concatenate([rotation, -rotation])[:, :3]


# eta below 1 and above, isotropic, forward and backward scattering, smooth and facet normals. Lights are
# near (2 to 2.5 from the centre of a body of radius 1) so that volpath finds them.
BODIES = {
    "sphere": dict(
        mesh=icosphere(4), eta=1.5, g=None, sigma_t=(0.3, 0.5, 0.8), scale=1.5, albedo=(0.9, 0.6, 0.4),
        centre=(-1.7, 1.5, -0.9), radius=0.4,
    ),
    "bumpy": dict(
        mesh=bumpy_sphere(3), eta=1.4, g=0.4, sigma_t=(0.3, 0.6, 0.9), scale=2.0, albedo=(0.95, 0.7, 0.5),
        centre=(-1.4, 1.7, 0.9), radius=0.4,
    ),
    "facets": dict(
        mesh=replace(bumpy_sphere(2, 0.08, 4.0), normals=None), eta=1.5, g=-0.3, sigma_t=(0.3, 0.5, 0.7),
        scale=2.0, albedo=(0.8, 0.8, 0.3), centre=(2.0, 0.6, 1.0), radius=0.4,
    ),
    "bubble": dict(
        mesh=bumpy_sphere(3, 0.04, 4.0), eta=1 / 1.33, g=None, sigma_t=(0.3, 0.6, 0.9), scale=1.0,
        albedo=(0.95, 0.7, 0.5), centre=(-1.4, 1.7, 0.9), radius=0.4,
    ),
}  # fmt: skip


class Case:
    """One of ``BODIES``, its mesh written to a directory."""

    def __init__(self, name, directory):
        self.body = dict(BODIES[name])
        self.centre, self.radius = np.array(self.body.pop("centre")), self.body.pop("radius")
        self.scale = self.body.pop("scale")
        self.path = directory / "body.ply"

    def scene(self, integrator, sampler, lights, **changes):
        shape = mesh_shape(path=self.path, **{**self.body, **changes})
        shape["interior"]["scale"] = self.scale
        return mi.load_dict(
            {"type": "scene", "integrator": integrator, "sensor": view(26, sampler), "body": shape, **lights}
        )

    def theirs(self, replicates, spp):
        """Direct single scattering by ``volpath``: (replicates,H,W,3)."""
        light = {"type": "sphere", "center": self.centre.tolist(), "radius": self.radius,
                 "emitter": {"type": "area", "radiance": colour(*[RADIANCE] * 3)}}  # fmt: skip
        integrator = {"type": "volpath", "max_depth": 4}
        scattering = self.scene(integrator, "independent", {"light": light})
        clear = self.scene(integrator, "independent", {"light": light}, albedo=(0, 0, 0))
        return renders(scattering, replicates, spp) - renders(clear, replicates, spp)

    def ours(self, replicates, spp):
        """The same by ``refscatter``, from 8 point lights per replicate: (replicates,H,W,3)."""
        integrator = {"type": "refscatter", "surfaces": False, "internal_bounces": 0}
        intensity = np.pi * self.radius**2 * RADIANCE / 8
        images = []
        for seed in range(replicates):
            points = self.centre + self.radius * ball_points(np.random.default_rng(seed))
            lights = {f"light_{k}": point_light(p, [intensity] * 3) for k, p in enumerate(points)}
            images.append(np.array(mi.render(self.scene(integrator, "multijitter", lights), seed=seed, spp=spp)))
        return np.array(images)


def test_light_points_present_a_uniform_disc():
    """Seen along any axis they fill the disc evenly: the means of r^2, r^4, r^6 are 1/2, 1/3, 1/4. The first is
    exact for every rotation."""
    rng = np.random.default_rng(1)
    points = np.concatenate([ball_points(rng) for _ in range(10000)])
    for axis in np.eye(3):
        r2 = (points**2).sum(1) - (points @ axis) ** 2
        assert r2.mean() == pytest.approx(1 / 2, abs=1e-12)
        assert (r2**2).mean() == pytest.approx(1 / 3, abs=2e-3)
        assert (r2**3).mean() == pytest.approx(1 / 4, abs=3e-3)


@pytest.mark.parametrize("name", build.slow_ones(BODIES, ("bubble",)))
def test_single_scattering(name, tmp_path):
    case = Case(name, tmp_path)
    kept = references.of(f"volpath {name}", BODIES[name], lambda: case.theirs(64, 256), BLOCK)
    check(compare(case.ours(6, 4), kept, BLOCK), mean_error=0.02, block_error=0.12)


@pytest.mark.slow
@pytest.mark.parametrize("name", BODIES)
def test_single_scattering_long(name, tmp_path):
    """Ten times the samples, and volpath anew."""
    case = Case(name, tmp_path)
    check(compare(case.ours(24, 16), case.theirs(160, 1024), BLOCK), mean_error=0.006, block_error=0.04)


# ---- Surfaces ---------------------------------------------------------------------------------

GLASS = {"bumpy": (bumpy_sphere(3), 0), "box": (box((-0.9, -0.7, -0.8), (0.9, 0.7, 0.8)), 35)}
"""Bodies and the angles by which they are turned."""


def glass_parts(name, directory, integrator, sampler):
    """A checkerboard under a point lamp and a sky, seen past and through an absorbing glass body.

    Light that passes the glass on its way to the board is not the point here (``test_surfaces_against_volpath``). What
    ``volpath`` finds of it is rare, so the scene has little: the lamp is a point, whose light through the glass has
    probability 0, and the board is nearly black under a bright lamp."""
    (mesh, angle), transform = GLASS[name], mi.ScalarTransform4f()
    squares = {"type": "checkerboard", "to_uv": transform.scale(4),
               "color0": colour(0.002, 0.001, 0.0005), "color1": colour(0.0002, 0.0005, 0.001)}  # fmt: skip
    return {
        "type": "scene", "integrator": integrator, "sensor": view(30, sampler),
        "sky": {"type": "constant", "radiance": colour(0.1, 0.2, 0.3)},
        "lamp": point_light((2.5, 2.5, 0), (20000, 15000, 15000)),
        "board": {"type": "rectangle", "to_world": transform.translate([0, 0, -2]).scale(2.5),
                  "bsdf": {"type": "twosided", "nested": {"type": "diffuse", "reflectance": squares}}},
        "body": mesh_shape(mesh, directory / "body.ply", sigma_t=(0.2, 0.5, 0.9), albedo=(0, 0, 0),
                           to_world=transform.rotate([0.3, 1, 0.1], angle)),
    }  # fmt: skip


def glass_scene(*parts):
    return mi.load_dict(glass_parts(*parts))


def surfaces(name, directory, replicates, spp):
    scene = glass_scene(name, directory, {"type": "refscatter", "internal_bounces": 8}, "multijitter")
    return renders(scene, replicates, spp)


def surfaces_by_volpath(name, directory, replicates, spp):
    """``max_depth`` = 40: a path that is reflected inside 30 times and comes out keeps less than 1e-5 of its light
    (0.2 per unit length)."""
    volpath = {"type": "volpath", "max_depth": 40, "rr_depth": 1000}
    return renders(glass_scene(name, directory, volpath, "independent"), replicates, spp)


@pytest.mark.parametrize("name", GLASS)
def test_surfaces(name, tmp_path):
    scene = glass_parts(name, tmp_path, None, "independent")
    scene["body"].pop("filename")  # of the mesh, which stands for it
    kept = references.of(f"surfaces {name}", [scene, GLASS[name]],
                         lambda: surfaces_by_volpath(name, tmp_path, 64, 128), BLOCK)  # fmt: skip
    check(compare(surfaces(name, tmp_path, 12, 36), kept, BLOCK), mean_error=0.008, block_error=0.025)


@pytest.mark.slow
@pytest.mark.parametrize("name", GLASS)
def test_surfaces_long(name, tmp_path):
    images = surfaces(name, tmp_path, 18, 256), surfaces_by_volpath(name, tmp_path, 128, 640)
    check(compare(*images, BLOCK), mean_error=0.002, block_error=0.008)


@pytest.mark.parametrize("name", GLASS)
def test_surfaces_lose_little_by_truncation(name, tmp_path):
    """What 8 internal reflections and dropped legs leave out is below 0.1 % of the image."""
    exact = {"type": "refscatter", "internal_bounces": 16, "tolerance": 0.0}
    usual = {"type": "refscatter", "internal_bounces": 8}
    all_of_it, most = (renders(glass_scene(name, tmp_path, x, "multijitter"), 1, 16) for x in (exact, usual))
    missing = (all_of_it - most).mean((0, 1, 2)) / all_of_it.mean((0, 1, 2))
    assert (np.abs(missing) < 1e-3).all(), missing

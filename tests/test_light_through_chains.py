"""Light that is refracted or reflected more than once before it scatters: against particles that Mitsuba itself sends
through the scene, and against scenes that must look the same."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import point_light
from test_scene_kinds_against_volpath import glass, to

from mitsuba_refscatter.core import cache
from mitsuba_refscatter.integrators.hooks import Hooks
from mitsuba_refscatter.missing import in_media
from mitsuba_refscatter.scene import read

pytestmark = pytest.mark.usefixtures("rgb")

EYE, RES, FOV = (0.0, 0.5, 7.0), 32, 36.0
FOG = {"type": "ref", "id": "fog"}


def colour(*values):
    return {"type": "rgb", "value": list(values)}


def scene(**parts):
    film = {"type": "hdrfilm", "width": RES, "height": RES, "rfilter": {"type": "box"}}
    view = mi.ScalarTransform4f().look_at(EYE, [0, 0, 0], [0, 1, 0])
    fog = {"type": "homogeneous", "id": "fog", "sigma_t": colour(0.2, 0.25, 0.3), "albedo": 0.9}
    sensor = {"type": "perspective", "fov": FOV, "to_world": view, "film": film}
    return mi.load_dict({"type": "scene", "a_fog": fog, "sensor": sensor, **parts}, optimize=False)


def image(scene, light_bounces, tolerance=0.01, spp=4, **options):
    integrator = mi.load_dict(
        {"type": "refscatter", "tolerance": tolerance, "surfaces": False, "light_bounces": light_bounces, **options}
    )
    return np.array(integrator.render(scene, seed=2, spp=spp, hooks=Hooks(silent=True)))[..., :3].astype(float)


def blocks(image, n=4):
    size = len(image) // n
    return image.reshape(n, size, n, size, 3).mean(axis=(1, 3))


def room(bsdf=None, size=2.0):
    return {"type": "cube", "to_world": to(("scale", size)), "bsdf": bsdf or {"type": "null"}, "interior": FOG}


def ball(bsdf, **more):
    return {"type": "sphere", "center": [0, 0.3, 0], "radius": 0.55, "bsdf": bsdf, **more}


LAMP = (-1.2, 1.7, 0.2)


def fog_behind(bsdf):
    return scene(lamp=point_light(LAMP), room=room(), ball=ball(bsdf, exterior=FOG))


class Particles:
    """Light of a point light in fog, sent on by Mitsuba's own intersections and BSDFs: what particles scatter towards
    the camera behind at least one and at most so many events that count, by pixel.

    Particles carry red, green and blue together. ``image``: (RES, RES, 3); pixels whose camera ray meets what is no
    ``null`` before the particle get nothing.
    """

    def __init__(self, scene, light, power, bounces, count, seed):
        self.scene, self.bounces, self.count = scene, bounces, count
        self.sums = dr.zeros(mi.Float, RES * RES * 3)
        self.to_camera = scene.sensors()[0].world_transform().inverse()
        self.random = mi.PCG32(size=count, initstate=seed)
        d = mi.warp.square_to_uniform_sphere(mi.Point2f(self.random.next_float32(), self.random.next_float32()))
        self.ray, self.weight = mi.Ray3f(mi.Point3f(light), d), mi.Spectrum(power)
        self.follow()
        self.image = np.array(self.sums, dtype=float).reshape(RES, RES, 3)

    def follow(self):
        first = self.scene.ray_intersect(self.ray)
        inside = dr.dot(first.n, self.ray.d) > 0
        medium = dr.select(inside, first.shape.interior_medium(), first.shape.exterior_medium())
        events, bent, active = mi.UInt32(0), mi.Bool(False), first.is_valid()
        for _ in range(self.bounces + 6):
            si = self.scene.ray_intersect(self.ray, active)
            active &= si.is_valid()
            there = active & (medium != dr.zeros(mi.MediumPtr))
            self.scatter(si, medium, there & bent)
            self.weight *= dr.select(there, dr.exp(-self.extinction(medium, self.ray, there)[1] * si.t), 1)
            uv = mi.Point2f(self.random.next_float32(), self.random.next_float32())
            context = mi.BSDFContext(mi.TransportMode.Importance)
            drawn, value = si.bsdf().sample(context, si, self.random.next_float32(), uv, active)
            null, reflected = (
                mi.has_flag(drawn.sampled_type, flag) for flag in (mi.BSDFFlags.Null, mi.BSDFFlags.DeltaReflection)
            )
            active &= (null | mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)) & (dr.max(value) > 0)
            self.weight = dr.select(active, self.weight * value, 0)
            counts = active & ~null & (bent | reflected)
            events, bent = events + dr.select(counts, mi.UInt32(1), 0), bent | (active & ~null)
            d = si.to_world(drawn.wo)
            medium = dr.select(si.is_medium_transition(), si.target_medium(d), medium)
            self.ray, active = dr.select(active, si.spawn_ray(d), self.ray), active & (events <= self.bounces)
            dr.eval(self.sums, self.ray, self.weight, events, bent, active, medium, self.random.state)

    def extinction(self, medium, ray, active):
        mei = dr.zeros(mi.MediumInteraction3f, self.count)
        mei.wi = -ray.d
        sigma_s, _, sigma_t = medium.get_scattering_coefficients(mei, active)
        return sigma_s, sigma_t

    def scatter(self, si, medium, active):
        """One place on each leg where a particle scatters, isotropically."""
        sigma_s, sigma_t = self.extinction(medium, self.ray, active)
        mean = dr.maximum(dr.mean(sigma_t), 1e-9)
        stopped = 1 - dr.exp(-mean * si.t)
        s = -dr.log(1 - self.random.next_float32() * stopped) / mean
        X = self.ray(s)
        value = self.weight * sigma_s * dr.exp(-sigma_t * s) * stopped / (mean * dr.exp(-mean * s)) * dr.inv_four_pi
        back = mi.Vector3f(mi.Point3f(EYE) - X)
        distance = dr.norm(back)
        way = mi.Ray3f(X, back / distance)
        met = self.scene.ray_intersect(way, active)  # the wall of the room
        value *= dr.exp(-sigma_t * met.t)
        active &= mi.has_flag(met.bsdf().flags(), mi.BSDFFlags.Null)
        q, f = self.to_camera @ mi.Point3f(X), RES / (2 * np.tan(np.radians(FOV) / 2))
        x, y = 0.5 * RES - q.x / q.z * f, 0.5 * RES - q.y / q.z * f
        active &= (x >= 0) & (x < RES) & (y >= 0) & (y < RES)
        pixel, angle = mi.UInt32(y) * RES + mi.UInt32(x), (q.z / distance) ** 3 / f**2
        for k in range(3):
            dr.scatter_add(self.sums, value[k] / (angle * dr.square(distance) * self.count), 3 * pixel + k, active)


@pytest.mark.parametrize("bounces", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_fog_behind_a_ball_of_glass(bounces):
    """Light that a ball focuses, and that it reflects. An estimate that divides by a beam's cross-section is 30 % too
    bright there, behind the fold on the ball's far side."""
    fog, power = fog_behind(glass(1.5)), np.full(3, 40 * np.pi)
    runs = [Particles(fog, LAMP, power, bounces, 1 << 20, seed).image for seed in range(8)]
    options = {"internal_bounces": 0, "tolerance": 0.01, "spp": 64}
    found = image(fog, bounces, **options) - image(fog, 0, **options)
    expected = np.mean(runs, axis=0)
    # Where the ball itself is seen camera rays are bent.
    hidden = expected == 0
    found[hidden] = 0
    error = np.std([blocks(x) for x in runs], axis=0, ddof=1) / len(runs) ** 0.5
    off = np.abs(blocks(found) - blocks(expected)) / (3 * error + 0.02 * blocks(expected))
    spread = np.std([x.mean() for x in runs], ddof=1) / len(runs) ** 0.5 / expected.mean()
    print(
        f"standard error {spread:.4f}; means {found.mean() / expected.mean():.4f}, worst block {off.max():.2f} of limit"
    )
    assert abs(found.mean() / expected.mean() - 1) < 0.01
    assert (off < 1).mean() > 0.97 and off.max() < 2


def close(a, b, mean, block):
    assert a.mean() > 0 and abs(a.mean() / b.mean() - 1) < mean
    assert (np.abs(blocks(a) - blocks(b)) <= block * np.maximum(blocks(b), 0.05 * b.mean())).all()


def test_a_ball_that_does_not_refract():
    """Through a dielectric of index 1, refracted twice, comes what comes straight through a null."""
    close(image(fog_behind(glass(1.0)), 1), image(fog_behind({"type": "null"}), 0), 3e-3, 0.02)


def tank(**parts):
    return scene(
        lamp=point_light((-3.4, 0.7, 0.5)),
        tank={"type": "sphere", "radius": 1.0, "bsdf": glass(1.33), "interior": FOG},
        **parts,
    )


def test_a_window_that_does_not_refract():
    """A pane of index 1 before a body of water, refracted three times."""
    pane = {"type": "cube", "to_world": to(("translate", [-1.9, 0, 0]), ("scale", [0.04, 1.7, 1.7]))}
    dark, lit = (image(tank(pane={**pane, "bsdf": glass(1.0)}), n) for n in (0, 2))
    assert dark.max() == 0
    close(lit, image(tank(), 0), 5e-3, 0.02)


@pytest.mark.slow
def test_a_window():
    """Of glass it leaves what two boundaries let through, and makes the way shorter by a third of its thickness."""
    pane = {"type": "cube", "to_world": to(("translate", [-1.9, 0, 0]), ("scale", [0.04, 1.7, 1.7]))}
    share = image(tank(pane={**pane, "bsdf": glass(1.5)}), 2).mean() / image(tank(), 0).mean()
    assert 0.96**2 * 0.995 < share < 0.96**2 * 1.03


def test_light_by_a_mirror():
    """A plane mirror brings what a second light brings behind it, where the first is hidden from the body."""
    body = {"type": "sphere", "radius": 0.9, "bsdf": glass(1.45), "interior": FOG}
    hidden = {"type": "cube", "to_world": to(("translate", [-1.5, 0, 1.3]), ("scale", [0.05, 1.2, 0.9])),
              "bsdf": {"type": "diffuse"}}  # fmt: skip
    mirror = {"type": "rectangle", "to_world": to(("translate", [0, 0, -2.6]), ("scale", 4.0)),
              "bsdf": {"type": "conductor", "material": "none"}}  # fmt: skip
    lamp, behind = (-2.6, 0.4, 2.2), (-2.6, 0.4, -7.4)
    with_mirror = scene(lamp=point_light(lamp), body=body, hidden=hidden, mirror=mirror)
    dark, lit = (image(with_mirror, n, 0.03, internal_bounces=0) for n in (0, 2))
    assert dark.max() == 0
    close(lit, image(scene(lamp=point_light(behind), body=body, hidden=hidden), 0, internal_bounces=0), 1e-2, 0.05)


def test_more_events_bring_more_light():
    """A cube reflects light inside: each further event brings some, ever less."""
    cube = {"type": "cube", "bsdf": glass(1.5), "interior": FOG, "to_world": to(("rotate", [0, 1, 0], 30))}
    cube = scene(lamp=point_light((-2.6, 2.4, -0.9)), body=cube)
    means = np.array([image(cube, n, 0.03, 1).mean() for n in (0, 1, 2, 4)])
    print("light_bounces 0, 1, 2, 4:", np.round(means / means[-1], 4))
    assert (np.diff(means) > 0).all() and means[3] - means[2] < means[1] - means[0]


def test_nothing_is_said_to_be_missing():
    """Where chains are followed."""
    fog = read(fog_behind(glass(1.5)), 0.01, cache.Cache())
    told = [" ".join(in_media(fog, n)) for n in (0, 2)]
    assert "light_bounces = 0 ends it there" in told[0] and "light_bounces" not in told[1]

"""What is unusual but means something: films of one line, no light, no absorption, meshes that only touch."""

import build
import numpy as np
import pytest
from comparison import l1
from faults import BALL, Maker, amber, at, grey, render, sensor, with_faces
from meshes import Mesh, box

CUBE = box([-0.5] * 3, [0.5] * 3)


@pytest.fixture
def make(rgb, tmp_path):
    return Maker(tmp_path)


def of_film(make, width, height, samples, **more):
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}, **more}
    scene = make.scene(sensor=sensor(fov_axis="larger", fov=28.0, film=film))
    return np.array(scene.integrator().render(scene, spp=samples), dtype=np.float64)


@pytest.mark.parametrize("width, height", [(1, 1), (4096, 1), (1, 4096)])
def test_films(make, width, height):
    """Their mean is that of a film of other pixels over the same, or nearly the same, rays."""
    long = max(width, height)
    found = of_film(make, width, height, 4096 // long)
    assert found.shape == (height, width, 3) and np.isfinite(found).all() and (found >= 0).all()
    if long == 1:
        expected = of_film(make, 64, 64, 1)
    else:  # a row or column in the middle of a square film
        fine = {"crop_width": 1} if width == 1 else {"crop_height": 1}
        offset = {"crop_offset_x": 2047} if width == 1 else {"crop_offset_y": 2047}
        expected = of_film(make, 4096, 4096, 1, **{**fine, **offset})
    assert abs(found.mean() / expected.mean() - 1) < 0.02


def test_no_intensity(make):
    """A light that is off brings nothing, and nothing changes for another one."""
    off, on = build.point_light((3, 2, 1), (0.0, 0.0, 0.0)), build.point_light((-3, 3, 0))
    assert (render(make.scene(lamp=off)) == 0).all()
    alone, both = render(make.scene(lamp=on)), render(make.scene(lamp=on, other=off))
    np.testing.assert_allclose(both, alone, rtol=1e-5)


def test_albedo_from_zero_to_one(make):
    """Single scattering is linear in it."""
    black, half, white = (render(make.scene(ball=make.ball(interior=amber(albedo=grey(x))))) for x in (0.0, 0.5, 1.0))
    assert (black == 0).all() and half.max() > 1e-3
    np.testing.assert_allclose(white, 2 * half, rtol=1e-5)


def with_a_split_edge(mesh):
    """The first triangle cut in two at the middle of an edge, its neighbour there not."""
    i, j, k = mesh.faces[0]
    new = len(mesh.vertices)
    vertices = np.concatenate([mesh.vertices, [(mesh.vertices[i] + mesh.vertices[j]) / 2]])
    return Mesh(vertices, np.concatenate([[[i, new, k], [new, j, k]], mesh.faces[1:]]), None)


MESHES = {
    "T-junction": (CUBE, with_a_split_edge(CUBE)),
    "wound inwards": (BALL, with_faces(BALL.faces[:, ::-1])),
    "another first corner": (BALL, with_faces(np.roll(BALL.faces, 1, axis=1))),
}


@pytest.mark.parametrize("name", MESHES)
def test_meshes_of_one_shape(make, name):
    plain, odd = (
        render(make.scene(ball=make.ball(mesh), integrator={"type": "refscatter", "surfaces": False, "tolerance": 0.0}))
        for mesh in MESHES[name]
    )
    np.testing.assert_allclose(odd, plain, atol=1e-4 * plain.max())


def test_one_triangle(make):
    """A boundary that encloses nothing: light comes in by it, and is seen by rays that come in by it, not by those
    beside."""
    alone = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]), None)
    scene = make.scene(ball=make.ball(alone), lamp=build.point_light((0.3, 0.2, 3)))
    o, d = build.rays_towards((0, 0, 5), [(0.3, 0.3, 0), (0.1, 0.7, 0), (0.6, 0.6, 0), (-0.1, 0.3, 0)])
    found = build.single_scattering(scene, o, d)
    assert np.isfinite(found).all() and (found[:2] > 1e-6).all() and (found[2:] == 0).all()


@pytest.mark.parametrize("boundary", [{"type": "null"}, {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}])
def test_a_shadow_on_large_triangles(make, boundary):
    """At the default tolerance it has the form that it has at tolerance 0: of a cube on one of two triangles a side."""
    block = {"type": "cube", "bsdf": {"type": "diffuse"}, "to_world": at(0.55, 0.85, 0.5).scale(0.15)}
    light, view = build.point_light((1.2, 1.7, 0.9)), sensor((0.6, 0.6, 2.7), fov=28.0)
    view["film"] = {"type": "hdrfilm", "width": 48, "height": 48, "rfilter": {"type": "box"}}
    body, images = make.ball(CUBE, bsdf=boundary), []
    for tolerance in (0.01, 0.0):
        settings = {"type": "refscatter", "surfaces": False, "internal_bounces": 0, "tolerance": tolerance}
        scene = make.scene(sensor=view, lamp=light, ball=body, block=block, integrator=settings)
        images.append(np.array(scene.integrator().render(scene, seed=1, spp=4), dtype=np.float64))
    assert l1(images[0], images[1]) < 0.01
    assert (images[1].sum(axis=2) > 0).mean() > 0.1

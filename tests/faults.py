"""Scenes with one thing wrong, and the assertion that they are refused."""

import re

import build
import mitsuba as mi
import numpy as np
import pytest
from meshes import Mesh, icosphere

BALL = icosphere(1)
HONEY = {"type": "ref", "id": "honey"}


def grey(value):
    return {"type": "rgb", "value": [value] * 3}


def amber(**changes):
    return {"type": "homogeneous", "sigma_t": grey(0.5), "albedo": grey(0.5), **changes}


def at(x, y=0.0, z=0.0):
    return mi.ScalarTransform4f().translate([x, y, z])


def rectangle(**more):
    return {"type": "rectangle", "to_world": at(0, 4), **more}


def sensor(origin=(0, 0, 5), target=(0, 0, 0), **more):
    return {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at(list(origin), list(target), [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 8, "height": 8},
        "sampler": {"type": "independent", "sample_count": 1},
        **more,
    }


class Maker:
    """Scenes of a glass ball "ball" and a point light "lamp", with one thing wrong."""

    def __init__(self, folder):
        self.folder, self.count = folder, 0

    def ball(self, mesh=BALL, eta=1.5, **changes):
        """Description of a body; changes set to None leave a part out."""
        self.count += 1
        shape = build.mesh_shape(mesh, self.folder / f"mesh{self.count}.ply", eta=eta)
        return {key: value for key, value in {**shape, **changes}.items() if value is not None}

    def scene(self, optimize=False, **changes):
        parts = {"integrator": {"type": "refscatter", "surfaces": False}, "sensor": sensor(),
                 "lamp": build.point_light((-3, 3, 0)), "ball": self.ball(), **changes}  # fmt: skip
        parts = {"type": "scene", **{key: value for key, value in sorted(parts.items()) if value is not None}}
        return mi.load_dict(parts, optimize=optimize)


def render(scene):
    return np.array(scene.integrator().render(scene))


def refused(build_scene, *words):
    """Loading or rendering fails, with one sentence that holds these words, and is returned."""
    with pytest.raises((RuntimeError, ValueError)) as caught:
        render(build_scene())
    sentence = str(caught.value)
    if "Traceback" in sentence:  # Mitsuba puts the traceback of a Python plugin before what the plugin said
        sentence = sentence.strip().splitlines()[-1]
    assert len(sentence.splitlines()) == 1 and len(sentence) < 320, sentence
    for word in words:
        assert word in sentence, sentence
    return sentence


def points_of(sentence):
    """The points that a sentence names, (n, 3)."""
    return np.array(re.findall(r"\((\S+), (\S+), (\S+?)\)", sentence), dtype=float)


def with_faces(faces):
    return Mesh(BALL.vertices, faces, BALL.normals)


def glass(**properties):
    return {"type": "dielectric", **properties}


def moved(mesh, x, y=0.0, z=0.0, scale=1.0):
    return Mesh(scale * mesh.vertices + [x, y, z], mesh.faces, mesh.normals)

"""Scenes rendered by ``refscatter`` and by ``volpath`` restricted to the same light paths.

``volpath`` with ``max_depth`` minus the same with albedo 0: the direct single scattering, if no path with more
scattering is as short. Edges count from the camera on; null and thindielectric crossings do not.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import mitsuba as mi
import numpy as np
import references
from comparison import compare

RES, BLOCK = 32, 4


def medium(sigma_t=(0.3, 0.5, 0.8), albedo=(0.9, 0.6, 0.4), scale=1.0, **more):
    return {"type": "homogeneous", "id": "medium", "scale": scale, "sigma_t": colour(*sigma_t),
            "albedo": colour(*albedo), **more}  # fmt: skip


def colour(*values):
    return {"type": "rgb", "value": list(values)}


WITHIN = {"type": "ref", "id": "medium"}


def glass(eta, **more):
    return {"type": "dielectric", "int_ior": float(eta), "ext_ior": 1.0, **more}


def to(*steps):
    """A transform from steps like ("scale", 2)."""
    transform = mi.ScalarTransform4f()
    for name, *arguments in steps:
        transform = getattr(transform, name)(*arguments)
    return transform


def camera(origin=(0.3, 0.5, 5.0), target=(0, 0, 0), fov=34, up=(0, 1, 0), medium=None):
    sensor = {
        "type": "perspective", "fov": fov, "sampler": {"type": "independent"},
        "to_world": mi.ScalarTransform4f().look_at(origin=list(origin), target=list(target), up=list(up)),
        "film": {"type": "hdrfilm", "width": RES, "height": RES, "rfilter": {"type": "box"},
                 "component_format": "float32", "pixel_format": "rgb"},
    }  # fmt: skip
    return sensor if medium is None else {**sensor, "medium": medium}


@dataclass
class Case:
    """A scene: a function that returns its ``parts`` (once a variant is set), the edges of its paths (``depth``), the
    ``medium``, options of refscatter, and renders (number, samples per pixel) of both sides."""

    parts: Callable[[], dict]
    depth: int = 2
    medium: Callable[[], dict] = medium
    options: dict = field(default_factory=dict)
    ours: tuple = (8, 16)
    theirs: tuple = (24, 64)
    optimize: bool = True

    def scene(self, integrator, **changes):
        """The medium comes first, so that all parts can refer to it."""
        parts = {"type": "scene", "a_medium": {**self.medium(), **changes}, "integrator": integrator}
        return mi.load_dict({**parts, "sensor": camera(), **self.parts()}, optimize=self.optimize)

    def by_refscatter(self):
        """Renders by refscatter, (replicates, H, W, 3)."""
        scene = self.scene({"type": "refscatter", "surfaces": False, "internal_bounces": 0, **self.options})
        return np.array([np.array(mi.render(scene, seed=k, spp=self.ours[1])) for k in range(self.ours[0])])

    def by_volpath(self, seed=0):
        """The same by volpath."""
        volpath = {"type": "volpath", "max_depth": self.depth, "rr_depth": 1000}
        both, images = (self.scene(volpath), self.scene(volpath, albedo=0.0)), []
        for k in range(self.theirs[0]):
            with_it, without = (np.array(mi.render(scene, seed=seed + k, spp=self.theirs[1])) for scene in both)
            images.append(with_it - without)
        return np.array(images)

    def kept(self, name):
        """What volpath finds, as it is kept under a name."""
        scene = {
            "sensor": camera(),
            **self.parts(),
            "medium": self.medium(),
            "depth": self.depth,
            "renders": self.theirs,
        }
        return references.of(name, scene, self.by_volpath, BLOCK)

    def agreement(self, name):
        """``Agreement`` of refscatter with what is kept of volpath."""
        return compare(self.by_refscatter(), self.kept(name), BLOCK)

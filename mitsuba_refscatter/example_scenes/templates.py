"""The scene files: one common text, and what differs from scene to scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .studio import STUDIO, studio

_SCENE = """<?xml version="1.0" encoding="utf-8"?>
<!-- {comment}
     The mesh has {triangles} triangles. All files were written by
     refscatter scenes {name} --triangles {triangles} -->
<scene version="3.0.0">
    <default name="spp" value="1"/>
    <default name="res" value="256"/>
    <default name="surfaces" value="true"/>

    <integrator type="refscatter">
        <boolean name="surfaces" value="$surfaces"/>
    </integrator>
{medium_before}
    <sensor type="perspective">
        <float name="fov" value="{fov}"/>
        <transform name="to_world">
            <lookat origin="{camera}" target="{target}" up="0, 1, 0"/>
        </transform>{medium_of_camera}
        <sampler type="independent">
            <integer name="sample_count" value="$spp"/>
        </sampler>
        <film type="hdrfilm">
            <integer name="width" value="$res"/>
            <integer name="height" value="$res"/>
            <string name="component_format" value="float32"/>
        </film>
    </sensor>
{lights}
    <shape type="ply" id="body">
        <string name="filename" value="meshes/{name}.ply"/>{transform}
        <bsdf type="dielectric">
            <float name="int_ior" value="{eta}"/>
            <float name="ext_ior" value="1.0"/>
        </bsdf>
        {medium_of_body}
    </shape>
{objects}</scene>
"""

_MEDIUM = """<medium type="homogeneous" {name}>
            <rgb name="sigma_t" value="{sigma_t}"/>
            <float name="scale" value="{scale}"/>
            <rgb name="albedo" value="{albedo}"/>
            {phase}
        </medium>"""

_ROTATION = """
        <transform name="to_world">
            {rotation}
        </transform>"""

_HG = """<phase type="hg">
                <float name="g" value="{g}"/>
            </phase>"""


def _point(position: str, intensity: str) -> str:
    return f"""
    <emitter type="point">
        <point name="position" value="{position}"/>
        <rgb name="intensity" value="{intensity}"/>
    </emitter>
"""


def _spot(origin: str, target: str, intensity: str, cutoff: float) -> str:
    return f"""
    <emitter type="spot">
        <transform name="to_world">
            <lookat origin="{origin}" target="{target}" up="0, 1, 0"/>
        </transform>
        <rgb name="intensity" value="{intensity}"/>
        <float name="cutoff_angle" value="{cutoff}"/>
        <float name="beam_width" value="{0.6 * cutoff:g}"/>
    </emitter>
"""


def _sun(direction: str, irradiance: str) -> str:
    return f"""
    <emitter type="directional">
        <vector name="direction" value="{direction}"/>
        <rgb name="irradiance" value="{irradiance}"/>
    </emitter>
"""


def _sky(radiance: str) -> str:
    return f"""
    <emitter type="constant">
        <rgb name="radiance" value="{radiance}"/>
    </emitter>
"""


def _envmap(filename: str, scale: float) -> str:
    return f"""
    <emitter type="envmap">
        <string name="filename" value="{filename}"/>
        <float name="scale" value="{scale}"/>
    </emitter>
"""


def _diffuse(kind: str, name: str, transform: str, reflectance: str) -> str:
    return f"""
    <shape type="{kind}" id="{name}">
        <transform name="to_world">
            {transform}
        </transform>
        <bsdf type="diffuse">
            <rgb name="reflectance" value="{reflectance}"/>
        </bsdf>
    </shape>
"""


def _floor(height: float, size: float = 8, reflectance: str = "0.05, 0.055, 0.065") -> str:
    transform = f"""<rotate x="1" angle="-90"/>
            <scale value="{size}"/>
            <translate y="{height}"/>"""
    return _diffuse("rectangle", "floor", transform, reflectance)


def _sphere(centre, radius: float, reflectance: str) -> str:
    x, y, z = (f"{v:.3f}" for v in centre)
    return f"""
    <shape type="sphere">
        <point name="center" x="{x}" y="{y}" z="{z}"/>
        <float name="radius" value="{radius:.3f}"/>
        <bsdf type="diffuse"> <rgb name="reflectance" value="{reflectance}"/> </bsdf>
    </shape>
"""


def _cylinder(start, end, radius: float, reflectance: str) -> str:
    (a, b, c), (x, y, z) = ([f"{v:.3f}" for v in p] for p in (start, end))
    return f"""
    <shape type="cylinder">
        <point name="p0" x="{a}" y="{b}" z="{c}"/>
        <point name="p1" x="{x}" y="{y}" z="{z}"/>
        <float name="radius" value="{radius:.3f}"/>
        <bsdf type="twosided">
            <bsdf type="diffuse"> <rgb name="reflectance" value="{reflectance}"/> </bsdf>
        </bsdf>
    </shape>
"""


def _ant() -> str:
    """An ant of spheres and cylinders, about 0.9 long."""
    dark = "0.02, 0.014, 0.01"
    ahead, up, aside = np.array([0.82, 0.14, 0.55]), np.array([-0.2, 0.97, 0.05]), np.array([-0.53, -0.15, 0.84])

    def at(x, y, z):
        return np.array([0.0, 0.02, 0.0]) + x * ahead + y * up + z * aside

    balls = [
        (-0.36, 0, 0.105),
        (-0.25, 0.02, 0.135),
        (-0.1, 0.01, 0.06),
        (0.02, 0.02, 0.075),
        (0.12, 0.03, 0.06),
        (0.27, 0.06, 0.1),
    ]
    parts = [_sphere(at(x, y, 0), radius, dark) for x, y, radius in balls]
    for side in (-1, 1):
        for x, forwards in ((-0.03, -0.2), (0.04, 0.02), (0.11, 0.2)):
            hip, knee = at(x, 0, 0.05 * side), at(x + 0.5 * forwards, 0.12, 0.2 * side)
            parts.append(_cylinder(hip, knee, 0.014, dark))
            parts.append(_cylinder(knee, at(x + forwards, -0.17, 0.31 * side), 0.011, dark))
        parts.append(_cylinder(at(0.33, 0.1, 0.04 * side), at(0.42, 0.2, 0.1 * side), 0.01, dark))
        parts.append(_cylinder(at(0.42, 0.2, 0.1 * side), at(0.53, 0.14, 0.16 * side), 0.01, dark))
    return "".join(parts)


def _stones() -> str:
    """Boulders on the bed and a buoy below the surface."""
    grey = "0.2, 0.2, 0.18"
    places = [(-3.2, -5.6, 0.5, 1.1), (-4.6, -5.8, 2.0, 0.7), (3.4, -5.5, -2.5, 1.4), (2.2, -5.9, 1.5, 0.5)]
    return "".join(_sphere(place[:3], place[3], grey) for place in places) + _sphere(
        (0.7, -1.2, 0.5), 0.45, "0.5, 0.1, 0.05"
    )


@dataclass(frozen=True)
class Scene:
    """What one scene says: text in Mitsuba's notation, numbers in scene units.

    comment    at the head of the file
    triangles  of the committed mesh
    camera     its position
    target     point that it looks at
    fov        its field of view, degrees
    lights     elements of XML
    sigma_t    extinction coefficient as rgb, each in [0, 1] as Mitsuba wants it
    albedo     of single scattering, rgb
    scale      factor of ``sigma_t``
    g          of the phase function; 0: isotropic
    eta        index of refraction of the body, relative to air
    rotation   element of XML that turns the body, or nothing
    objects    elements of XML besides the body
    under      whether the camera is in the body's medium
    files      what else the scene needs: name, and function that makes the bytes
    """

    comment: str
    triangles: int
    camera: str
    target: str
    fov: float
    lights: str
    sigma_t: str
    albedo: str
    scale: float = 1.0
    g: float = 0.0
    eta: float = 1.5
    rotation: str = ""
    objects: str = ""
    under: bool = False
    files: dict[str, Callable[[], bytes]] = field(default_factory=dict)

    def xml(self, name: str, triangles: int) -> str:
        """Return the scene file for a mesh of so many triangles."""
        medium = _MEDIUM.format(
            name='id="medium"' if self.under else 'name="interior"',
            sigma_t=self.sigma_t,
            scale=self.scale,
            albedo=self.albedo,
            phase=_HG.format(g=self.g) if self.g else '<phase type="isotropic"/>',
        )
        return _SCENE.format(
            name=name,
            triangles=triangles,
            comment=self.comment,
            camera=self.camera,
            target=self.target,
            fov=self.fov,
            lights=self.lights,
            eta=self.eta,
            medium_before="\n    " + medium.replace("\n    ", "\n") + "\n" if self.under else "",
            medium_of_camera='\n        <ref id="medium"/>' if self.under else "",
            medium_of_body='<ref name="interior" id="medium"/>' if self.under else medium,
            transform=_ROTATION.format(rotation=self.rotation) if self.rotation else "",
            objects=self.objects,
        )


SCENES = {
    "bumpy_sphere": Scene(
        comment="A ball of amber under a bare bulb: its bumps are lenses that throw\n"
        "     volume caustics through the medium.",
        triangles=20480,
        camera="0, 1.1, 5.2",
        target="0, -0.03, 0",
        fov=25,
        lights=_point("-2.6, 2.4, -0.9", "60, 57, 52"),
        sigma_t="0.4, 0.7, 1.0",
        albedo="0.95, 0.7, 0.25",
        objects=_floor(-1.05),
    ),
    "sphere": Scene(
        comment="A ball of honey: the caustic of a sphere has a closed form.",
        triangles=5120,
        camera="0, 0.8, 5.2",
        target="0, 0, 0",
        fov=24,
        lights=_point("-9.0, 4.5, -3.0", "540, 513, 468"),
        sigma_t="0.3, 0.5, 0.9",
        albedo="0.98, 0.8, 0.3",
    ),
    "rounded_cube": Scene(
        comment="A block of ice with round edges and a groove along each mid-plane.",
        triangles=20480,
        camera="0, 1.9, 5.2",
        target="0, -0.05, 0",
        fov=25,
        lights=_point("-2.4, 2.6, -1.6", "60, 60, 60"),
        sigma_t="0.45, 0.25, 0.2",
        scale=2.0,
        albedo="0.6, 0.9, 0.98",
        g=0.2,
        rotation='<rotate y="1" angle="28"/>',
        objects=_floor(-0.83),
    ),
    "branches": Scene(
        comment="A glass coral: a branching body, not a compact one, whose arms shadow\n     each other.",
        triangles=20000,
        camera="0, 0.9, 5.4",
        target="-0.05, -0.1, 0",
        fov=26,
        lights=_point("-2.6, 2.8, -0.6", "60, 57, 54"),
        sigma_t="0.4, 0.8, 0.95",
        scale=4.0,
        albedo="0.95, 0.6, 0.5",
        objects=_floor(-1.05),
    ),
    "amber": Scene(
        comment="An ant in amber, in a photographer's studio (an environment map) with a spot:\n"
        "     the ant throws shadows into the light that the stone's surface bundles.",
        triangles=5120,
        camera="0.4, 1.3, 6.0",
        target="0, -0.03, 0",
        fov=25,
        lights=_envmap(STUDIO, 1.0) + _spot("-2.2, 4.2, -2.2", "0, 0.05, 0", "130, 120, 100", 16),
        sigma_t="0.25, 0.5, 0.95",
        albedo="0.95, 0.75, 0.3",
        scale=1.2,
        g=0.3,
        eta=1.54,
        objects=_ant() + _floor(-0.95, 12, "0.25, 0.24, 0.23"),
        files={STUDIO: studio},
    ),
    "underwater": Scene(
        comment="Below the waves of a lake, the sun before the camera: the surface bundles\n"
        "     its light to shafts, the stones cut them off.",
        triangles=20000,
        camera="0, -4.2, 9.0",
        target="0.3, -2.6, 0",
        fov=60,
        lights=_sun("0.25, -1, 0.35", "6, 5.7, 5.2") + _sky("0.25, 0.4, 0.6"),
        sigma_t="0.22, 0.12, 0.1",
        albedo="0.6, 0.8, 0.85",
        g=0.6,
        eta=1.33,
        objects=_stones() + _floor(-6, 60, "0.5, 0.45, 0.35"),
        under=True,
    ),
}

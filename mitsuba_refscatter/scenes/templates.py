"""The scene files: one common text, and what differs from scene to scene."""

from __future__ import annotations

from dataclasses import dataclass

_SCENE = """<?xml version="1.0" encoding="utf-8"?>
<!-- {comment}
     The mesh has {triangles} triangles. Both files were written by
     refscatter scenes {name} --triangles {triangles} -->
<scene version="3.0.0">
    <default name="spp" value="1"/>
    <default name="res" value="256"/>
    <default name="surfaces" value="true"/>

    <integrator type="refscatter">
        <boolean name="surfaces" value="$surfaces"/>
    </integrator>

    <sensor type="perspective">
        <float name="fov" value="{fov}"/>
        <transform name="to_world">
            <lookat origin="{camera}" target="{target}" up="0, 1, 0"/>
        </transform>
        <sampler type="independent">
            <integer name="sample_count" value="$spp"/>
        </sampler>
        <film type="hdrfilm">
            <integer name="width" value="$res"/>
            <integer name="height" value="$res"/>
            <string name="component_format" value="float32"/>
        </film>
    </sensor>

    <emitter type="point">
        <point name="position" value="{light}"/>
        <rgb name="intensity" value="{intensity}"/>
    </emitter>

    <shape type="ply" id="body">
        <string name="filename" value="meshes/{name}.ply"/>{transform}
        <bsdf type="dielectric">
            <float name="int_ior" value="1.5"/>
            <float name="ext_ior" value="1.0"/>
        </bsdf>
        <medium type="homogeneous" name="interior">
            <rgb name="sigma_t" value="{sigma_t}"/>
            <float name="scale" value="{scale}"/>
            <rgb name="albedo" value="{albedo}"/>
            {phase}
        </medium>
    </shape>
{floor}</scene>
"""

_FLOOR = """
    <shape type="rectangle" id="floor">
        <transform name="to_world">
            <rotate x="1" angle="-90"/>
            <scale value="8"/>
            <translate y="{height}"/>
        </transform>
        <bsdf type="diffuse">
            <rgb name="reflectance" value="0.05, 0.055, 0.065"/>
        </bsdf>
    </shape>
"""

_ROTATION = """
        <transform name="to_world">
            {rotation}
        </transform>"""

_HG = """<phase type="hg">
                <float name="g" value="{g}"/>
            </phase>"""


@dataclass(frozen=True)
class Scene:
    """What one scene says: text in Mitsuba's notation, numbers in scene units.

    ``sigma_t`` is multiplied by ``scale`` (Mitsuba wants rgb values in [0, 1]).
    """

    comment: str
    triangles: int
    camera: str
    target: str
    fov: float
    light: str
    intensity: str
    sigma_t: str
    albedo: str
    scale: float = 1.0
    g: float = 0.0
    rotation: str = ""
    floor: float | None = None

    def xml(self, name: str, triangles: int) -> str:
        """Return the scene file for a mesh of so many triangles."""
        return _SCENE.format(
            name=name,
            triangles=triangles,
            comment=self.comment,
            camera=self.camera,
            target=self.target,
            fov=self.fov,
            light=self.light,
            intensity=self.intensity,
            sigma_t=self.sigma_t,
            albedo=self.albedo,
            scale=self.scale,
            phase=_HG.format(g=self.g) if self.g else '<phase type="isotropic"/>',
            transform=_ROTATION.format(rotation=self.rotation) if self.rotation else "",
            floor="" if self.floor is None else _FLOOR.format(height=self.floor),
        )


SCENES = {
    "bumpy_sphere": Scene(
        comment="A ball of amber under a bare bulb: its bumps are lenses that throw\n"
        "     volume caustics through the medium.",
        triangles=20480,
        camera="0, 1.1, 5.2",
        target="0, -0.03, 0",
        fov=25,
        light="-2.6, 2.4, -0.9",
        intensity="60, 57, 52",
        sigma_t="0.4, 0.7, 1.0",
        albedo="0.95, 0.7, 0.25",
        floor=-1.05,
    ),
    "sphere": Scene(
        comment="A ball of honey: the caustic of a sphere has a closed form.",
        triangles=5120,
        camera="0, 0.8, 5.2",
        target="0, 0, 0",
        fov=24,
        light="-9.0, 4.5, -3.0",
        intensity="540, 513, 468",
        sigma_t="0.3, 0.5, 0.9",
        albedo="0.98, 0.8, 0.3",
    ),
    "rounded_cube": Scene(
        comment="A block of ice with round edges and a groove along each mid-plane.",
        triangles=20480,
        camera="0, 1.9, 5.2",
        target="0, -0.05, 0",
        fov=25,
        light="-2.4, 2.6, -1.6",
        intensity="60, 60, 60",
        sigma_t="0.45, 0.25, 0.2",
        scale=2.0,
        albedo="0.6, 0.9, 0.98",
        g=0.2,
        rotation='<rotate y="1" angle="28"/>',
        floor=-0.83,
    ),
    "branches": Scene(
        comment="A glass coral: a branching body, not a compact one, whose arms shadow\n     each other.",
        triangles=20000,
        camera="0, 0.9, 5.4",
        target="-0.05, -0.1, 0",
        fov=26,
        light="-2.6, 2.8, -0.6",
        intensity="60, 57, 54",
        sigma_t="0.4, 0.8, 0.95",
        scale=4.0,
        albedo="0.95, 0.6, 0.5",
        floor=-1.05,
    ),
}

"""What a scene may hold: one list for the reader, its error messages, the tests and the table in the README."""

from dataclasses import dataclass

from .errors import SceneError


@dataclass(frozen=True)
class Part:
    """A part of a scene: ``kind`` and ``name`` as in the table, and ``how`` it is handled.

    ``says``: where it is refused, what the error message says after the object's name: the reason, and what to do, with
    fields in braces. Empty where it is supported.
    """

    kind: str
    name: str
    how: str
    says: str = ""


DELTA_EMITTERS = ("PointLight", "SpotLight", "DirectionalEmitter", "Projector")
"""Class names of emitters at one point or in one direction."""

CONVEX_EMITTERS = ("Sphere", "Rectangle", "Disk")
"""Shapes that are never in the way of the light that they send themselves."""

BOUNDARIES = {"SmoothDielectric": "refracts", "Null": "null", "ThinDielectric": "thin"}
"""BSDFs of the boundaries of bodies, by class name: light is refracted, goes on straight, or straight with
Fresnel loss."""

MESHED_MIRRORS = ("Sphere", "Cylinder", "Disk", "Rectangle")
"""Shapes that are no meshes but become such where they are mirrors."""

PERTURBED = {
    "BumpMap": "bumpmap",
    "NormalMap": "normalmap",
    "MaskBSDF": "mask",
    "BlendBSDF": "blendbsdf",
    "TwoSidedBRDF": "twosided",
}
"""BSDFs that may hold a dielectric, by class name: the boundary would not be smooth, or not everywhere."""

MEDIUM = "HomogeneousMedium"

SUPPORTED = {
    "point": Part("emitter", "`point`", "exact"),
    "spot": Part("emitter", "`spot`, `projector`", "exact, falloff and texture by Mitsuba's own evaluation"),
    "directional": Part("emitter", "`directional`", "exact"),
    "area": Part("emitter", "`area` on any shape, textured or not", "`light_samples` points per pass"),
    "environment": Part("emitter", "`constant`, `envmap`, `sunsky`", "`light_samples` directions per pass"),
    "several": Part("emitter", "several at once", "exact ones all; the others share `light_samples` by their power"),
    "dielectric": Part("boundary", "`dielectric`", "any relative index, above, below or equal to 1"),
    "straight": Part("boundary", "`null`, `thindielectric`", "light goes straight, also through several of them"),
    "tints": Part("boundary", "constant `specular_transmittance`, `specular_reflectance`", "in every crossing"),
    "mesh": Part(
        "shape", "`ply`, `obj`, `serialized`, `cube`, `rectangle`", "closed or open; facet or interpolated normals"
    ),
    "analytic": Part("shape", "`sphere`, `cylinder`, `disk`", "tessellated with exact normals as `tolerance` asks"),
    "instance": Part("shape", "`instance` of a `shapegroup`", "each copy of a boundary becomes a mesh"),
    "camera": Part(
        "position", "camera outside or inside of media", "inside: the sensor names the medium that it is in"
    ),
    "light inside": Part(
        "position", "light outside or inside of media", "inside: light also goes straight to where it scatters"
    ),
    "opaque": Part("position", "opaque objects outside or inside", "shadows, and ends of camera rays"),
    "bodies": Part("position", "several bodies, also touching each other", "each with its own index and medium"),
    "nested": Part(
        "position",
        "bodies inside others: bubbles, hollow shells",
        "those inside name the medium around as their exterior",
    ),
    "seen": Part(
        "position",
        "bodies behind clear glass or in a mirror (smooth `conductor`)",
        "up to `internal_bounces` such hits",
    ),
    "glass between": Part(
        "position",
        "a `dielectric` between a light and a body",
        "light goes through it with `light_bounces` 2 and more; else it casts a shadow, which a warning says",
    ),
    "homogeneous": Part("medium", "`homogeneous`", "rgb or spectral, `scale`; any albedo"),
    "hg": Part("phase function", "`isotropic`, `hg`", "closed forms"),
    "phase": Part("phase function", "any other", "by its own `eval_pdf`"),
}
"""What is supported, by key."""

REFUSED = {
    "emitter": Part(
        "emitter",
        "`directionalarea` and what is not listed above",
        "no points that light all of a body",
        "is of a kind that refscatter has no light points for: use a point, spot, directional, area, "
        "constant or envmap",
    ),
    "perturbed": Part(
        "boundary",
        "`bumpmap`, `normalmap`, `mask`, `blendbsdf`, `twosided` around a `dielectric`",
        "must be smooth everywhere",
        "has a dielectric inside the BSDF {bsdf}: refscatter needs the plain dielectric",
    ),
    "bsdf": Part(
        "boundary",
        "any other BSDF on a shape with an interior medium",
        "must be smooth: `roughdielectric` scatters",
        "has an interior medium but the BSDF {bsdf}: refscatter needs a smooth dielectric, a thindielectric "
        "or a null as its boundary",
    ),
    "tint varies": Part(
        "boundary",
        "textured `specular_transmittance`, `specular_reflectance`",
        "must be constant",
        "has a {what} that varies over the surface: refscatter needs a constant one",
    ),
    "shines": Part(
        "boundary",
        "a boundary that is an emitter or a sensor, too",
        "light would start on it",
        "is the boundary of a body and its {what} at once: refscatter does not support this; remove the {what}",
    ),
    "shape": Part(
        "shape",
        "`sdfgrid`, curves, `ellipsoids` as a boundary",
        "no triangles are made of them",
        "is a {shape}, of which refscatter makes no triangles: the boundary of a body must be a mesh; give "
        "it as a ply or obj",
    ),
    "to_world": Part(
        "shape",
        "a `sphere` that is scaled unevenly",
        "not supported by Mitsuba itself",
        "is a {shape} with a to_world that scales it unevenly or shears it, which Mitsuba does not support: "
        "give it as a ply or obj",
    ),
    "winding": Part(
        "shape",
        "neighbouring triangles that wind inconsistently",
        "no inside and outside",
        "has triangles that wind inconsistently (at {count} edges, the first {edge}): reverse those on one "
        "side of these edges, so that "
        "all have the same orientation",
    ),
    "crowded": Part(
        "shape",
        "edges of three or more triangles",
        "no inside and outside",
        "has edges of three or more triangles ({count}, the first {edge}, of {triangles}): remove the "
        "triangles that are too many there, "
        "or split the mesh at these edges into shapes of their own",
    ),
    "repeated": Part(
        "shape",
        "triangles that are there twice",
        "no inside and outside",
        "has triangles that are there twice ({count}, the first around {place}): merge each with its copy",
    ),
    "hole": Part(
        "shape",
        "an open surface that the camera sees from both sides",
        "the medium behind it would begin nowhere",
        "is met from outside and, by {share} of the camera rays that hit anything, from inside, where "
        "{medium} would begin nowhere: "
        "fill the hole in it ({count} open edges, the first {edge}), or if the camera is in that medium name "
        "it in the sensor",
    ),
    "overlap": Part(
        "position",
        "bodies that overlap",
        "the medium there is not defined",
        "overlaps {other}: refscatter supports volumes apart from or inside each other only; separate them",
    ),
    "exterior": Part(
        "position",
        "a body inside another that does not name the medium around it",
        "both must say the same",
        "is inside {other}, where {around} is, but has {what}: name {around} as its {side}",
    ),
    "straight inside": Part(
        "position",
        "a `null` or `thindielectric` inside a medium that light is refracted into",
        "that light is not followed through it",
        "is a boundary that does not refract, in a medium that light enters through {other}, which does: "
        "refscatter does not "
        "follow refracted light through it; remove it",
    ),
    "camera medium": Part(
        "position",
        "a camera inside a body, or behind an open surface, whose medium its sensor does not name",
        "both must say the same",
        "{where} and has {medium} there, but the sensor names {named}: give it a reference to that medium, {instead}",
    ),
    "sensor medium": Part(
        "position",
        "a sensor that names a medium where its camera is in none",
        "both must say the same",
        "{where} and has no medium there, but the sensor names {named}: remove that from the sensor, or give "
        "it to the shape as its {side}",
    ),
    "sensor outside": Part(
        "position",
        "a camera outside of the body whose medium its sensor names",
        "both must say the same",
        "holds {medium} that the sensor names, but the camera is outside of it: remove the medium from the "
        "sensor, or move it in",
    ),
    "medium": Part(
        "medium",
        "`heterogeneous`",
        "attenuation must have a closed form",
        "has the medium {medium}: refscatter needs a homogeneous one",
    ),
    "varies": Part(
        "medium",
        "coefficients or phase functions that vary in space",
        "must be constant",
        "has a medium whose {what} varies in space: refscatter needs a constant one",
    ),
    "gradients": Part(
        "other",
        "derivatives",
        "not computed yet",
        "has gradients enabled: refscatter does not compute derivatives yet; call dr.disable_grad on it",
    ),
}
"""What is refused, by key."""


def refusal(key, name, **fields):
    """The ``SceneError`` that refuses the object ``name``; ``fields``: of the entry's message."""
    return SceneError(f"{name} {REFUSED[key].says.format(**fields)}")


def table():
    """The list as a table in Markdown."""
    kinds = list(dict.fromkeys(part.kind for part in (*SUPPORTED.values(), *REFUSED.values())))
    rows = [
        f"| {part.kind} | {part.name} | {'no: ' if part.says else ''}{part.how} |"
        for kind in kinds
        for part in (*SUPPORTED.values(), *REFUSED.values())
        if part.kind == kind
    ]
    return "\n".join(["| part of a scene | | |", "|---|---|---|", *rows])

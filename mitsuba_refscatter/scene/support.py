"""What a scene may hold: one list for the reader, its error messages, the tests and the table in the README."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Part:
    """A part of a scene: ``kind`` (column of the table), ``name`` (as in a scene file), and how it is handled; where it is
    not (``supported`` is False), ``how`` is the error message's reason and what to do."""

    kind: str
    name: str
    how: str
    supported: bool = True


DELTA_EMITTERS = ("PointLight", "SpotLight", "DirectionalEmitter", "Projector")
"""Class names of emitters at one point or in one direction."""

CONVEX_EMITTERS = ("Sphere", "Rectangle", "Disk")
"""Shapes that are never in the way of the light that they send themselves."""

REFUSED_EMITTERS = {
    "DirectionalArea": "is a directionalarea: refscatter has no light points for it; use a directional or an area emitter",
    "other": "is of a kind that refscatter has no light points for: use point, spot, directional, area, constant or envmap",
}

BOUNDARIES = {"SmoothDielectric": "refracts", "Null": "null", "ThinDielectric": "thin"}
"""BSDFs of the boundaries of bodies, by class name: light is refracted, goes on straight, or straight with Fresnel loss."""

PERTURBED = {
    "BumpMap": "bumpmap",
    "NormalMap": "normalmap",
    "MaskBSDF": "mask",
    "BlendBSDF": "blendbsdf",
    "TwoSidedBRDF": "twosided",
}
"""BSDFs that may hold a dielectric, by class name: the boundary would not be smooth, or not everywhere."""

MEDIUM = "HomogeneousMedium"

PARTS = (
    Part("emitter", "point, spot, projector", "exact; a spot's falloff and texture by Mitsuba's own evaluation"),
    Part("emitter", "directional", "exact"),
    Part("emitter", "area (on any shape, textured)", "`light_samples` light points per pass"),
    Part("emitter", "constant, envmap, sunsky", "`light_samples` directions per pass"),
    Part("emitter", "directionalarea", REFUSED_EMITTERS["DirectionalArea"], False),
    Part("boundary", "dielectric", "any relative index; constant specular_transmittance and specular_reflectance"),
    Part("boundary", "null, thindielectric", "light goes on straight, also through several of them"),
    Part("boundary", "bumpmap, normalmap, mask, blendbsdf around a dielectric", "refused: the boundary must be a plain dielectric", False),
    Part("boundary", "roughdielectric with a medium", "refused: the boundary must be smooth", False),
    Part("boundary", "textured specular_transmittance or specular_reflectance", "refused: must be constant", False),
    Part("shape", "ply, obj, serialized, cube, rectangle", "meshes with facet or interpolated normals, closed or open"),
    Part("shape", "sphere, cylinder, disk", "tessellated with exact normals as finely as `tolerance` asks"),
    Part("shape", "instance, shapegroup", "each copy of a boundary becomes a mesh"),
    Part("shape", "sdfgrid, curves, ellipsoids as a boundary", "refused: give a mesh", False),
    Part("position", "camera inside or outside of media", "inside: the sensor names the medium it is in"),
    Part("position", "lights inside or outside of media", "inside: light also goes straight to where it scatters"),
    Part("position", "opaque objects inside or outside", "shadows, and ends of camera rays"),
    Part("position", "several bodies, bodies inside others (bubbles, hollow shells)", "each with its own index and medium; those around others name the medium as the inner one's exterior"),
    Part("position", "mirrors (conductor), clear glass on the camera's side", "followed up to `internal_bounces`"),
    Part("position", "a dielectric between light and body", "casts a shadow: no connection through it is made"),
    Part("position", "bodies that overlap", "refused: volumes must be apart from or inside each other", False),
    Part("medium", "homogeneous", "rgb, spectral, scale"),
    Part("medium", "heterogeneous, or coefficients that vary in space", "refused: must be homogeneous", False),
    Part("phase function", "isotropic, hg", "closed forms"),
    Part("phase function", "any other", "by its own evaluation"),
    Part("other", "gradients", "refused: call dr.disable_grad", False),
)  # fmt: skip


def table():
    """The list as a table in Markdown."""
    rows = [f"| {p.kind} | {p.name} | {'yes' if p.supported else 'no'} | {p.how} |" for p in PARTS]
    return "\n".join(["| part of a scene | | supported | how |", "|---|---|---|---|", *rows])

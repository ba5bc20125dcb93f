"""Boundaries of bodies: triangle meshes with a smooth dielectric, or with one that does not refract.

Body coordinates are world coordinates minus the body's centre, so that float32 keeps its digits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core.arrays import NONE  # no body; the region that has no medium and is no body's inside
from ..core.cache import BodyKey, fingerprint
from ..geometry import mesh as mesh_facts
from ..geometry import triangle
from .errors import SceneError, name_edge, name_part, name_place, name_shape
from .support import BOUNDARIES, PERTURBED, refusal


@dataclass(eq=False)
class Body:
    """A triangle mesh that is the boundary between two regions: ``inside`` it, behind the normals, and ``outside``.

    name            as messages call it
    shape           Mitsuba's
    index           its number among the bodies of the scene
    kind            a value of ``support.BOUNDARIES``, or ``mirror``
    eta             index of refraction inside over outside
    corners         float64 (F, 3, 3), world
    normals         float64 (F, 3), unit, geometric, outward
    corner_normals  float64 (F, 3, 3), unit
    twin            (3 F,) of each directed edge (``mesh.twins``)
    closed          whether the mesh is
    convex          whether it is
    centre          three floats, world: origin of the body's coordinates
    box             of the mesh, world: low (3,) and high (3,)
    first_record    number of its first triangle in ``Scene.records``
    extent          largest coordinate, world
    box_low         of what its light can reach, three floats, body coordinates
    box_high        the same
    size            diagonal of that, or where it has no end the length that matters
    tints           textures ``specular_transmittance`` and ``specular_reflectance``, where the BSDF has them
    key             what all of this but names, numbers and tints follows from
    faces           (F, 3) indices of vertices with one position and normal each; None where normals are those of facets
    inside          index of the region behind its normals, or NONE
    outside         index of the region before them, or NONE
    """

    name: str
    shape: mi.Shape
    index: int
    kind: str
    eta: float
    corners: np.ndarray
    normals: np.ndarray
    corner_normals: np.ndarray
    twin: np.ndarray
    closed: bool
    convex: bool
    centre: list[float]
    box: tuple[np.ndarray, np.ndarray]
    first_record: int
    extent: float
    box_low: list[float]
    box_high: list[float]
    size: float
    tints: dict[str, mi.Texture]
    key: BodyKey
    faces: np.ndarray | None
    inside: int = NONE
    outside: int = NONE

    @property
    def triangle_count(self):
        """Number of its triangles."""
        return len(self.corners)

    @property
    def refracts(self):
        """Whether its boundary bends light."""
        return self.kind == "refracts"

    def packed(self):
        """Its triangles as records of ``geometry.triangle``."""
        return triangle.pack(self.corners - np.array(self.centre), self.corner_normals, self.normals)

    def tint(self, what, wavelengths):
        """The constant factor ``specular_transmittance`` or ``specular_reflectance``; 1 where the BSDF has none."""
        if what not in self.tints:
            return mi.Spectrum(1)
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wavelengths = wavelengths
        return self.tints[what].eval(si)

    def extended(self, length):
        """The same where light goes on for the distance ``length`` behind it."""
        low, high = (np.array(x) for x in (self.box_low, self.box_high))
        size = min(self.size + length, tolerances.REACH_SIZE * self.size)
        return replace(self, box_low=(low - length).tolist(), box_high=(high + length).tolist(), size=size,
                       key=replace(self.key, visible_range=length))  # fmt: skip

    def flipped(self, first_record):
        """The same boundary seen from its other side: light from the inside, refracted to the outside. Its
        triangles must be packed again, as those from ``first_record`` on."""
        turned = np.array([0, 2, 1])
        edge = np.array([2, 1, 0])  # of the turned triangle's three edges: which they were
        old = (3 * np.arange(len(self.corners))[:, None] + edge).ravel()
        new_of_old = np.empty(len(old), dtype=np.int64)
        new_of_old[old] = np.arange(len(old))
        twin = self.twin[old]
        return replace(
            self,
            eta=1 / self.eta,
            corners=self.corners[:, turned],
            normals=-self.normals,
            closed=False,
            convex=False,
            corner_normals=-self.corner_normals[:, turned],
            twin=np.where(twin < 0, -1, new_of_old[twin]),
            faces=None if self.faces is None else self.faces[:, turned],
            first_record=first_record,
            inside=self.outside,
            outside=self.inside,
            key=replace(self.key, flipped=True),
        )


def refuse_shining(shape):
    """Refuses a boundary that is an emitter or a sensor."""
    for it_is, what in ((shape.is_emitter(), "emitter"), (shape.is_sensor(), "sensor")):
        if it_is:
            raise refusal("shines", name_shape(shape), what=what)


def kind_of(shape):
    """The kind of boundary that a shape is (a value of ``support.BOUNDARIES``); None if it is an ordinary
    surface. Refuses shapes that are neither."""
    bsdf, name = shape.bsdf(), name_shape(shape)
    bsdf_kind = bsdf.class_name() if bsdf is not None else "none"
    if shape.class_name() in ("Instance", "ShapeGroup", "ShapeGroupPlugin"):
        return None
    if bsdf_kind in BOUNDARIES:
        refuse_shining(shape)
        return BOUNDARIES[bsdf_kind]
    if bsdf is not None and any(
        key.endswith("bsdf.eta") or key.endswith("bsdf_0.eta") for key in mi.traverse(bsdf).keys()
    ):
        if bsdf_kind in PERTURBED:
            raise refusal("perturbed", name, bsdf=PERTURBED[bsdf_kind])
    if shape.interior_medium() is not None:
        raise refusal("bsdf", name, bsdf=bsdf_kind)
    return None


def read(shape, kind, index, first_record, cache):
    """``Body`` of a mesh. ``cache``: ``Cache`` for what follows from the mesh alone."""
    name = name_shape(shape)
    if not shape.is_mesh():
        raise refusal("shape", name, shape=shape.class_name().lower())
    eta, tints = _properties(shape.bsdf(), kind, name)
    has = shape.has_vertex_normals(), shape.has_face_normals(), shape.has_flipped_normals()
    buffers = shape.faces_buffer(), shape.vertex_positions_buffer(), shape.vertex_normals_buffer()
    key = BodyKey(kind, eta, has, fingerprint(*buffers))
    body = cache.once(lambda: _read(shape, kind, eta, name, key), key)
    return replace(body, name=name, shape=shape, index=index, first_record=first_record, tints=tints)


def read_mirror(shape, first_record, cache):
    """``Body`` of a mesh that is a mirror: nothing goes through it."""
    name = name_shape(shape)
    has = shape.has_vertex_normals(), shape.has_face_normals(), shape.has_flipped_normals()
    buffers = shape.faces_buffer(), shape.vertex_positions_buffer(), shape.vertex_normals_buffer()
    key = BodyKey("mirror", 1.0, has, fingerprint(*buffers))
    body = cache.once(lambda: _read(shape, "mirror", 1.0, name, key), key)
    return replace(body, name=name, shape=shape, first_record=first_record)


def _read(shape, kind, eta, name, key):
    """``Body`` of a mesh, the first of its scene and without tints."""
    vertices, faces, normals = _read_mesh(shape, name)
    corners = vertices[faces]
    topology, twin = faces, mesh_facts.twins(faces)
    if twin is None or (twin < 0).any():  # a seam has several vertices at one position
        topology = mesh_facts.weld(vertices, faces)
        twin = mesh_facts.twins(topology)
    if twin is None:
        raise _one_sided(corners, topology, name)
    part, closed = mesh_facts.components(topology), bool((twin >= 0).all())
    winding, agreement = triangle.geometric_normal(corners), None
    if normals is not None:
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        agreement = np.bincount(part, np.einsum("fki,fi,f->f", normals[faces], winding, area))
    Ng = _outward(corners, winding, part, name) if closed else _front(shape, winding, agreement)
    corner_normals = np.repeat(Ng[:, None, :], 3, axis=1)
    smooth = kind == "mirror" or (eta != 1 and kind == "refracts")
    if normals is not None and smooth:  # else shading normals play no part
        turned = np.sign(agreement)[part] * np.sign(np.einsum("fi,fi->f", Ng, winding))
        corner_normals = normals[faces] * np.where(turned < 0, -1, 1)[:, None, None]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    centre = np.float64(np.float32(0.5 * (low + high)))
    return Body(
        name=name,
        shape=None,
        index=0,
        kind=kind,
        eta=eta,
        corners=corners,
        normals=Ng,
        corner_normals=corner_normals,
        twin=twin,
        closed=closed,
        convex=closed and mesh_facts.is_convex(corners, Ng, topology, twin),
        centre=centre.tolist(),
        box=(low, high),
        first_record=0,
        extent=float(np.abs(corners).max()),
        box_low=(low - centre).tolist(),
        box_high=(high - centre).tolist(),
        size=float(np.linalg.norm(high - low)),
        tints={},
        key=key,
        faces=faces if normals is not None and smooth else None,
    )


def _one_sided(corners, topology, name):
    """The ``SceneError`` for a mesh whose edges have no twins: the first of the causes that it has."""
    repeated, crowded, triangles, turned = mesh_facts.faults(topology)
    if len(repeated):
        return refusal("repeated", name, count=len(repeated), place=name_place(corners[repeated[0]].mean(axis=0)))
    if len(crowded):
        return refusal("crowded", name, count=len(crowded), edge=name_edge(corners, crowded[0]), triangles=triangles[0])
    return refusal("winding", name, count=len(turned), edge=name_edge(corners, turned[0]))


def _properties(bsdf, kind, name):
    """Relative index of refraction (1 where nothing is refracted but for a thin one's Fresnel term) and tints."""
    eta, tints, parameters = 1.0, {}, mi.traverse(bsdf)
    if kind != "null":
        eta = float(np.array(parameters["eta"]).ravel()[0])
        if not (np.isfinite(eta) and eta > 0):
            raise SceneError(f"{name} has the relative index of refraction {eta}: it must be finite and positive")
    for what in ("specular_transmittance", "specular_reflectance"):
        keys = [key for key in parameters.keys() if key.startswith(what)]
        if not keys:
            continue
        if not all(key.endswith((".value", ".values")) for key in keys):
            raise refusal("tint varies", name, what=what)
        texture = parameters.properties[keys[0]][2]
        if not bool(dr.all(dr.ravel(parameters[keys[0]]) == 1)):
            tints[what] = texture
    return eta, tints


def _front(shape, Ng, agreement):
    """Geometric normals of an open mesh on its outside: where its vertex normals are (``agreement`` with the
    winding, or None), or as its triangles wind; the other side with flip_normals."""
    sign = -1 if shape.has_flipped_normals() else 1
    return Ng * sign * (1 if agreement is None or agreement.sum() >= 0 else -1)


def _outward(corners, normals, part, name):
    """Geometric normals of closed parts, turned outwards; inwards for parts inside others (the walls of cavities).

    A mirrored transform turns the winding: the interior is what the surface encloses, either way.
    """
    pieces = [corners[part == k] for k in range(part.max() + 1)]
    volumes = np.array([mesh_facts.volume(piece) for piece in pieces])
    sizes = np.array([np.ptp(piece.reshape(-1, 3), axis=0).max() for piece in pieces])
    flat = np.flatnonzero(~(np.abs(volumes) >= tolerances.NO_VOLUME * sizes**3))
    if len(flat):
        raise SceneError(
            f"{name} has closed parts that enclose no volume ({len(flat)}, the first of "
            f"{name_part(pieces[flat[0]])}): "
            "remove them or give them thickness"
        )
    signs, around = np.sign(volumes), _around(pieces, name)
    outer = signs.copy()
    for k, piece in enumerate(pieces):
        parents = np.flatnonzero(around[:, k])
        depth = len(parents)
        if (around[:, k] & around[k]).any():
            raise SceneError(
                f"{name} has a part of {name_part(piece)} with another in the same place: remove one of them"
            )
        if depth % 2 == 1:
            if any(signs[p] == signs[k] for p in parents if around[:, p].sum() == depth - 1):
                raise SceneError(
                    f"{name} has a part of {name_part(piece)} inside another that winds the "
                    f"same way: reverse it if it is "
                    "the wall of a cavity, else make it a shape with the medium around it as its exterior"
                )
            outer[k] = -signs[k]
    return normals * outer[part][:, None]


def _around(pieces, name):
    """Which closed part encloses which (n, n): [i, j] where i encloses j. Refuses parts that overlap."""
    n = len(pieces)
    out = np.zeros((n, n), dtype=bool)
    for i in range(n):
        for j in range(n):
            if i != j:
                share = enclosed_share(pieces[i], pieces[j])
                if 0 < share < 1:
                    raise refusal(
                        "overlap",
                        f"a part of {name} ({name_part(pieces[i])})",
                        other=f"another ({name_part(pieces[j])})",
                    )
                out[i, j] = share == 1
    return out


def enclosed_share(outer, inner):
    """Share of (some) corners of the triangles ``inner`` (F, 3, 3) that the closed mesh ``outer`` encloses.

    The corners are moved a little towards their middle: meshes that touch do not enclose each other's corners.
    """
    low, high = outer.min(axis=(0, 1)), outer.max(axis=(0, 1))
    points = inner.reshape(-1, 3)
    points = points + tolerances.FLUSH * (0.5 * (points.min(axis=0) + points.max(axis=0)) - points)
    within = ((points >= low) & (points <= high)).all(axis=1)
    if not within.any():
        return 0.0
    most = tolerances.ENCLOSED_CORNERS
    if within.all():
        tested = points[:: max(1, len(points) // most)]
        return float(np.mean([mesh_facts.encloses(outer, p) for p in tested]))
    tested = points[within][:: max(1, int(within.sum()) // most)]
    return 0.5 if any(mesh_facts.encloses(outer, p) for p in tested) else 0.0


def _read_mesh(shape, name):
    """Vertices (V, 3), faces (F, 3) and unit normals (V, 3) or None for facet normals; float64, world."""
    if shape.face_count() == 0:
        raise SceneError(f"{name} has no triangles: remove it or give it some")
    faces = shape.face_indices(dr.arange(mi.UInt32, shape.face_count())).numpy().T.astype(np.int64)
    bad = np.flatnonzero((faces >= shape.vertex_count()).any(axis=1))
    if len(bad):
        raise SceneError(
            f"{name} has triangles with a vertex that is not there ({len(bad)}, the first with "
            f"the vertices "
            f"{', '.join(map(str, faces[bad[0]]))} of {shape.vertex_count()}, counted from 0): "
            f"write the mesh anew"
        )
    every = dr.arange(mi.UInt32, shape.vertex_count())
    vertices = shape.vertex_position(every).numpy().T.astype(np.float64)
    used = np.unique(faces)
    bad = used[~np.isfinite(vertices[used]).all(axis=1)]
    if len(bad):
        raise SceneError(
            f"{name} has vertices that are not finite ({len(bad)}, the first is number "
            f"{bad[0]}, counted from 0, at "
            f"{name_place(vertices[bad[0]])}): mend the mesh"
        )
    if not shape.has_vertex_normals() or shape.has_face_normals():
        return vertices, faces, None
    normals = shape.vertex_normal(every).numpy().T.astype(np.float64)
    length = np.linalg.norm(normals, axis=1)
    bad = used[~((length[used] > tolerances.VERTEX_NORMAL) & np.isfinite(length[used]))]
    if len(bad):  # Mitsuba's loaders make NaN of zero
        raise SceneError(
            f"{name} has vertex normals that are zero or not finite ({len(bad)}, the first at "
            f"the vertex {name_place(vertices[bad[0]])}): "
            "recompute them, or set face_normals"
        )
    return vertices, faces, normals / np.maximum(length, tolerances.VERTEX_NORMAL)[:, None]


def holds(body, point):
    """Whether a closed body holds a point (world)."""
    within = ((point >= body.box[0]) & (point <= body.box[1])).all()
    return bool(within and mesh_facts.encloses(body.corners, np.asarray(point, dtype=np.float64)))


def boxes_meet(a, b):
    """Whether two boxes (low (3,), high (3,)) have points in common."""
    return bool((a[0] <= b[1]).all() and (b[0] <= a[1]).all())


def box_of(shape):
    """Box of a shape of Mitsuba's, world: low (3,) and high (3,)."""
    box = shape.bbox()
    return np.array(box.min).ravel(), np.array(box.max).ravel()

"""Boundaries that are no triangle meshes in world coordinates yet, replaced by such: spheres, cylinders, disks and
what is instanced.

What a shape looks like is asked of Mitsuba itself, by rays: which way ``to_world`` and ``flip_normals`` turn the
normals differs between its shapes.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..geometry.geodesic import geodesic_sphere
from .boundaries import refuse_shining
from .errors import SceneError, name_shape
from .support import refusal

FREQUENCY_EDGE = 1.2046
"""Mean edge of the unit geodesic sphere times its frequency: that of 20 f^2 equilateral triangles on 4 pi."""


def edge(tolerance):
    """Longest mean edge of triangles, in radii, for a relative error ``tolerance`` of the image."""
    return (tolerances.TESSELLATION_SHARE * tolerance / tolerances.TESSELLATION_ERROR) ** 0.5


def frequency(tolerance):
    """Of the geodesic sphere, which has 20 times its square triangles."""
    return int(np.clip(np.ceil(FREQUENCY_EDGE / max(edge(tolerance), 1e-30)), *tolerances.FREQUENCIES))


def segments(tolerance):
    """Straight edges of a whole circle: the power of two that comes nearest to ``edge``, so that the rims of tubes and
    disks have common vertices."""
    return int(2 ** np.round(np.log2(np.clip(2 * np.pi / max(edge(tolerance), 1e-30), *tolerances.SEGMENTS))))


@dataclass
class Surface:
    """Triangles, float64.

    vertices   (V, 3)
    normals    (V, 3), unit, or None for those of the triangles
    texcoords  (V, 2), or None
    faces      (F, 3), counter-clockwise seen from where the renderer's normals point
    """

    vertices: np.ndarray
    normals: np.ndarray | None
    texcoords: np.ndarray | None
    faces: np.ndarray

    def flipped(self):
        """The same, facing the other way."""
        normals = None if self.normals is None else -self.normals
        return Surface(self.vertices, normals, self.texcoords, self.faces[:, ::-1])

    def moved(self, matrix):
        """The same after an affine transform (4, 4). Normals stay on their side of the surface, mirrored or not."""
        linear, normals = matrix[:3, :3], self.normals
        if normals is not None:
            normals = normals @ np.linalg.inv(linear)
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        faces = self.faces[:, ::-1] if np.linalg.det(linear) < 0 else self.faces
        return Surface(self.vertices @ linear.T + matrix[:3, 3], normals, self.texcoords, faces)


def expand(scene, is_boundary, tolerance):
    """The scene with every boundary as a mesh of its own, in world coordinates. Returns ``scene`` itself, the same
    object, if nothing is to be replaced.

    ``is_boundary(shape)``: whether a ``mi.Shape`` is one; asked of the members of instanced groups and of what is no
    mesh. ``tolerance``: relative error of the image that is aimed at. The new scene shares all else with the old one,
    but the integrator. A mesh has the id, BSDF and media of the shape that it replaces; as a member of a
    group the id "instance/member". What else is in the group stays instanced.
    Raises ``SceneError`` for boundaries that cannot be replaced.
    """
    shapes, parts, groups = scene.shapes(), [], []
    instances = [shape for shape in shapes if shape.class_name() == "Instance"]
    group_of = {id(instance): group for instance, group in zip(instances, _groups(scene, instances))}
    split = {id(group): _split(group, is_boundary, tolerance) for group in group_of.values()}
    for shape in shapes:
        if id(shape) in group_of:
            boundaries, rest = split[id(group_of[id(shape)])]
            matrix = _matrix(shape) if boundaries else None
            for member, surface in boundaries:
                name = "/".join(filter(None, (shape.id(), member.id())))  # in files they may have none
                parts.append(_mesh(surface.moved(matrix), member, name))
            if rest is not None:
                groups.append(rest)
                parts.append(_instance(shape, rest) if boundaries else shape)
        elif not shape.is_mesh() and is_boundary(shape):
            parts.append(_mesh(_tessellated(shape, tolerance), shape, shape.id()))
        else:
            parts.append(shape)
    if len(parts) == len(shapes) and all(part is shape for part, shape in zip(parts, shapes)):
        return scene
    return _scene(scene, groups, parts)


def _groups(scene, instances):
    """The shape group of each instance."""
    if not instances:
        return []
    nodes = mi.traverse(scene).hierarchy
    groups = [node for node in nodes if node.class_name() == "ShapeGroupPlugin"]
    # An instance tells of its group nothing but its description, and ids need not differ: for a moment they do.
    ids = [group.id() for group in groups]
    try:
        for i, group in enumerate(groups):
            group.set_id(f"refscatter-group-{i}.")
        texts = [str(instance) for instance in instances]
    finally:
        for group, name in zip(groups, ids):
            group.set_id(name)
    return [groups[int(re.findall(r"refscatter-group-(\d+)\.", text)[0])] for text in texts]


def _split(group, is_boundary, tolerance):
    """The boundaries in a group as pairs (shape, ``Surface`` in the group's coordinates), and a group of all other
    members: the same one if there are no boundaries, None if there is nothing else."""
    members = [node for node, (_, depth) in mi.traverse(group).hierarchy.items() if depth == 1]
    boundaries = [member for member in members if is_boundary(member)]
    if not boundaries:
        return [], group
    surfaces = [(m, _mesh_surface(m) if m.is_mesh() else _tessellated(m, tolerance)) for m in boundaries]
    others = [member for member in members if not any(member is boundary for boundary in boundaries)]
    if not others:
        return surfaces, None
    rest = _load("shapegroup", others)
    rest.set_id(group.id())
    return surfaces, rest


def _load(kind, parts, **values):
    """A plugin made of existing objects, which keep their ids: ``mi.load_dict`` gives them those of its keys."""
    ids = [part.id() for part in parts]
    try:
        return mi.load_dict(
            {"type": kind, **values, **{f"part{i}": part for i, part in enumerate(parts)}}, optimize=False
        )
    finally:
        for part, name in zip(parts, ids):
            part.set_id(name)


def _instance(instance, group):
    """An instance of another group in the same place."""
    copy = _load("instance", [group], to_world=mi.ScalarTransform4f(_matrix(instance)))
    copy.set_id(instance.id())
    return copy


def _scene(scene, groups, shapes):
    """The scene with other shapes. ``groups``: those of instances, which Mitsuba finds only as the scene's children."""
    sensors = [sensor.get_shape() or sensor for sensor in scene.sensors()]  # first, which keeps their order
    emitters = [emitter for emitter in scene.emitters() if emitter.get_shape() is None]
    parts = {id(part): part for part in [*groups, *sensors, *shapes, *emitters]}
    return _load("scene", list(parts.values()))


def _matrix(shape):
    """``to_world`` (4, 4), float64."""
    matrix = np.array(mi.traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    if not np.isfinite(matrix).all():
        raise SceneError(f"{name_shape(shape)} has a to_world with numbers that are not finite: correct it")
    columns = np.linalg.norm(matrix[:3, :3], axis=0)
    if not abs(np.linalg.det(matrix[:3, :3])) > tolerances.FLATTENED * columns.prod():
        raise SceneError(
            f"{name_shape(shape)} has a to_world that flattens it: scale it by more than 0 along each axis"
        )
    return matrix


def _mesh(surface, shape, name):
    """``mi.Mesh`` of the id ``name`` in place of a shape, with its BSDF and media."""
    refuse_shining(shape)
    properties = mi.Properties()
    parts = {"bsdf": shape.bsdf(), "interior": shape.interior_medium(), "exterior": shape.exterior_medium()}
    for key, part in parts.items():
        if part is not None:
            properties[key] = part
    properties["face_normals"] = surface.normals is None
    properties.set_id(name)
    mesh = mi.Mesh(
        name, len(surface.vertices), len(surface.faces), props=properties,
        has_vertex_normals=surface.normals is not None, has_vertex_texcoords=surface.texcoords is not None,
    )  # fmt: skip
    parameters = mi.traverse(mesh)
    parameters["faces"] = arrays.array(mi.UInt32, surface.faces.ravel())
    buffers = {"positions": surface.vertices, "normals": surface.normals, "texcoords": surface.texcoords}
    for key, values in buffers.items():
        if values is not None:
            parameters[f"vertex_{key}"] = arrays.array(mi.Float, values.ravel())
    parameters.update()
    return mesh


def _mesh_surface(shape):
    """``Surface`` of a ``mi.Mesh``."""

    def read(buffer, width, kind=np.float64):
        return np.array(buffer, dtype=kind).reshape(-1, width)

    has_normals = shape.has_vertex_normals() and not shape.has_face_normals()
    surface = Surface(  # of its buffers: mi.traverse does not show those of a rectangle
        vertices=read(shape.vertex_positions_buffer(), 3),
        normals=read(shape.vertex_normals_buffer(), 3) if has_normals else None,
        texcoords=read(shape.vertex_texcoords_buffer(), 2) if shape.has_vertex_texcoords() else None,
        faces=read(shape.faces_buffer(), 3, np.int64),
    )
    return surface.flipped() if shape.has_flipped_normals() else surface


def _tessellated(shape, tolerance):
    """``Surface`` of a sphere, cylinder or disk in the coordinates that its ``to_world`` leads to."""
    kind = shape.class_name()
    if kind not in PROBES:
        raise refusal("shape", name_shape(shape), shape=kind.lower())
    matrix = _matrix(shape)
    if kind == "Sphere":
        surface = _sphere(frequency(tolerance))
    elif kind == "Cylinder":
        width, _, length = np.linalg.norm(matrix[:3, :3], axis=0)
        surface = _tube(segments(tolerance), length / width)
    else:
        surface = _disk(segments(tolerance))
    return surface.moved(matrix) if _faces_out(shape, matrix) else surface.moved(matrix).flipped()


_CIRCLE = np.stack([np.cos(np.arange(8.0)), np.sin(np.arange(8.0))], axis=1)
_HEIGHT = np.linspace(-0.9, 0.9, 8)[:, None]
_ON_SPHERE = np.concatenate([_CIRCLE * np.sqrt(1 - _HEIGHT**2), _HEIGHT], axis=1)
_ON_TUBE = np.concatenate([_CIRCLE, 0.5 + 0.5 * _HEIGHT], axis=1)
_ON_DISK = np.concatenate([0.5 * _CIRCLE, 0 * _HEIGHT], axis=1)
PROBES = {
    "Sphere": (_ON_SPHERE, _ON_SPHERE),
    "Cylinder": (_ON_TUBE, _ON_TUBE * (1, 1, 0)),
    "Disk": (_ON_DISK, 0 * _ON_DISK + (0, 0, 1)),
}
"""Class of Mitsuba shapes to points of them and the normals there, in object coordinates."""


def _faces_out(shape, matrix):
    """Whether the renderer's normals of an analytic shape are those of ``PROBES``; refuses one that is elsewhere."""
    points, normals = PROBES[shape.class_name()]
    probe = Surface(points, normals, None, np.zeros((0, 3), dtype=np.int64)).moved(matrix)
    radius = np.linalg.norm(matrix[:3, 0])
    start = probe.vertices + 0.5 * radius * probe.normals
    ray = mi.Ray3f(_vectors(mi.Point3f, start), _vectors(mi.Vector3f, -np.asarray(probe.normals)))
    # Not shape.ray_intersect(ray): Mitsuba 3.9.1 then fails while an instance of a group of several shapes exists.
    si = shape.compute_surface_interaction(ray, shape.ray_intersect_preliminary(ray))
    away = np.linalg.norm(np.array(si.p).T - probe.vertices, axis=1)
    room = tolerances.SURFACE_PLACE * radius + tolerances.SURFACE_ROUNDING * np.abs(probe.vertices).max()
    here = np.array(si.is_valid()) & (away < room)
    cosine = np.einsum("ij,ij->i", np.array(si.n).T, probe.normals)
    if not (here.all() and (np.abs(cosine) > tolerances.SURFACE_NORMAL).all() and np.ptp(np.sign(cosine)) == 0):
        raise refusal("to_world", name_shape(shape), shape=shape.class_name().lower())
    return bool(cosine[0] > 0)


def _vectors(kind, values):
    return kind(*(arrays.array(mi.Float, column) for column in values.T))


def _sphere(f):
    """Unit sphere of 20 f^2 triangles."""

    vertices, faces = geodesic_sphere(f)
    return Surface(vertices, vertices, None, faces)


def _circle(n):
    """n points (n, 2) of the unit circle, the first at angle 0."""
    angle = 2 * np.pi * np.arange(n) / n
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _tube(n, length):
    """Unit tube without ends, 0 <= z <= 1, of n segments. ``length``: of the final tube, in radii."""
    m = np.ceil(length * n / (2 * np.pi * tolerances.TUBE_STRETCH))
    m = int(np.clip(m, 1, tolerances.TUBE_TRIANGLES // (2 * n)))
    vertices = np.empty((m + 1, n, 3))
    vertices[..., :2], vertices[..., 2] = _circle(n), np.arange(m + 1)[:, None] / m
    vertices = vertices.reshape(-1, 3)
    low = np.arange(m * n)
    low_next = np.where(low % n == n - 1, low - n + 1, low + 1)
    faces = np.concatenate(
        [np.stack([low, low_next, low_next + n], axis=1), np.stack([low, low_next + n, low + n], axis=1)]
    )
    return Surface(vertices, vertices * (1, 1, 0), None, faces)


def _disk(n):
    """Unit disk with n = 8 * 2^k edges on its rim: rings with half as many each, apart as far as their vertices are."""
    rings, faces, radius, count, first = [], [], 1.0, n, 0
    while True:
        rings.append(radius * _circle(count))
        i, inner = np.arange(count), first + count
        if count == 8:  # the centre is all that is left
            faces.append(np.stack([first + i, first + (i + 1) % count, 0 * i + inner], axis=1))
            break
        even, odd, after = first + i[::2], first + i[1::2], first + (i[::2] + 2) % count
        p, q = inner + i[: count // 2], inner + (i[: count // 2] + 1) % (count // 2)
        faces += [np.stack(corners, axis=1) for corners in ((p, even, odd), (p, odd, q), (q, odd, after))]
        radius, count, first = radius - 2 * np.pi / n * (n // count), count // 2, inner
    vertices = np.zeros((first + count + 1, 3))
    vertices[:-1, :2] = np.concatenate(rings)
    return Surface(vertices, 0 * vertices + (0, 0, 1), None, np.concatenate(faces))

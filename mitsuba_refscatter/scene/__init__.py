"""What a ``mi.Scene`` holds as plain records: bodies, regions, media and lights; and what is refused.

Nothing else of the renderer reads it. Rays are traced against it elsewhere, too: ``camera``, ``visibility``, ``air`` and ``probing`` do so.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..core.cache import RecordsKey, digest, fingerprint
from ..geometry import mesh as mesh_facts
from . import boundaries as body_reader
from . import emitters as emitter_reader
from . import tessellation
from .boundaries import NONE
from .errors import SceneError, name_edge, name_medium, name_shape
from .regions import Regions
from .support import REFUSED, refusal
from .surfaces import albedos, box, names, shape_number

ONCE = 1 << 16
"""What a boundary counts for that light may go straight through only if it is the only such one: there are no light paths
through several refracting boundaries, straight or not."""


@dataclass
class Scene:
    """All that the integrator needs to know of a scene.

    ``mi_scene``: Mitsuba's, in which every boundary is a mesh of its own; ``records``: the packed triangles of all
    bodies, each in its body's coordinates; ``body_of_shape``, ``eta``, ``first_record``, ``centre``, ``extent``,
    ``inside``, ``outside``: tables for lookups in kernels, as ``index2`` and ``owner`` by region: square of the index of refraction
    relative to the outermost, and the closed body whose inside it is, or NONE; ``thin``, ``straight``: the same where some boundary is, else
    None (``straight``: what crossing it counts for, 1 or ``ONCE``; 0 if light can't); ``passed``: the bodies that light goes straight through;
    ``others``: the shapes that are no bodies; ``mirrors``: largest coordinates of those that are mirrors, or None; ``records_key``: what
    ``records`` were made from; ``geometry``: what tells whether any shape moved or changed its form, or None where that is not known.
    """

    mi_scene: object
    bodies: list
    regions: list
    emitters: list
    records: object
    body_of_shape: object
    eta: object
    first_record: object
    centre: object
    extent: object
    inside: object
    outside: object
    index2: object
    owner: object
    thin: object
    straight: object
    passed: list
    others: list
    mirrors: object
    records_key: RecordsKey
    geometry: tuple

    def find(self, shape):
        """Index of the body of each shape pointer, or NONE; a null pointer is no body."""
        return dr.gather(mi.UInt32, self.body_of_shape, dr.reinterpret_array(mi.UInt32, shape))

    def lights_at(self, o, d):
        """Names of the lights that are points where camera rays (``o``, ``d``: (n, 3)) all come from, seen from some body."""
        points = {
            emitter.name: np.ravel(emitter.place.L)
            for emitter in self.emitters
            if not emitter.drawn and not emitter.place.distant
        }
        ways = [
            np.linalg.norm(np.maximum(0, np.maximum(low - o[0], o[0] - high)))
            for low, high in (b.box for b in self.bodies)
        ]
        near = tolerances.AT_CAMERA * min(ways, default=0)
        return [name for name, L in points.items() if (np.linalg.norm(np.cross(o - L, d), axis=1) < near).all()]

    def through_media(self, body):
        """Whether light comes to a boundary through a medium or straight through other boundaries."""
        outside = self.regions[body.outside] if body.outside != NONE else None
        return self.straight is not None or (outside is not None and outside.medium is not None)

    def near(self, target, leaving, active):
        """Region on the near side of rays that meet the boundaries ``target``, from inside where they are ``leaving``."""
        inside, outside = (dr.gather(mi.UInt32, table, target, active) for table in (self.inside, self.outside))
        return dr.select(leaving, inside, outside)

    def missed_behind(self, region, target, leaving, active):
        """Of rays that meet a boundary from another region than theirs: which have already been in the one on its near side. The
        others come from the inside of a body that touches it, and have missed the boundary of that."""
        owner = self._owner(region, active)
        return active & (leaving | (owner == NONE) | (owner == target))

    def enclosed(self, region):
        """Which regions a closed body ends."""
        return self._owner(region, True) != NONE

    def _owner(self, region, active):
        known = active & (region != NONE)
        return dr.select(known, dr.gather(mi.UInt32, self.owner, region, known), NONE)

    def squared_index(self, region):
        """Square of the index of refraction of regions."""
        known = region != NONE
        return dr.select(known, dr.gather(mi.Float, self.index2, region, known), 1)

    def encloses(self, outer, inner):
        """Whether a body is inside another, directly or in one that is."""
        while inner.outside != NONE and (around := self.regions[inner.outside].body) is not None:
            if around is outer:
                return True
            inner = around
        return False

    def names(self):
        """Names of all shapes by their number."""
        return names(self.mi_scene)

    def box(self):
        """Box around all shapes (low, high), or None where there are none."""
        return box(self.mi_scene)

    def albedos(self):
        """Shares of light that plain surfaces reflect, by the number of a shape (``surfaces.albedos``)."""
        return albedos(self.mi_scene, self.others)

    def mirror_extent(self, shape):
        """The largest coordinate of each shape pointer that is a mirror; 0 where it is none."""
        return dr.gather(mi.Float, self.mirrors, dr.reinterpret_array(mi.UInt32, shape))

    def is_mirror(self, shape):
        """Whether each shape pointer is a mirror."""
        return self.mirror_extent(shape) > 0


def read(scene, tolerance, cache, straight=False):
    """Reads a ``mi.Scene``; ``tolerance``: relative error of the image that replacing curved shapes by meshes may cause;
    ``cache``: ``Cache``; ``straight``: whether light goes straight through all boundaries, as if they were ``null`` (camera rays are refracted all
    the same). Raises ``SceneError`` for what cannot be rendered."""
    scene = tessellation.expand(scene, lambda shape: body_reader.kind_of(shape) is not None, tolerance)
    bodies, others, kinds = [], [], [body_reader.kind_of(shape) for shape in scene.shapes()]
    for shape, kind in zip(scene.shapes(), kinds):
        if kind is None:
            others.append(shape)
        else:
            bodies.append(
                body_reader.read(shape, kind, len(bodies), sum(body.triangle_count for body in bodies), cache)
            )
    regions = Regions(bodies, scene.sensors()).found
    if not any(region.medium is not None for region in regions):
        raise SceneError("the scene has no body with a medium, so there is no scattering to compute: give a mesh a "
                         "<bsdf type=\"dielectric\"/> and a <medium name=\"interior\" type=\"homogeneous\"/>")  # fmt: skip
    emitters = emitter_reader.read(scene, bodies, any(region.scatters for region in regions))
    passed = [body for body in bodies if straight or not body.refracts]
    packed = bodies + _boundaries(bodies, passed, regions, emitters)
    key = RecordsKey(tuple(body.key for body in packed))
    return Scene(
        mi_scene=scene, bodies=bodies, regions=regions, emitters=emitters,
        records=cache.once(lambda: arrays.array(mi.Float, np.concatenate([body.packed() for body in packed] or [np.zeros(24)])), key),
        body_of_shape=_per_shape(scene, mi.UInt32, NONE, {shape_number(body.shape): body.index for body in bodies}),
        **{key: arrays.array(kind, [getattr(body, key) for body in bodies] or [0])
           for key, kind in (("eta", mi.Float), ("first_record", mi.UInt32), ("extent", mi.Float),
                             ("inside", mi.UInt32), ("outside", mi.UInt32))},
        centre=arrays.array(mi.Float, [x for body in bodies for x in body.centre] or [0, 0, 0]),
        index2=arrays.array(mi.Float, np.square(_indices(bodies, regions))),
        owner=arrays.array(mi.UInt32, [NONE if region.body is None else region.body.index for region in regions]),
        thin=_where(body.kind == "thin" for body in bodies),
        straight=arrays.array(mi.UInt32, [(body in passed) * (ONCE if body.refracts else 1) for body in bodies]) if passed else None,
        passed=passed,
        others=others,
        records_key=key,
        geometry=_geometry(key, others),
        mirrors=_per_shape(scene, mi.Float, 0, {shape_number(shape): _extent(shape) for shape in others if _is_mirror(shape)})
        if any(map(_is_mirror, others)) else None,
    )  # fmt: skip


def _where(flags):
    flags = list(flags)
    return arrays.array(mi.Bool, flags) if any(flags) else None


def _indices(bodies, regions):
    """Index of refraction of each region relative to the outermost."""
    index, known = (
        np.ones(len(regions)),
        {NONE} | {r.index for r in regions if not any(b.inside == r.index for b in bodies)},
    )
    while any(body.outside in known and body.inside not in known for body in bodies):
        for body in bodies:
            if body.outside in known and body.inside not in known:
                around = 1.0 if body.outside == NONE else index[body.outside]
                index[body.inside] = around * (body.eta if body.refracts else 1.0)
                known.add(body.inside)
    return index


def _geometry(bodies, others):
    """A tuple that changes with the place and form of shapes, of ``bodies`` by their key; None if there is one of a kind for which that
    is not known."""
    out = [bodies]
    for shape in others:
        kind = shape.class_name()
        if shape.is_mesh():
            out.append(fingerprint(shape.faces_buffer(), shape.vertex_positions_buffer()))
        elif kind in tessellation.PROBES:
            out.append((kind, digest(mi.traverse(shape)["to_world"].matrix)))
        else:
            return None
    return tuple(out)


def parameters(scene):
    """Digest of all that can be changed in a ``mi.Scene``."""
    return digest(*(x for key, value in mi.traverse(scene) for x in (key, getattr(value, "matrix", value))))


def _per_shape(scene, kind, default, values):
    """A table by Mitsuba's number of a shape."""
    table = [default] * (1 + max([shape_number(shape) for shape in scene.shapes()], default=0))
    for shape_id, value in values.items():
        table[shape_id] = value
    return arrays.array(kind, table)


def _extent(shape):
    """Largest coordinate of a shape (world)."""
    box = shape.bbox()
    return max(float(np.abs(np.array(corner)).max()) for corner in (box.min, box.max))


def _is_mirror(shape):
    """Whether a shape does nothing but reflect in one direction."""
    bsdf, flag = shape.bsdf(), mi.BSDFFlags
    if bsdf is None or not mi.has_flag(bsdf.flags(), flag.DeltaReflection):
        return False
    return not any(mi.has_flag(bsdf.flags(), x) for x in (flag.Smooth, flag.Transmission, flag.Null))


def _boundaries(bodies, passed, regions, emitters):
    """Gives regions their refracting boundaries, and sets which of them admit light straight. Returns the bodies whose triangles must be
    packed besides those of ``bodies``: boundaries seen from their other side."""
    turned, next_record = [], sum(body.triangle_count for body in bodies)
    for body in bodies:
        inside, outside = (None if i == NONE else regions[i] for i in (body.inside, body.outside))
        if body in passed:
            for region in (inside, outside):
                if region is not None:
                    region.admits = True
            continue
        if inside is not None and inside.scatters:
            inside.boundaries.append(body if inside.reach is None else body.reaches(inside.reach))
        if outside is not None and outside.scatters and any(_may_be_inside(emitter, body) for emitter in emitters):
            other = body.flipped(next_record)
            next_record += body.triangle_count
            turned.append(other)
            outside.boundaries.append(other.reaches(outside.reach or outside.body.size))
    for body in passed:
        if body.outside != NONE and regions[body.outside].boundaries:
            raise refusal("straight inside", body.name, other=regions[body.outside].boundaries[0].name)
    return turned


def _may_be_inside(emitter, body):
    """Whether light of an emitter may come to a boundary from its inside."""
    if not body.closed:
        return True
    if not emitter.drawn:
        return not emitter.place.distant and holds(body, np.array(emitter.place.L).ravel())
    return emitter.box is not None and all((emitter.box[0] <= body.box[1]) & (emitter.box[1] >= body.box[0]))


def holds(body, point):
    """Whether a closed body holds a point (world)."""
    within = ((point >= body.box[0]) & (point <= body.box[1])).all()
    return bool(within and mesh_facts.encloses(body.corners, np.asarray(point, dtype=np.float64)))


def region_of_camera(scene, medium, origin):
    """Index of the region in which camera rays start (or NONE), from the ``medium`` that the sensor names (or None)
    and an ``origin`` of its rays (3 numbers). Open boundaries do not tell on which side of them it is: what the rays meet
    does (``side_refusal``)."""
    around = [body for body in scene.bodies if body.closed and holds(body, origin)]
    body = min(around, key=lambda body: np.prod(np.subtract(*body.box[::-1])), default=None)
    if body is not None:
        region = scene.regions[body.inside]
        if region.medium != medium:
            raise side_refusal(body, True, region.medium, medium, "is around the camera")
        return region.index
    if medium is None:
        return NONE
    matches = [region for region in scene.regions if region.medium == medium]
    if not matches:
        raise SceneError(
            f"the sensor names {name_medium(medium)}, which no part of the scene has: remove it from the sensor"
        )
    if all(region.body is not None for region in matches):
        raise refusal("sensor outside", matches[0].body.name, medium=name_medium(medium))
    return next(region.index for region in matches if region.body is None)


def side_refusal(body, inside, medium, named, where):
    """The ``SceneError`` for a camera that is on a side of a boundary (``where`` says how that is known) with another ``medium``
    (or None) than the sensor has ``named``."""
    if medium is None:
        side = "interior" if inside else "exterior"
        return refusal("sensor medium", body.name, where=where, named=name_medium(named), side=side)
    instead = "move it to the other side, or turn the surface with flip_normals"
    if body.closed:
        instead = "or move it out" if inside else "or remove that from the shape's exterior"
    names = {"medium": name_medium(medium), "named": name_medium(named)}
    return refusal("camera medium", body.name, where=where, instead=instead, **names)


def hole_refusal(body, medium, share):
    """The ``SceneError`` for an open boundary of which the camera sees the outside, and by a ``share`` of its rays the inside."""
    edges = np.flatnonzero(body.twin < 0)
    edge = name_edge(body.corners, edges[0])
    return refusal("hole", body.name, share=share, medium=name_medium(medium), count=len(edges), edge=edge)


def refuse_gradients(scene):
    """Raises ``SceneError`` where derivatives are asked for; outside of ``dr.suspend_grad``, which hides it."""
    for key, value in mi.traverse(scene):
        if dr.grad_enabled(value):
            raise refusal("gradients", f'the parameter "{key}"')


__all__ = [
    "NONE", "ONCE", "REFUSED", "Scene", "SceneError", "holds", "hole_refusal", "name_shape", "parameters", "read", "refusal",
    "refuse_gradients", "region_of_camera", "side_refusal",
]  # fmt: skip

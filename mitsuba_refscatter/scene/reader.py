"""Reads a ``mi.Scene``, once per render."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..core import arrays
from ..core.arrays import NONE
from ..core.cache import RecordsKey, digest, fingerprint
from . import boundaries as body_reader
from . import emitters as emitter_reader
from . import tessellation
from .boundaries import box_of, boxes_meet, holds
from .errors import SceneError
from .records import ONCE, Scene
from .regions import Regions
from .support import MESHED_MIRRORS, refusal
from .surfaces import shape_number


def read(scene, tolerance, cache, straight=False, surfaces=False):
    """``Scene`` of a ``mi.Scene``. Raises ``SceneError`` for what cannot be rendered.

    tolerance  relative error of the image that replacing curved shapes by meshes may cause
    cache      ``Cache``
    straight   whether light goes straight through all boundaries, as if they were ``null``; camera rays don't
    surfaces   whether surfaces are shown, so that there is something to see without media, too
    """
    scene = tessellation.expand(scene, _becomes_mesh, tolerance)
    bodies, others = _bodies(scene, cache)
    regions = Regions(bodies, scene.sensors()).found
    if not surfaces and not any(region.medium is not None for region in regions):
        raise SceneError(
            "the scene has no body with a medium, so there is no scattering to compute: give a mesh a "
            '<bsdf type="dielectric"/> and a <medium name="interior" type="homogeneous"/>, or set surfaces to true'
        )
    emitters = emitter_reader.read(scene, bodies, any(region.scatters for region in regions))
    passed = [body for body in bodies if straight or not body.refracts]
    turned = _boundaries(bodies, passed, regions, emitters)
    mirrors = _mirrors([shape for shape in others if _is_mirror(shape)], bodies + turned, regions, cache)
    packed = bodies + turned + mirrors
    key = RecordsKey(tuple(body.key for body in packed))
    return Scene(
        mi_scene=scene,
        bodies=bodies,
        mirror_bodies=mirrors,
        regions=regions,
        emitters=emitters,
        records=cache.once(
            lambda: arrays.array(mi.Float, np.concatenate([body.packed() for body in packed] or [np.zeros(24)])), key
        ),
        body_of_shape=_per_shape(scene, mi.UInt32, NONE, {shape_number(body.shape): body.index for body in bodies}),
        **{
            key: arrays.array(kind, [getattr(body, key) for body in bodies] or [0])
            for key, kind in (
                ("eta", mi.Float),
                ("first_record", mi.UInt32),
                ("extent", mi.Float),
                ("inside", mi.UInt32),
                ("outside", mi.UInt32),
            )
        },
        centre=arrays.array(mi.Float, [x for body in bodies for x in body.centre] or [0, 0, 0]),
        index2=arrays.array(mi.Float, np.square(_indices(bodies, regions)) if regions else [1]),
        owner=arrays.array(
            mi.UInt32, [NONE if region.body is None else region.body.index for region in regions] or [NONE]
        ),
        thin=_where(body.kind == "thin" for body in bodies),
        straight=arrays.array(mi.UInt32, [(body in passed) * (ONCE if body.refracts else 1) for body in bodies])
        if passed
        else None,
        passed=passed,
        others=others,
        records_key=key,
        geometry=_geometry(key, others),
        mirrors=_mirror_extents(scene, [shape for shape in others if _is_mirror(shape)]),
    )


def _bodies(scene, cache):
    """``Body`` of every boundary, and the shapes that are none."""
    bodies, others, kinds, count = [], [], [body_reader.kind_of(shape) for shape in scene.shapes()], 0
    for shape, kind in zip(scene.shapes(), kinds):
        if kind is None:
            others.append(shape)
        else:
            bodies.append(body_reader.read(shape, kind, len(bodies), count, cache))
            count += bodies[-1].triangle_count
    return bodies, others


def _becomes_mesh(shape):
    """Whether light is followed at a shape, so that it must be a mesh."""
    return body_reader.kind_of(shape) is not None or (shape.class_name() in MESHED_MIRRORS and _is_mirror(shape))


def _mirrors(shapes, packed, regions, cache):
    """``Body`` of mirrors that are meshes, as the first that light meets; ``packed``: whose triangles come before."""
    found, first_record = [], sum(body.triangle_count for body in packed)
    endless = [region.index for region in regions if region.body is None]
    for shape in shapes:
        if shape.is_mesh():
            body = body_reader.read_mirror(shape, first_record, cache)
            inside = [x for x in packed if x.closed and holds(x, body.corners[0].mean(axis=0))]
            around = min(inside, key=lambda x: np.prod(np.subtract(*x.box[::-1])), default=None)
            body.inside = body.outside = around.inside if around is not None else [*endless, NONE][0]
            found.append(body)
            first_record += body.triangle_count
    return found


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
    """A tuple that changes with the place and form of shapes, of ``bodies`` by their key; None if there is one of
    a kind for which that is not known."""
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


def _per_shape(scene, kind, default, values):
    """A table by Mitsuba's number of a shape."""
    table = [default] * (1 + max([shape_number(shape) for shape in scene.shapes()], default=0))
    for shape_id, value in values.items():
        table[shape_id] = value
    return arrays.array(kind, table)


def _mirror_extents(scene, mirrors):
    """``Scene.mirrors``."""
    extents = {shape_number(shape): _extent(shape) for shape in mirrors}
    return _per_shape(scene, mi.Float, 0, extents) if extents else None


def _extent(shape):
    """Largest coordinate of a shape (world)."""
    return float(np.abs(box_of(shape)).max())


def _is_mirror(shape):
    """Whether a shape does nothing but reflect in one direction."""
    bsdf, flag = shape.bsdf(), mi.BSDFFlags
    if bsdf is None or not mi.has_flag(bsdf.flags(), flag.DeltaReflection):
        return False
    return not any(mi.has_flag(bsdf.flags(), x) for x in (flag.Smooth, flag.Transmission, flag.Null))


def _boundaries(bodies, passed, regions, emitters):
    """Gives regions their refracting boundaries, and sets which of them admit light straight. Returns the bodies
    whose triangles must be packed besides those of ``bodies``: boundaries seen from their other side."""
    turned, next_record = [], sum(body.triangle_count for body in bodies)
    for body in bodies:
        inside, outside = (None if i == NONE else regions[i] for i in (body.inside, body.outside))
        if body in passed:
            for region in (inside, outside):
                if region is not None:
                    region.admits = True
            continue
        if inside is not None and inside.scatters:
            inside.boundaries.append(body if inside.visible_range is None else body.extended(inside.visible_range))
        if outside is not None and outside.scatters and any(_may_be_inside(emitter, body) for emitter in emitters):
            other = body.flipped(next_record)
            next_record += body.triangle_count
            turned.append(other)
            outside.boundaries.append(other.extended(outside.visible_range or outside.body.size))
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
    return emitter.box is not None and boxes_meet(emitter.box, body.box)


def parameters(scene):
    """Digest of all that can be changed in a ``mi.Scene`` but for its sensors."""
    sensors = tuple(f"{sensor.id()}." for sensor in scene.sensors())
    found = ((key, value) for key, value in mi.traverse(scene) if not key.startswith(sensors))
    return digest(*(x for key, value in found for x in (key, getattr(value, "matrix", value))))


def refuse_gradients(scene):
    """Raises ``SceneError`` where derivatives are asked for; outside of ``dr.suspend_grad``, which hides it."""
    for key, value in mi.traverse(scene):
        if dr.grad_enabled(value):
            raise refusal("gradients", f'the parameter "{key}"')

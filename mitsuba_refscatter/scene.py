"""The only reader of ``mi.Scene``: bodies, media and lights as plain records, and what is refused.

Body coordinates are world coordinates minus the body's centre, so that float32 keeps its digits.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from . import lanes
from .geometry import mesh as mesh_facts
from .geometry import triangle

NONE = 0xFFFFFFFF
"""Index of no body."""

DELTA_ONLY = ("SmoothConductor", "ThinDielectric", "Null")
"""BSDFs without any smooth part that are not handled yet."""


class SceneError(RuntimeError):
    """A scene that ``refscatter`` cannot render: names the object, the reason and what to do."""


@dataclass
class Body:
    """A closed triangle mesh with a smooth dielectric boundary.

    ``corners``: float64 (F, 3, 3), world; ``normals``: unit, geometric, outward
    (F, 3); ``twin``: of each directed edge (``mesh.twins``); ``first_record``: of its triangles in ``Scene.records``;
    ``centre``: 3 floats; ``box_low``, ``box_high``: body coordinates; ``size``: diagonal of the box; ``extent``: largest coordinate, world;
    ``medium``: None for a clear body; ``g``: Henyey-Greenstein asymmetry (Float) or None if isotropic.
    """

    name: str
    shape: object
    index: int
    eta: float
    corners: np.ndarray
    normals: np.ndarray
    twin: np.ndarray
    centre: list
    first_record: int
    triangle_count: int
    box_low: list
    box_high: list
    size: float
    extent: float
    convex: bool
    medium: object = None
    g: object = None
    scatters: bool = False

    def coefficients(self, wavelengths):
        """Scattering coefficient and extinction (sigma_s, sigma_t) in 1/length for rays of some wavelengths."""
        if self.medium is None:
            return mi.Spectrum(0), mi.Spectrum(0)
        mei = dr.zeros(mi.MediumInteraction3f)
        mei.wavelengths = wavelengths
        sigma_s, _, sigma_t = self.medium.get_scattering_coefficients(mei, True)
        return sigma_s, sigma_t


@dataclass
class PointLight:
    """A point light outside all bodies; ``position`` in world coordinates (3 floats)."""

    name: str
    index: int
    emitter: object
    position: np.ndarray

    def intensity(self, wavelengths):
        """Radiant intensity, W/sr (and nm in spectral variants)."""
        at = dr.zeros(mi.SurfaceInteraction3f)
        at.p = mi.Point3f([float(x) for x in self.position]) + mi.Vector3f(0, 0, 1)
        at.wavelengths = wavelengths
        sample, value = self.emitter.sample_direction(at, mi.Point2f(0.5), True)
        return value * dr.square(sample.dist)


@dataclass
class Scene:
    """All that the integrator needs to know of a scene.

    ``records``: the packed triangles of all bodies, each in its body's coordinates; ``body_of_shape``,
    ``eta``, ``first_record``, ``centre``, ``extent``: tables for lookups in kernels;
    ``others``: the shapes that are no bodies.
    """

    mi_scene: object
    bodies: list
    lights: list
    records: object
    body_of_shape: object
    eta: object
    first_record: object
    centre: object
    extent: float
    others: list

    def find(self, shape):
        """Index of the body of each shape pointer, or NONE."""
        return dr.gather(mi.UInt32, self.body_of_shape, dr.reinterpret_array(mi.UInt32, shape))


def describe(obj, what, detail=""):
    """How error messages name an object: its id, or where it has none what is known of it."""
    name = obj.id()
    anonymous = not name or name.startswith("_unnamed") or name.startswith("__")
    return f"{what} {detail}" if anonymous and detail else f'{what} "{name}"'


def _name_shape(shape):
    box = shape.bbox()
    centre = ", ".join(f"{x:.4g}" for x in box.center())
    detail = f"at ({centre})"
    if shape.is_mesh():
        detail += f" with {shape.face_count()} triangles"
    if shape.bsdf() is not None:
        detail += f" of material {shape.bsdf().class_name()}"
    return describe(shape, "shape", detail)


def read(scene):
    """Reads a ``mi.Scene``. Raises ``SceneError`` for what cannot be rendered."""
    bodies, others, packed = [], [], []
    for shape in scene.shapes():
        if _is_body(shape):
            body, records = _read_body(shape, len(bodies), sum(body.triangle_count for body in bodies))
            bodies.append(body)
            packed.append(records)
        else:
            others.append(shape)
    if not any(body.medium is not None for body in bodies):
        raise SceneError("the scene has no body with a medium, so there is no scattering to compute: give a closed mesh "
                         "a <bsdf type=\"dielectric\"/> and a <medium name=\"interior\" type=\"homogeneous\"/>")  # fmt: skip
    scatters = any(body.scatters for body in bodies)
    lights = _read_lights(scene, bodies, scatters)
    table = np.full(1 + max(_shape_id(shape) for shape in scene.shapes()), NONE, dtype=np.uint32)
    for body in bodies:
        table[_shape_id(body.shape)] = body.index
    return Scene(
        mi_scene=scene, bodies=bodies, lights=lights, records=lanes.array(mi.Float, np.concatenate(packed)),
        body_of_shape=lanes.array(mi.UInt32, table), eta=lanes.array(mi.Float, [body.eta for body in bodies]),
        first_record=lanes.array(mi.UInt32, [body.first_record for body in bodies]),
        centre=lanes.array(mi.Float, [x for body in bodies for x in body.centre]),
        extent=lanes.array(mi.Float, [body.extent for body in bodies]), others=others,
    )  # fmt: skip


def _shape_id(shape):
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def refuse_gradients(scene):
    """Raises ``SceneError`` where derivatives are asked for; outside of ``dr.suspend_grad``, which hides it."""
    for key, value in mi.traverse(scene):
        if dr.grad_enabled(value):
            raise SceneError(f'gradients are enabled on "{key}": refscatter does not compute derivatives yet; '
                             "call dr.disable_grad on it")  # fmt: skip


def _is_body(shape):
    """Whether the shape is a refractive body; refuses shapes that are neither that nor ordinary surfaces."""
    bsdf, name = shape.bsdf(), _name_shape(shape)
    kind = bsdf.class_name() if bsdf is not None else "none"
    if shape.class_name() in ("Instance", "ShapeGroup"):
        raise SceneError(
            f"{name} is an instance, which refscatter does not support yet: give each copy as a mesh of its own"
        )
    if shape.exterior_medium() is not None:
        raise SceneError(f"{name} has an exterior medium: refscatter computes scattering inside bodies only; remove it")
    if kind in DELTA_ONLY:
        raise SceneError(f"{name} has the BSDF {kind}, which refscatter cannot look through or into yet: "
                         "use dielectric, or a rough or diffuse BSDF for a plain object")  # fmt: skip
    if kind != "SmoothDielectric":
        if shape.interior_medium() is not None:
            raise SceneError(f"{name} has an interior medium but the BSDF {kind}: refscatter needs a smooth, untextured "
                             "dielectric as its boundary")  # fmt: skip
        if any(key.endswith("nested_bsdf.eta") for key in mi.traverse(bsdf).keys()):
            raise SceneError(f"{name} has a dielectric inside the BSDF {kind}: refscatter needs the plain dielectric")
        return False
    if not shape.is_mesh():
        raise SceneError(f"{name} is a {shape.class_name().lower()} with a dielectric BSDF: refscatter needs a triangle mesh; "
                         "use a ply or obj of it")  # fmt: skip
    if shape.is_emitter():
        raise SceneError(
            f"{name} is a dielectric body and an emitter at once: refscatter does not support this; remove the emitter"
        )
    for key, value in mi.traverse(bsdf):
        if key.startswith("specular_") and not _is_one(key, value):
            raise SceneError(
                f"{name} has the BSDF property {key.split('.')[0]} other than 1, which refscatter does not support yet: remove it"
            )
    return True


def _is_one(key, value):
    return key.endswith(".value") and bool(dr.all(dr.ravel(value) == 1))


def _read_body(shape, index, first_record):
    """A ``Body`` and its packed triangles."""
    name = _name_shape(shape)
    vertices, faces, normals = _read_mesh(shape, name)
    corners = vertices[faces]
    topology, twin = faces, mesh_facts.twins(faces)
    if twin is None:  # a seam has several vertices at one position
        topology = mesh_facts.weld(vertices, faces)
        twin = mesh_facts.twins(topology)
    if twin is None:
        raise SceneError(f"{name} has a hole, or triangles that wind inconsistently or share an edge with more than one other: "
                         "refscatter needs a closed surface; close it or make its orientation consistent")  # fmt: skip
    part = mesh_facts.components(topology)
    Ng = _outward(corners, triangle.geometric_normal(corners), part, name)
    eta = _eta(shape.bsdf(), name)
    if normals is None or eta == 1:  # without refraction shading normals play no part
        corner_normals = np.repeat(Ng[:, None, :], 3, axis=1)
    else:
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        agreement = np.bincount(part, np.einsum("fki,fi,f->f", normals[faces], Ng, area))
        corner_normals = normals[faces] * np.sign(agreement)[part][:, None, None]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    centre = np.float64(np.float32(0.5 * (low + high)))
    body = Body(
        name=name, shape=shape, index=index, eta=eta, corners=corners, normals=Ng, twin=twin,
        centre=centre.tolist(), first_record=first_record, triangle_count=len(faces),
        box_low=(low - centre).tolist(), box_high=(high - centre).tolist(),
        size=float(np.linalg.norm(high - low)), extent=float(np.abs(corners).max()), convex=mesh_facts.is_convex(corners, Ng, topology, twin),
    )  # fmt: skip
    _read_medium(body, shape.interior_medium())
    return body, triangle.pack(corners - centre, corner_normals, Ng)


def _outward(corners, normals, part, name):
    """Geometric normals turned outwards, for each connected ``part`` of a mesh by itself.

    A mirrored transform turns the winding: the interior is what the surface encloses, either way.
    """
    signs = np.ones(part.max() + 1)
    for k in range(len(signs)):
        piece = corners[part == k]
        volume = mesh_facts.volume(piece)
        if abs(volume) < 1e-9 * np.ptp(piece.reshape(-1, 3), axis=0).max() ** 3:
            raise SceneError(f"{name} has a part that encloses no volume: remove it or mend the mesh")
        signs[k] = np.sign(volume)
    _refuse_nested_parts(corners, part, name)
    return normals * signs[part][:, None]


def _refuse_nested_parts(corners, part, name):
    """Parts of one mesh (the loader merges shapes of one material) must be apart from each other, too."""
    boxes = [(corners[part == k].min(axis=(0, 1)), corners[part == k].max(axis=(0, 1))) for k in range(part.max() + 1)]
    for i, (low, high) in enumerate(boxes):
        for j in range(len(boxes)):
            if i == j or (boxes[j][0] > high).any() or (boxes[j][1] < low).any():
                continue
            points = corners[part == j].reshape(-1, 3)
            points = points[((points >= low) & (points <= high)).all(axis=1)]
            for point in points[:: max(1, len(points) // 64)]:
                if mesh_facts.encloses(corners[part == i], point):
                    raise SceneError(f"{name} has a part that is inside or overlaps another: refscatter supports bodies apart "
                                     "from each other only; separate them")  # fmt: skip


def _read_mesh(shape, name):
    """Vertices (V, 3), faces (F, 3) and unit normals (V, 3) or None for facet normals; float64, world."""
    parameters = mi.traverse(shape)
    vertices = np.array(parameters["vertex_positions"], dtype=np.float64).reshape(-1, 3)
    faces = np.array(parameters["faces"], dtype=np.int64).reshape(-1, 3)
    if len(faces) == 0:
        raise SceneError(f"{name} has no triangles: remove it or give it some")
    if faces.max() >= len(vertices):
        raise SceneError(f"{name} has a vertex index out of range: the file is damaged")
    used = np.unique(faces)
    if not np.isfinite(vertices[used]).all():
        raise SceneError(f"{name} has vertices that are not finite (NaN or infinite): mend the mesh")
    if not shape.has_vertex_normals():
        return vertices, faces, None
    normals = np.array(parameters["vertex_normals"], dtype=np.float64).reshape(-1, 3)
    length = np.linalg.norm(normals, axis=1)
    if not (length[used] > 1e-6).all():  # also False for NaN
        raise SceneError(f"{name} has vertex normals that are zero or not finite: recompute them, or set face_normals")
    return vertices, faces, normals / np.maximum(length, 1e-6)[:, None]


def _eta(bsdf, name):
    eta = float(mi.traverse(bsdf)["eta"])
    if not (np.isfinite(eta) and eta > 0):
        raise SceneError(f"{name} has the relative index of refraction {eta}: it must be positive")
    return eta


def _read_medium(body, medium):
    if medium is None:
        return
    if medium.class_name() != "HomogeneousMedium":
        raise SceneError(
            f"{body.name} has the interior medium {medium.class_name()}: refscatter needs a homogeneous one"
        )
    phase = medium.phase_function()
    if phase.class_name() == "HGPhaseFunction":
        body.g = dr.opaque(mi.Float, float(dr.ravel(mi.traverse(phase)["g"])[0]))
    elif phase.class_name() != "IsotropicPhaseFunction":
        raise SceneError(
            f"{body.name} has the phase function {phase.class_name()}: refscatter supports isotropic and hg"
        )
    _check_coefficients(body.name, medium, phase)
    body.medium = medium
    parameters = mi.traverse(medium)
    albedo = [value for key, value in parameters if key.startswith("albedo.")]
    body.scatters = not albedo or any(bool(dr.any(dr.ravel(value) != 0)) for value in albedo)


def _check_coefficients(name, medium, phase):
    """Refuses coefficients that vary in space or that no medium has."""
    limits = {"albedo": (0, 1), "sigma_t": (0, np.inf), "scale": (0, np.inf), "phase_function": (-1, 1)}
    for key, value in mi.traverse(medium):
        option = key.split(".")[0]
        if option in ("albedo", "sigma_t") and (key.endswith(".data") or "grid" in key):
            raise SceneError(f"{name} has a medium whose {option} varies in space: refscatter needs a constant one")
        # In spectral variants a colour is stored as coefficients of a spectrum; Mitsuba takes colours in [0, 1] there.
        colour = mi.is_spectral and isinstance(value, mi.Color3f)
        if option in limits and not colour and (key == "scale" or key.endswith((".value", ".values", ".g"))):
            low, high = limits[option]
            x = np.array(dr.ravel(value) if dr.is_array_v(value) else value, dtype=float)
            if not (np.isfinite(x).all() and (x >= low).all() and (x <= high).all()):
                what = "its phase function's g" if option == "phase_function" else f"its medium's {option}"
                allowed = f"in [{low}, {high}]" if np.isfinite(high) else "not negative"
                allowed = "in (-1, 1)" if low < 0 else allowed
                raise SceneError(f"{name} has a bad value of {what}: it must be finite and {allowed}")


def _read_lights(scene, bodies, scatters):
    """The point lights. Other emitters are accepted only where nothing scatters their light."""
    emitters = scene.emitters()
    if not emitters:
        raise SceneError('the scene has no light: add an <emitter type="point"/> outside the body')
    lights = []
    for emitter in emitters:
        kind = emitter.class_name()
        name = describe(emitter, "emitter", f"of type {kind}")
        if emitter.get_shape() is not None:
            name = f"the {kind} emitter of {_name_shape(emitter.get_shape())}"
        if kind != "PointLight":
            if scatters:
                raise SceneError(f"{name} is no point light: refscatter computes the scattering of point lights only; "
                                 "replace it by one or more of them")  # fmt: skip
            continue
        position = np.array(mi.traverse(emitter)["position"], dtype=np.float64).ravel()
        if not np.isfinite(position).all():
            raise SceneError(f"{name} has a position that is not finite: mend it")
        intensity = [x for key, x in mi.traverse(emitter) if key.startswith("intensity") and dr.is_array_v(x)]
        if not all(np.isfinite(np.array(dr.ravel(x))).all() for x in intensity):
            raise SceneError(f"{name} has an intensity that is not finite: correct it")
        for body in bodies:
            if mesh_facts.touches(body.corners, position):
                raise SceneError(
                    f"{name} lies on the boundary of {body.name}: move it out, by more than 1e-6 of the body's size"
                )
            if mesh_facts.encloses(body.corners, position):
                raise SceneError(
                    f"{name} is inside {body.name}: refscatter supports lights outside of bodies only; move it out"
                )
        lights.append(PointLight(name, len(lights), emitter, position))
    return lights

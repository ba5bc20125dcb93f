"""What is wrong with a scene, said in one sentence that names the object."""


class SceneError(RuntimeError):
    """A scene that ``refscatter`` cannot render: names the object, the reason and what to do."""


def describe(obj, what, detail):
    """How error messages name an object: its id, or where it has none what is known of it, ``detail``."""
    name = obj.id()
    anonymous = not name or name.startswith("_unnamed") or name.startswith("__")
    return f"{what} {detail}" if anonymous else f'{what} "{name}"'


def name_medium(medium):
    """How error messages name a medium, or that there is none."""
    return "no medium" if medium is None else describe(medium, "the medium", "without an id")


def name_place(point):
    """How error messages name a point: its three coordinates."""
    return f"({', '.join(f'{x + 0.0:.6g}' for x in point)})"  # + 0.0: no minus before a zero


def name_edge(corners, edge):
    """How error messages name edge ``3 f + k`` of triangles (F, 3, 3): by its ends."""
    triangle, k = divmod(int(edge), 3)
    return f"from {name_place(corners[triangle, k])} to {name_place(corners[triangle, (k + 1) % 3])}"


def name_part(corners):
    """How error messages name a part of a mesh, from its triangles (F, 3, 3)."""
    points = corners.reshape(-1, 3)
    return f"{len(corners)} triangles at {name_place(0.5 * (points.min(axis=0) + points.max(axis=0)))}"


def name_shape(shape):
    """How error messages name a shape: its id, or its place, size and material."""
    box = shape.bbox()
    centre = ", ".join(f"{x:.4g}" for x in box.center())
    detail = f"at ({centre})"
    if shape.is_mesh():
        detail += f" with {shape.face_count()} triangles"
    if shape.bsdf() is not None:
        detail += f" of material {shape.bsdf().class_name()}"
    return describe(shape, "shape", detail)

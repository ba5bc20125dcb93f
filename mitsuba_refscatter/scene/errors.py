"""What is wrong with a scene, said in one sentence that names the object."""


class SceneError(RuntimeError):
    """A scene that ``refscatter`` cannot render: names the object, the reason and what to do."""


def describe(obj, what, detail):
    """How error messages name an object: its id, or where it has none what is known of it, ``detail``."""
    name = obj.id()
    anonymous = not name or name.startswith("_unnamed") or name.startswith("__")
    return f"{what} {detail}" if anonymous else f'{what} "{name}"'


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

"""Bodies and scenes made by code: ``write_scene("bumpy_sphere", "out", triangles=1280)``."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi

from ..core.spelling import advice
from .bodies import Mesh, amber, bumpy_sphere, rounded_cube, sphere
from .branches import branches
from .ply import write_ply
from .studio import STUDIO
from .templates import SCENES
from .water import water

__all__ = [
    "BODIES",
    "SCENES",
    "STUDIO",
    "BodyError",
    "load",
    "make_body",
    "write_ply",
    "write_scene",
]

BODIES = {
    "bumpy_sphere": bumpy_sphere,
    "sphere": sphere,
    "rounded_cube": rounded_cube,
    "branches": branches,
    "amber": amber,
    "underwater": water,
}


class BodyError(ValueError):
    """A body that cannot be made, and why."""


MAX_TRIANGLES = 20_000_000  # indices and memory stay harmless; a typing error does not


def make_body(name: str, triangles: int | None = None) -> Mesh:
    """Return ``(vertices, faces, normals)`` of a body, or raise ``BodyError`` if it can't be made.

    name       one of ``BODIES``
    triangles  wanted; None: as many as the scene's file has

    The arrays are (V, 3), (F, 3) and (V, 3).

    >>> [x.shape for x in make_body("sphere", triangles=100)]
    [(42, 3), (80, 3), (42, 3)]
    """
    if name not in BODIES:
        raise BodyError(f"there is no scene '{name}': {advice(name, BODIES)}")
    wanted = SCENES[name].triangles if triangles is None else triangles
    if not 1 <= wanted <= MAX_TRIANGLES:
        raise BodyError(f"{wanted} triangles asked for: give a number from 1 to {MAX_TRIANGLES}")
    try:
        return BODIES[name](wanted)
    except ValueError as error:
        raise BodyError(str(error)) from error


def write_scene(name: str, directory, triangles: int | None = None) -> tuple[Path, int]:
    """Write ``directory/scene.xml``, its mesh and what else it needs; return the XML's path and the triangle count.

    name       one of ``BODIES``
    directory  made where it isn't there
    triangles  wanted; None: as many as the committed file has

    Raises ``BodyError`` and ``OSError``.
    """
    vertices, faces, normals = make_body(name, triangles)
    directory = Path(directory)
    (directory / "meshes").mkdir(parents=True, exist_ok=True)
    comment = f"{name}, {len(faces)} triangles, written by: refscatter scenes"
    write_ply(directory / "meshes" / f"{name}.ply", vertices, faces, normals, comment)
    for file, content in SCENES[name].files.items():
        (directory / file).write_bytes(content())
    path = directory / "scene.xml"
    path.write_text(SCENES[name].xml(name, len(faces)), encoding="utf-8")
    return path, len(faces)


def load(path, **values) -> mi.Object:
    """Load a scene file with these parameters.

    Its shapes are not merged, as merged ones lose the names that error messages need. It is not loaded in parallel,
    since a film and a reflectance were once not made then, for no reason.
    """
    return mi.load_file(str(path), optimize=False, parallel=False, **values)

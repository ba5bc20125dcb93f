"""Checks PLY files before Mitsuba loads them: a vertex index out of range ends its process."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from ..example_scenes.ply import read_triangles


class MeshError(ValueError):
    """A mesh file that Mitsuba must not be given."""


def check_ply(path: str | Path) -> None:
    """Raise ``MeshError`` if a triangle names a vertex that isn't there; leave all else to Mitsuba."""
    try:
        vertices, faces = read_triangles(path)
    except (OSError, ValueError, KeyError, IndexError, StopIteration):
        return  # missing, truncated or unusual: Mitsuba has its own words for these
    if faces is None or len(faces) == 0:
        return
    bad = np.flatnonzero(((faces < 0) | (faces.astype(np.int64) >= vertices)).any(axis=1))
    if len(bad):
        raise MeshError(
            f"{path}: triangle {bad[0]} names the vertices {', '.join(str(v) for v in faces[bad[0]])} "
            f"and the file has {vertices} (counted from 0): write the mesh anew"
        )


def check_scene(path: str | Path, defines: dict[str, str]) -> None:
    """Check every PLY file that a scene XML names; malformed XML is left to Mitsuba."""
    path = Path(path)
    try:
        root = ET.parse(path).getroot()
    except (OSError, ET.ParseError):
        return
    values = {e.get("name", ""): e.get("value", "") for e in root.iter("default")}
    values.update(defines)
    for shape in root.iter("shape"):
        if shape.get("type") != "ply":
            continue
        for entry in shape.iter("string"):
            if entry.get("name") == "filename":
                name = entry.get("value", "")
                for key in sorted(values, key=len, reverse=True):
                    name = name.replace(f"${key}", values[key])
                check_ply(path.parent / name)

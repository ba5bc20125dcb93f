"""Checks PLY files before Mitsuba loads them: a vertex index out of range ends its process."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Optional

import numpy as np

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip


class MeshError(ValueError):
    """A mesh file that Mitsuba must not be given."""


def _header(data: bytes) -> tuple[str, list, bytes]:
    """Format, elements as [name, count, properties], and what follows the header."""
    head, _, body = data.partition(b"end_header")
    kind, elements = "", []
    for words in (line.split() for line in head.decode("latin-1").splitlines()):
        if words[:1] == ["format"]:
            kind = words[1]
        elif words[:1] == ["element"]:
            elements.append([words[1], int(words[2]), []])
        elif words[:1] == ["property"]:
            elements[-1][2].append(words[1:])
    return kind, elements, body[body.index(b"\n") + 1 :]


def _dtype(properties: list, order: str) -> np.dtype:
    """Row of one element; lists are taken to hold three entries."""
    fields = []
    for i, words in enumerate(properties):
        if words[0] == "list":
            fields += [(f"count{i}", order + _TYPES[words[1]]), (words[3], order + _TYPES[words[2]], 3)]
        else:
            fields.append((words[1], order + _TYPES[words[0]]))
    return np.dtype(fields)


def _triangles(data: bytes) -> tuple[int, Optional[np.ndarray]]:
    """Number of vertices and the triangles of a PLY file, None if there are other faces."""
    kind, elements, body = _header(data)
    vertices = next(count for name, count, _ in elements if name == "vertex")
    if kind == "ascii":
        lines = body.decode("latin-1").splitlines()
        start = sum(count for _, count, _ in elements[: [e[0] for e in elements].index("face")])
        rows = [line.split()[:4] for line in lines[start : start + dict((e[0], e[1]) for e in elements)["face"]]]
        rows = np.array(rows, dtype=np.int64).reshape(-1, 4)
        return vertices, rows[:, 1:] if (rows[:, 0] == 3).all() else None
    order, offset = (">" if "big" in kind else "<"), 0
    for name, count, properties in elements:
        dtype = _dtype(properties, order)
        if name == "face":
            rows = np.frombuffer(body, dtype, count, offset)
            lists = [(f"count{i}", words[3]) for i, words in enumerate(properties) if words[0] == "list"]
            return vertices, rows[lists[0][1]] if all((rows[c] == 3).all() for c, _ in lists) else None
        offset += count * dtype.itemsize
    return vertices, None


def check_ply(path) -> None:
    """Raise ``MeshError`` if a triangle names a vertex that isn't there; leave all else to Mitsuba."""
    try:
        vertices, faces = _triangles(Path(path).read_bytes())
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


def check_scene(path, defines: dict[str, str]) -> None:
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

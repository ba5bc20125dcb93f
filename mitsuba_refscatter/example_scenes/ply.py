"""PLY meshes: written in binary with normals, and the triangles of any file read."""

from __future__ import annotations

from pathlib import Path
from typing import Optional

import numpy as np

_HEADER = """ply
format binary_little_endian 1.0
comment {comment}
element vertex {vertices}
property float x
property float y
property float z
property float nx
property float ny
property float nz
element face {faces}
property list uchar int vertex_indices
end_header
"""

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
"""NumPy's names of the format's types, without the byte order."""


def write_ply(path, vertices, faces, normals, comment: str = "mitsuba_refscatter") -> None:
    """Write a triangle mesh in float32, little endian, whatever the machine.

    path      of the file
    vertices  positions (V, 3)
    faces     indices of vertices (F, 3)
    normals   of vertices, unit (V, 3)
    comment   one line that the header gets
    """
    header = _HEADER.format(comment=comment, vertices=len(vertices), faces=len(faces))
    points = np.concatenate([vertices, normals], axis=1).astype("<f4")
    rows = np.empty(len(faces), dtype=[("n", "u1"), ("index", "<i4", 3)])
    rows["n"], rows["index"] = 3, faces
    Path(path).write_bytes(header.encode("ascii") + points.tobytes() + rows.tobytes())


def read_triangles(path) -> tuple[int, Optional[np.ndarray]]:
    """Number of vertices and triangles (F, 3) of a file, in text or binary.

    The triangles are None if the file has other faces, or no list of them.

    Raises ``OSError``, ``ValueError``, ``KeyError``, ``IndexError`` or ``StopIteration`` for what is no PLY file.
    """
    kind, elements, body = _header(Path(path).read_bytes())
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

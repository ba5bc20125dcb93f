"""Writer of binary PLY meshes with normals."""

from __future__ import annotations

from pathlib import Path

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


def write_ply(path, vertices, faces, normals, comment: str = "mitsuba_refscatter") -> None:
    """Write a triangle mesh in float32, little endian, whatever the machine: vertices and normals (V, 3), faces (F, 3)."""
    header = _HEADER.format(comment=comment, vertices=len(vertices), faces=len(faces))
    points = np.concatenate([vertices, normals], axis=1).astype("<f4")
    rows = np.empty(len(faces), dtype=[("n", "u1"), ("index", "<i4", 3)])
    rows["n"], rows["index"] = 3, faces
    Path(path).write_bytes(header.encode("ascii") + points.tobytes() + rows.tobytes())

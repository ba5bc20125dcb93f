"""A coarse mesh through some of the vertices of a boundary: the first cells of its light beams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import tolerances
from ..geometry import decimation
from ..geometry import mesh as mesh_facts


@dataclass
class Mesh:
    """Triangles with normals at their corners, world coordinates, float64.

    vertices  (V, 3)
    normals   (V, 3), unit, outward
    faces     (F, 3)
    """

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray


def coarsest(body):
    """The coarsest ``Mesh`` that the boundary of a ``Body`` may be found from, along its normals. None where that has
    few triangles, facets instead of normals that are interpolated, or vertices that do not tell neighbours."""
    turn = np.linalg.norm(body.corner_normals[:, 0] - body.corner_normals[:, 1], axis=1)
    steps = np.ceil(np.log2(tolerances.COARSEST_TURN / max(float(np.median(turn)), 1e-30)) / tolerances.COARSER)
    if body.faces is None or body.triangle_count < tolerances.COARSE_FEWEST or steps < 1:
        return None
    winding = np.cross(body.corners[:, 1] - body.corners[:, 0], body.corners[:, 2] - body.corners[:, 0])
    inwards = np.einsum("fi,fi->f", winding, body.normals) < 0
    faces = np.take_along_axis(body.faces, np.where(inwards[:, None], [0, 2, 1], [0, 1, 2]), axis=1)
    twin = mesh_facts.twins(faces)
    if twin is None or (twin == np.arange(len(twin))).any():
        return None
    vertices, normals = (np.zeros((faces.max() + 1, 3)) for _ in range(2))
    vertices[body.faces], normals[body.faces] = body.corners, body.corner_normals
    welded = mesh_facts.weld(vertices, np.arange(len(vertices)))
    longest = tolerances.COARSE_LONGEST * float(np.linalg.norm(body.box[1] - body.box[0]))
    turns, out = tolerances.COARSEST_TURN * 2.0 ** (-tolerances.COARSER * np.arange(steps)), None
    for coarse in decimation.coarser(vertices, normals, faces, twin, turns[::-1], longest):
        if mesh_facts.twins(welded[coarse]) is None:
            break
        out = coarse
    if out is None or len(out) > tolerances.COARSE_WORTH * body.triangle_count:
        return None
    return Mesh(vertices, normals, out)

"""Coarser meshes in place of a body's own, where light that is refracted by them is as good.

A coarse body's corners are some of the fine one's, with their normals. Only what refracts light is replaced: camera rays and
shadow rays meet the body itself.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..geometry import decimation, triangle
from ..geometry import mesh as mesh_facts

FEWEST = 1000
"""Triangles below which a body is taken as it is."""

WORTH = 0.7
"""Share of the triangles that a coarse body may have at most."""

QUARTER = 4
"""Levels from one to that with a quarter of its triangles."""

TURNS = 0.85 * 0.5 ** (np.arange(40) / QUARTER)
"""Largest differences between normals at the ends of a coarse edge, from the coarsest body on."""

FIRST_TURN = 2.0
"""The least of them, relative to that of the fine edges: less is not worth it."""

LONGEST = 0.125
"""Longest coarse edge relative to the body's size."""


@dataclass
class Level:
    """A mesh that may stand for a body's: ``turn`` of the normals along its edges; what it has of its own (fields of ``Body``)."""

    turn: float
    triangles: int
    fields: dict

    def of(self, body):
        return replace(body, **self.fields)


def levels(body, least_turn, most_turn):
    """``Level`` of meshes that stand for that of ``body``, the coarsest one first and its own last. They turn by
    ``least_turn`` to ``most_turn``. Only the last where normals are those of the facets."""
    turn = np.linalg.norm(body.corner_normals[:, 0] - body.corner_normals[:, 1], axis=1)
    least = float(np.median(turn))
    own = [Level(least, body.triangle_count, {})]
    turns = [turn for turn in TURNS[::-1] if max(FIRST_TURN * least, least_turn) <= turn <= most_turn]
    if body.faces is None or body.triangle_count < FEWEST or not turns:
        return own
    winding = np.cross(body.corners[:, 1] - body.corners[:, 0], body.corners[:, 2] - body.corners[:, 0])
    inwards = np.einsum("fi,fi->f", winding, body.normals) < 0
    faces = np.take_along_axis(body.faces, np.where(inwards[:, None], [0, 2, 1], [0, 1, 2]), axis=1)
    twin = mesh_facts.twins(faces)
    if twin is None:
        return own
    vertices, normals = (np.zeros((faces.max() + 1, 3)) for _ in range(2))
    vertices[body.faces], normals[body.faces] = body.corners, body.corner_normals
    for turn, coarse in zip(turns, decimation.coarser(vertices, normals, faces, twin, turns, LONGEST * body.size)):
        twin = mesh_facts.twins(mesh_facts.weld(vertices, coarse))
        if twin is None:
            break
        if len(coarse) <= WORTH * body.triangle_count:
            own.append(Level(turn, len(coarse), _fields(body, coarse, vertices, normals, twin)))
    return own[::-1]


def _fields(body, faces, vertices, normals, twin):
    corners, corner_normals = vertices[faces], normals[faces]
    # How far a circular arc is from its chord, given the turn of its normals: edge x turn / 8; a triangle's middle 4/3 of it.
    edge, turn = (np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2) for x in (corners, corner_normals))
    return {
        "corners": corners, "normals": triangle.geometric_normal(corners), "corner_normals": corner_normals, "twin": twin,
        "first_record": 0, "apart": float((edge * turn).max() / 6), "key": ("coarse", len(faces), *body.key),
    }  # fmt: skip

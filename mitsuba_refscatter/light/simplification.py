"""Coarser meshes in place of a body's own, where light that is refracted by them is as good.

A coarse body's corners are some of the fine one's, with their normals. Its triangles are patches, quadratic,
through the fine body and its normals in the middles of edges as well. Only what refracts light is replaced:
camera rays and shadow rays meet the body itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from ..core.cache import PatchesKey, digest
from ..geometry import decimation, triangle
from ..geometry import mesh as mesh_facts

QUARTER = 4
"""Levels from one to that with a quarter of its triangles."""

TURNS = tolerances.COARSEST_TURN * 0.5 ** (np.arange(tolerances.COARSE_LEVELS) / QUARTER)
"""Largest differences between normals at the ends of a coarse edge, from the coarsest body on."""


@dataclass
class Level:
    """A mesh that may stand for a body's.

    turn       of the normals along its edges, chord on the unit sphere
    triangles  their number
    faces      (F, 3) of ``vertices``, or None where it is the body's own
    twin       (3 F,) of each directed edge
    vertices   (V, 3), world
    normals    (V, 3), unit
    digest     of the faces
    """

    turn: float
    triangles: int
    faces: np.ndarray | None = None
    twin: np.ndarray | None = None
    vertices: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    normals: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    digest: bytes = b""

    def of(self, body, scene, once):
        """``body`` with this mesh, of patches that go through the boundary in the middles of their edges, too.
        ``once``: that of ``Cache``, or of one render."""
        if self.faces is None:
            return body
        fields = once(lambda: self._fields(body, scene), PatchesKey(body.key, self.digest, scene.geometry))
        return replace(body, stands_for=body, **fields)

    def _fields(self, body, scene):
        corners, corner_normals = self.vertices[self.faces], self.normals[self.faces]
        count = len(self.vertices)
        tail, head = self.faces.ravel(), np.roll(self.faces, -1, axis=1).ravel()
        key, numbers = np.unique(mesh_facts.edge_keys(tail, head, count), return_inverse=True)
        ends = np.stack(np.divmod(key, count), axis=1)
        P, n = (x[ends] for x in (self.vertices, self.normals))
        more_P, more_n, _ = _bulge(scene, body, P, n)
        bulge = np.stack([more_P, more_n], axis=1)[numbers.reshape(-1, 3)]
        # A patch is furthest from its boundary near the middle, where the values of its edges' middles count 4/9.
        off, _, seen = _bulge(scene, body, corners, corner_normals)
        axis = corner_normals.mean(axis=1)
        off = np.einsum(
            "fi,fi->f", off - 4 / 9 * bulge[:, :, 0].sum(axis=1), axis / np.linalg.norm(axis, axis=1, keepdims=True)
        )
        apart = float(np.abs(off[seen]).max(initial=0.0))
        return {
            "corners": corners, "normals": triangle.geometric_normal(corners), "corner_normals": corner_normals,
            "twin": self.twin, "first_record": 0, "bulge": bulge.transpose(0, 2, 1, 3),
            "apart": apart, "key": replace(body.key, patches=digest(corners, corner_normals, bulge, apart)),
        }  # fmt: skip


def _bulge(scene, body, P, n):
    """How far a body's boundary and its normal are from the means of points ``P`` (N, k, 3) on it and of their
    normals ``n``, along the mean normal; 0 where it isn't met there; and whether it is."""
    middle, axis = P.mean(axis=1), n.mean(axis=1)
    size = np.linalg.norm(P[:, 0] - P[:, 1], axis=1)
    reach = tolerances.BULGE * size * np.linalg.norm(n - axis[:, None], axis=2).max(axis=1) + tolerances.SLIP * size
    direction = -axis / np.linalg.norm(axis, axis=1, keepdims=True)
    start = middle - reach[:, None] * direction
    at, normal, found = _meet(scene, body, start, direction, 2 * reach)
    missed = np.flatnonzero(~found)
    if len(missed) > 0:  # rays slip through edges
        along = P[missed, 0] - middle[missed]
        aside = start[missed] + tolerances.SLIP * (along + np.cross(along, direction[missed]))
        at[missed], normal[missed], found[missed] = _meet(scene, body, aside, direction[missed], 2 * reach[missed])
    return *(np.where(found[:, None], x, 0.0) for x in (at - middle, normal - axis)), found


def _meet(scene, body, o, d, length):
    """Where rays meet a body's boundary, its normal there against them, and whether they do (NumPy)."""
    origin, direction = ([arrays.array(mi.Float, x) for x in xyz.T] for xyz in (o, d))
    ray = mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))
    ray.maxt = arrays.array(mi.Float, length)
    hit = scene.mi_scene.ray_intersect_preliminary(ray)
    found = hit.is_valid() & (scene.find(hit.shape) == body.index)
    first = dr.opaque(mi.UInt32, scene.bodies[body.index].first_record)
    tri = triangle.gather(scene.records, dr.select(found, first + hit.prim_index, 0), found)
    u, v = hit.prim_uv
    at, normal = tri.position(u, v), tri.normal(u, v)
    normal = dr.select(dr.dot(normal, ray.d) > 0, -normal, normal)
    dr.eval(at, normal, found)
    return at.numpy().T + np.array(body.centre), normal.numpy().T, found.numpy().copy()


def levels(body, least_turn, most_turn):
    """``Level`` of meshes that stand for that of ``body``, the coarsest one first and its own last. They turn by
    ``least_turn`` to ``most_turn``. Only the last where normals are those of the facets."""
    turn = np.linalg.norm(body.corner_normals[:, 0] - body.corner_normals[:, 1], axis=1)
    least = float(np.median(turn))
    own = [Level(least, body.triangle_count)]
    turns = [turn for turn in TURNS[::-1] if max(tolerances.FIRST_TURN * least, least_turn) <= turn <= most_turn]
    if body.faces is None or body.triangle_count < tolerances.COARSE_FEWEST or not turns:
        return own
    winding = np.cross(body.corners[:, 1] - body.corners[:, 0], body.corners[:, 2] - body.corners[:, 0])
    inwards = np.einsum("fi,fi->f", winding, body.normals) < 0
    faces = np.take_along_axis(body.faces, np.where(inwards[:, None], [0, 2, 1], [0, 1, 2]), axis=1)
    twin = mesh_facts.twins(faces)
    if twin is None or (twin == np.arange(len(twin))).any():
        return own
    vertices, normals = (np.zeros((faces.max() + 1, 3)) for _ in range(2))
    vertices[body.faces], normals[body.faces] = body.corners, body.corner_normals
    welded = mesh_facts.weld(vertices, np.arange(len(vertices)))
    longest = tolerances.COARSE_LONGEST * body.size
    for turn, coarse in zip(turns, decimation.coarser(vertices, normals, faces, twin, turns, longest)):
        twin = mesh_facts.twins(welded[coarse])
        if twin is None:
            break
        if len(coarse) <= tolerances.COARSE_WORTH * body.triangle_count:
            own.append(Level(turn, len(coarse), coarse, twin, vertices, normals, digest(coarse)))
    return own[::-1]

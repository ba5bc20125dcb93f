"""Mitsuba scenes for tests, from meshes in memory."""

import mitsuba as mi
import numpy as np
import pytest
from meshes import Mesh

SIGMA_T = (0.4, 0.7, 1.0)
ALBEDO = (0.95, 0.7, 0.25)


def mesh_shape(mesh, path, eta=1.5, sigma_t=SIGMA_T, albedo=ALBEDO, g=None, **extra):
    """Dictionary of a body: ``mesh`` is written to ``path`` (PLY) by Mitsuba. g: of hg, None for isotropic."""
    made = mi.Mesh("body", len(mesh.vertices), len(mesh.faces), has_vertex_normals=mesh.normals is not None)
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = np.asarray(mesh.vertices, np.float32).ravel()
    parameters["faces"] = np.asarray(mesh.faces, np.uint32).ravel()
    if mesh.normals is not None:
        parameters["vertex_normals"] = np.asarray(mesh.normals, np.float32).ravel()
    parameters.update()
    made.write_ply(str(path))
    phase = {"type": "isotropic"} if g is None else {"type": "hg", "g": g}
    return {
        "type": "ply", "filename": str(path), "face_normals": mesh.normals is None,
        "bsdf": {"type": "dielectric", "int_ior": float(eta), "ext_ior": 1.0},
        "interior": {"type": "homogeneous", "phase": phase, "sigma_t": {"type": "rgb", "value": list(sigma_t)},
                     "albedo": {"type": "rgb", "value": list(albedo)}},
        **extra,
    }  # fmt: skip


def point_light(position, intensity=(10.0, 10.0, 10.0)):
    value = {"type": "rgb", "value": [float(x) for x in intensity]}
    return {"type": "point", "position": [float(x) for x in position], "intensity": value}


def single_scattering(scene, o, d, medium=None, seed=0, **options):
    """Radiance (n, 3) that ``refscatter`` (or another ``type``) finds along rays o, d (n, 3), which start in
    ``medium``, without surfaces."""
    integrator = mi.load_dict({"type": "refscatter", "surfaces": False, **options})
    ray = mi.Ray3f(*(x(np.asarray(a, np.float32).T) for x, a in ((mi.Point3f, o), (mi.Vector3f, d))))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, len(o))
    return np.array(integrator.sample(scene, sampler, mi.RayDifferential3f(ray), medium)[0]).T


def rounded(x):
    """Float64 values that float32 holds exactly, so that the oracle sees what Mitsuba sees."""
    return np.asarray(x, np.float32).astype(float)


def rounded_mesh(mesh):
    """The mesh with coordinates that float32 holds exactly."""
    return Mesh(rounded(mesh.vertices), mesh.faces, None if mesh.normals is None else rounded(mesh.normals))


def rays_towards(origin, targets):
    """Rays from ``origin``, (3,) or (n, 3), to targets (n, 3)."""
    d = np.asarray(targets) - np.asarray(origin)
    d = rounded(d / np.linalg.norm(d, axis=1, keepdims=True))
    return rounded(np.broadcast_to(origin, d.shape)), d / np.linalg.norm(d, axis=1, keepdims=True)


def slow_ones(names, slow):
    """Parameters of a test, of which these run in ``make test-all`` alone."""
    return [pytest.param(name, marks=pytest.mark.slow) if name in slow else name for name in names]


def rays_at(origin, radius, n, seed):
    """n rays from ``origin`` to random points of the ball of ``radius`` about 0."""
    rng = np.random.default_rng(seed)
    target = rng.normal(size=(n, 3))
    target *= (radius * rng.random((n, 1)) ** (1 / 3)) / np.linalg.norm(target, axis=1, keepdims=True)
    return rays_towards(origin, target)

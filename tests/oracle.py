"""Ground truth in float64 NumPy: single scattering inside refractive triangle meshes, point lights.

From the formulas of the papers alone (mitsuba_refscatter/README.md); shares no code with the package.
World space, one length unit; sigma_s, sigma_t in 1/length, intensity in W/sr, radiance in W/(m^2 sr).
C colour channels, a scalar counts as C = 1.  Directions are unit vectors.  eta = n_in / n_out; at 1
facet normals hold.
All surfaces on P-L and P-V shadow.  Not modelled: nested bodies, lights inside, light-side bounces.
"""

from collections import namedtuple

import numpy as np
from meshes import (
    BoxTree,
    Mesh,
    bisect,
    dot,
    interface,
    make_patches,
    may_vanish,
    norm,
    quarter,
    take,
    triangle_grid,
    within,
)

GRID_BATCH = 1 << 23  # numbers in one array of values on the micro grid (memory)
ROUGH = 0.05  # relative change of grad g along a chord above which its triangle is split
SPAN = 1 / 256  # the same for the part of a camera segment that one chord sees
COARSE = 1 / 12  # side in (u,v) of the micro triangles above which none is clipped away
MAX_SPLITS = 6  # such splits at most; then the mean slope of the chord's ends stands in
NEGLIGIBLE = 1e-12  # a branch of the camera path that carries less weight is not followed

# A homogeneous medium: sigma_s, sigma_t (C,); g of Henyey-Greenstein.
Medium = namedtuple("Medium", "sigma_s sigma_t g")
# A mesh filled with one.  It has the fields of a Medium and may stand for it.
Body = namedtuple("Body", "mesh eta sigma_s sigma_t g", defaults=(0.0,))


class CameraRays(namedtuple("CameraRays", "o d t_max")):
    """Segments o + t d, 0 < t < t_max, of camera rays: o, d (n,3), t_max (n,)."""

    def take(self, index):
        """Those with the numbers `index`."""
        return CameraRays(*(x[index] for x in self))


def phase(g, cosine):
    """Henyey-Greenstein phase function in 1/sr; cosine = +1 is forward; g = 0 is isotropic."""
    return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cosine) ** 1.5)


# ---- The curve form (mitsuba_refscatter/README.md) ------------------------------------------------------
# Light refracted at (u,v), (...,3) and (...,1): w_l = omega_L, length = |N|, radicand = c_V^2.
LightRay = namedtuple("LightRay", "point n omega w_l length d_l c_l radicand c_v")


def light_ray(patch, uv, light, eta):
    """Snell's law at uv (...,2); under total reflection c_V is held at 0 (callers clip)."""
    u, v = uv[..., :1], uv[..., 1:]
    point = patch.p + u * patch.e1 + v * patch.e2
    normal = patch.n + u * patch.m1 + v * patch.m2
    length, to_light = norm(normal), light - point
    d_l = norm(to_light)
    n, w_l = normal / length, to_light / d_l
    c_l = dot(w_l, n)
    radicand = 1 - (1 - c_l**2) / eta**2
    c_v = np.sqrt(np.maximum(radicand, 0))
    omega = -w_l / eta + n * (c_l / eta - c_v)
    return LightRay(point, n, omega, w_l, length, d_l, c_l, radicand, c_v)


def light_slopes(patch, x, eta):
    """Derivatives of omega in u and in v, (...,3) each, of the LightRay x."""
    slopes = []
    for e, m in ((patch.e1, patch.m1), (patch.e2, patch.m2)):
        dw_l = (x.w_l * dot(x.w_l, e) - e) / x.d_l
        dn = (m - x.n * dot(x.n, m)) / x.length
        dc_l = dot(dw_l, x.n) + dot(x.w_l, dn)
        dc_v = np.where(x.c_v > 0, x.c_l * dc_l / (eta**2 * np.where(x.c_v > 0, x.c_v, 1)), 0)
        slopes.append(-dw_l / eta + dn * (x.c_l / eta - x.c_v) + x.n * (dc_l / eta - dc_v))
    return slopes


def beam_gap(patch, uv, light, eta, o, d):
    """g = (P - o).(d x omega), (n,), and its gradient in (u,v), (n,2), at uv (n,2)."""
    x = light_ray(patch, uv, light, eta)
    across, away = np.cross(d, x.omega), x.point - o
    gradient = [
        dot(e, across) + dot(away, np.cross(d, slope))
        for e, slope in zip((patch.e1, patch.e2), light_slopes(patch, x, eta))
    ]
    return dot(away, across)[:, 0], np.hstack(gradient)


class Beams(namedtuple("Beams", "patch light eta")):
    """A Patch, the point that lights it, and eta: what Snell's law needs to know of light in a body."""

    def take(self, index):
        """Those through the triangles with the numbers `index`."""
        return self._replace(patch=take(self.patch, index))

    def at(self, uv):
        """The `light_ray` at uv."""
        return light_ray(self.patch, uv, self.light, self.eta)

    def gap(self, uv, rays):
        """The `beam_gap` at uv to camera rays."""
        return beam_gap(self.patch, uv, self.light, self.eta, rays.o, rays.d)


def _candidates(uv, radicand, g, g_u, g_v, reach):
    """Whether to look for g = 0 on micro triangles; all but reach are three corners' arrays.

    Beside `may_vanish`: at the critical angle g moves by c_V (P - o).(d x n), c_V^2 = radicand;
    reach bounds the second factor."""
    swing = np.sqrt(np.maximum(np.max(radicand, 0), 0)) * (np.min(radicand, 0) <= 0) * reach
    return may_vanish(uv, g, g_u, g_v) | (np.minimum.reduce([np.abs(x) for x in g]) < swing)


def meeting(x, o, d):
    """t |d x omega|^2, s |d x omega|^2 and |d x omega|^2, (n,1) each, of a LightRay and a line."""
    across, away = np.cross(d, x.omega), x.point - o
    return dot(np.cross(away, x.omega), across), dot(np.cross(away, d), across), dot(across, across)


def _cut(beams, rays, uv, g):
    """Where g = 0 on two edges of micro triangles uv (n,3,2), g (n,3): [uv (n,2), grad g] twice.

    Exact, not interpolated: neighbours that are cut to different depths must agree on it."""
    positive, i, ends = g > 0, np.arange(len(g)), []
    odd = np.argmax(positive == (positive.sum(1) == 1)[:, None], axis=1)  # the lone sign
    for k in ((odd + 1) % 3, (odd + 2) % 3):
        start, edge, value = uv[i, odd], uv[i, k] - uv[i, odd], g[i, odd]
        lo, hi, x = np.zeros(len(g)), np.ones(len(g)), value / (value - g[i, k])
        for _ in range(5):  # Newton, bisection where it leaves the bracket
            gap, gradient = beams.gap(start + x[:, None] * edge, rays)
            before = (gap > 0) == (value > 0)
            lo, hi = np.where(before, x, lo), np.where(before, hi, x)
            slope = (gradient * edge).sum(1)
            newton = x - gap / np.where(slope == 0, 1e-300, slope)
            inside = np.abs(newton - (lo + hi) / 2) < (hi - lo) / 2 + 1e-9
            x = np.where(inside, newton, (lo + hi) / 2)
        ends.append([start + x[:, None] * edge, gradient])
    return ends


def _clip(beams, rays, a, b):
    """Part lo..hi of the chords a..b (n,2) where s, t, t_max - t, both cosines and c_V^2 are > 0;
    hi < 0: none.  Also the share of the segment seen.  s, t times |d x omega|^2 stay smooth."""
    lo, hi, sides, reach = np.zeros((len(a), 1)), np.ones((len(a), 1)), [], []
    t_max = rays.t_max[:, None]
    for uv in (a, b):
        x = beams.at(uv)
        t, s, scale = meeting(x, rays.o, rays.d)
        sides.append((t, s, t_max * scale - t, x.c_l, x.radicand, -dot(x.omega, beams.patch.ng)))
        reach.append(np.clip(t / np.maximum(scale, 1e-300), 0, t_max))
    for start, end in zip(*sides):
        root = start / np.where(start == end, 1, start - end)
        lo = np.where((start <= 0) & (end > 0), np.maximum(lo, root), lo)
        hi = np.where((start > 0) & (end <= 0), np.minimum(hi, root), hi)
        hi = np.where((start <= 0) & (end <= 0), -1, hi)
    return lo, hi, np.abs(reach[1] - reach[0]) / t_max


def _curve(beams, rays, ray, tri, uv, g):
    """Pieces of g = 0: list of (ray (m,), tri (m,), uv (m,2) middle and both ends, dl/|grad g|).

    Starts from micro triangles uv (n,3,2) with g (n,3) at their corners, of the triangles tri (n,)
    of `beams`, for the numbers ray (n,) of `rays`.  Where the curve stays
    in one and grad g changes little, the chord stands for it; else the triangle is quartered."""
    found = []
    for depth in range(MAX_SPLITS + 1):
        cut = (g > 0).any(1) & (g <= 0).any(1)
        rest = [x[~cut] for x in (ray, tri, uv)]
        ray, tri, uv, g = (x[cut] for x in (ray, tri, uv, g))
        beam, camera = beams.take(tri), rays.take(ray)
        (a, slope_a), (b, slope_b) = _cut(beam, camera, uv, g)
        lo, hi, span = _clip(beam, camera, a, b)
        keep = ((hi > 0) | (norm(uv[:, 1] - uv[:, 0]) > COARSE))[:, 0]
        ray, tri, uv, a, b, slope_a, slope_b, lo, hi, span = (
            x[keep] for x in (ray, tri, uv, a, b, slope_a, slope_b, lo, hi, span)
        )
        beam, camera = beams.take(tri), rays.take(ray)
        size, point = norm(uv[:, 1] - uv[:, 0]), a + (lo + hi) / 2 * (b - a)
        for _ in range(2):  # Newton along grad g, not far
            value, gradient = beam.gap(point, camera)
            step = value[:, None] * gradient / np.maximum(dot(gradient, gradient), 1e-300)
            point = point - step * np.minimum(1, size / np.maximum(norm(step), 1e-300))
        inside, point = within(uv, point), np.maximum(point, 0)
        point = point / np.maximum(1, point.sum(1, keepdims=True))
        gradient = beam.gap(point, camera)[1]
        change = norm(slope_b - slope_a) + norm(slope_b + slope_a - 2 * gradient)
        rough = change > ROUGH * norm(gradient)
        slope = np.where(rough, (norm(slope_a) + norm(slope_b)) / 2, norm(gradient))
        weight = norm(b - a) * np.maximum(hi - lo, 0) / slope
        done = inside & ~(rough | (lo > 0) | (hi < 1) | (span > SPAN))[:, 0] | (depth == MAX_SPLITS)
        a, b, some = a + lo * (b - a), a + hi * (b - a), done & (weight > 0)[:, 0]
        found.append([x[some] for x in (ray, tri, point, a, b, weight)])
        rest = [np.concatenate([x[~done], y]) for x, y in zip((ray, tri, uv), rest)]
        if depth < MAX_SPLITS:
            ray, tri, uv, g = _quarter(beams, rays, *rest)
    return found


def _quarter(beams, rays, ray, tri, uv):
    """Cut micro triangles uv (n,3,2) in four; keep those on which g may vanish, with its values."""
    ray, tri, uv = np.tile(ray, 4), np.tile(tri, 4), quarter(uv)
    beam, camera = beams.take(tri), rays.take(ray)
    g, gradient = zip(*[beam.gap(uv[:, k], camera) for k in range(3)])
    corners = [beam.at(uv[:, k]) for k in range(3)]
    reach = np.max([np.abs(dot(x.point - camera.o, np.cross(camera.d, x.n))) for x in corners], 0)[:, 0]
    keep = _candidates(
        uv.swapaxes(0, 1), [x.radicand[:, 0] for x in corners], g, *np.moveaxis(gradient, 2, 0), 1.5 * reach
    )
    return ray[keep], tri[keep], uv[keep], np.stack(g, 1)[keep]


def segment_radiance(body, light, rays, subdivisions=8, occluders=()):
    """Single scattering along camera segments inside a body, (n,C), by the curve form.

    rays: CameraRays, or Segments.  light: its point (3,) and its intensity.  sigma_s and sigma_t of the
    body and intensity: scalars or (C,), the last also a function of directions (m,3), (m,C) or (m,1).
    Lit triangles are cut in subdivisions^2 to begin with.  occluders: more meshes that shadow."""
    (point, intensity), mesh = light, body.mesh
    centre = mesh.corners.reshape(-1, 3).mean(0)  # keeps Pluecker products accurate
    move = [Mesh(m.vertices - centre, m.faces, m.normals) for m in (mesh, *occluders)]
    beams = Beams(make_patches(move[0], body.eta), point - centre, body.eta)
    rays = CameraRays(rays.o - centre, np.asarray(rays.d), np.asarray(rays.t_max))
    colours = [
        x if callable(x) else np.atleast_1d(np.asarray(x, float)) for x in (body.sigma_s, body.sigma_t, intensity)
    ]
    sigma_s, sigma_t, intensity = colours
    tree, medium = BoxTree(move), Medium(sigma_s, sigma_t, body.g)
    total = np.zeros((len(rays.o), max(1 if callable(x) else len(x) for x in colours)))
    for ray, tri, uv, a, b, weight in _curves(beams, rays, subdivisions, 2 * norm(move[0].vertices).max()):
        beam, camera = beams.take(tri), rays.take(ray)
        weight = weight * _lit_share(beam, camera, tri, a, b, tree)
        np.add.at(total, ray, weight * _integrand(beam, camera, uv, medium, intensity))
    return total


def _curves(beams, rays, subdivisions, reach):
    """Pieces of g = 0 on all lit triangles, as `_curve` lists them; reach as in `_candidates`."""
    lit = np.flatnonzero(dot(beams.light - beams.patch.p, beams.patch.ng) > 0)
    (grid, micro), some, found = triangle_grid(subdivisions), beams.take(lit[:, None]), []
    x = some.at(grid)
    lines = [np.concatenate([np.cross(x.omega, x.point), -x.omega], -1)]
    lines += [
        np.concatenate([np.cross(slope, x.point) + np.cross(x.omega, e), -slope], -1)
        for e, slope in zip((some.patch.e1, some.patch.e2), light_slopes(some.patch, x, beams.eta))
    ]
    batch = max(1, GRID_BATCH // max(1, lines[0].size))
    for first in range(0, len(rays.o), batch):  # g, g_u, g_v as 6-D Pluecker products
        camera = np.hstack([rays.d, np.cross(rays.o, rays.d)])[first : first + batch].T
        values = [np.moveaxis(line @ camera, 2, 0) for line in lines]
        radicands = [x.radicand[:, corner, 0] for corner in micro.T]
        corners = ([v[..., corner] for corner in micro.T] for v in values)
        ray, tri, cell = np.nonzero(_candidates(grid[micro.T], radicands, *corners, reach))
        g = values[0][ray[:, None], tri[:, None], micro[cell]]
        found += _curve(beams, rays, ray + first, lit[tri], grid[micro[cell]], g)
    return found


def _lit_share(beams, rays, tri, a, b, tree):
    """Share of the chords a..b (n,2) that nothing shadows, (n,1); one change is bisected."""

    def visible(uv, k):
        x, camera = beams.take(k).at(uv), rays.take(k)
        t, _, scale = meeting(x, camera.o, camera.d)
        v = camera.o + camera.d * np.clip(t / np.maximum(scale, 1e-300), 0, camera.t_max[:, None])
        free = tree.clear(x.point, np.broadcast_to(beams.light, v.shape), tri[k])
        free[free] = tree.clear(x.point[free], v[free], tri[k][free])
        return free

    first, last = (visible(x, np.arange(len(a))) for x in (a, b))
    share, k = (first & last) * 1.0, np.flatnonzero(first != last)
    x = bisect(lambda x: visible(a[k] + x[:, None] * (b - a)[k], k) == first[k], np.zeros(len(k)), np.ones(len(k)), 12)
    share[k] = np.where(first[k], x, 1 - x)
    return share[:, None]


def _integrand(beams, rays, uv, medium, intensity):
    """I T A2 |omega.Ng| / d_L^2 sigma_s p exp(-sigma_t (t + s)), (m,C), at uv (m,2)."""
    x, patch, eta = beams.at(uv), beams.patch, beams.eta
    t, s, scale = meeting(x, rays.o, rays.d)
    t, s = np.clip(t / scale, 0, rays.t_max[:, None]), np.maximum(s / scale, 0)
    c_l, c_v = np.maximum(x.c_l, 0), x.c_v  # below: T = (1 - F) c_L / c_V
    transmitted = 2 * eta * c_l**2 * (1 / (c_l + eta * c_v) ** 2 + 1 / (eta * c_l + c_v) ** 2)
    flux = transmitted * patch.area2 * np.abs(dot(x.omega, patch.ng)) / x.d_l**2
    intensity = intensity(-x.w_l) if callable(intensity) else intensity
    scattered = flux * phase(medium.g, -dot(x.omega, rays.d)) * medium.sigma_s
    value = scattered * intensity * np.exp(-medium.sigma_t * (t + s))
    if not np.isfinite(value).all():
        raise FloatingPointError("non-finite radiance")
    return value


# ---- Camera paths; interior legs: ray, body, t_max (m,); o, d (m,3); weight (m,C) -----------
Segments = namedtuple("Segments", "ray body o d t_max weight")


def camera_segments(bodies, o, d, internal_bounces, opaque=()):
    """Every interior segment that n camera rays (o, d (n,3), outside all bodies) reach.

    A tree that ends where reflections seen from inside, or hits from outside after the first,
    exceed internal_bounces.  weight: product of F, (1 - F) eta^-+2 and the earlier exp(-sigma_t T).
    The shading normal is used for Snell and Fresnel; Ng decides on which side a new ray runs."""
    tree = BoxTree([b.mesh for b in bodies] + list(opaque))
    normals = np.concatenate([b.mesh.corner_normals(b.eta) for b in bodies])
    ng = np.concatenate([b.mesh.facet_normals for b in bodies])
    eta = np.array([b.eta for b in bodies])
    sigma_t = np.stack(np.broadcast_arrays(*[np.atleast_1d(b.sigma_t) for b in bodies]))
    n, segments = len(o), []
    state = [
        np.arange(n),
        np.asarray(o),
        np.asarray(d),
        np.full(n, -1),
        np.full(n, -1),
        np.zeros(n, int),
        np.zeros(n, int),
        np.ones((n, sigma_t.shape[1])),
    ]
    while len(state[0]):
        index, tri, t, u, v = tree.closest(state[1], state[2], state[4])
        ray, o, d, body, _, inner, outer, weight = (x[index] for x in state)
        inside = body >= 0
        segments.append([x[inside] for x in (ray, body, o, d, t[:, 0], weight)])
        weight = np.where(inside[:, None], weight * np.exp(-sigma_t[body] * t), weight)
        hit = np.searchsorted(tree.first, tri, side="right") - 1  # index of the mesh
        on = np.where(inside, hit == body, (hit < len(bodies)) & (outer <= internal_bounces))
        ray, end, d, inside, inner, outer, weight, hit, tri, u, v = (
            x[on] for x in (ray, o + t * d, d, inside, inner, outer, weight, hit, tri, u, v)
        )
        n0, n1, n2 = normals[tri].transpose(1, 0, 2)
        normal = n0 + u * (n1 - n0) + v * (n2 - n0)
        fresnel, reflected, refracted, scale = interface(d, normal / norm(normal), eta[hit, None])
        branches = []
        for direction, factor, bounces in (
            (reflected, fresnel, inner + inside),
            (refracted, (1 - fresnel) * scale, inner),
        ):
            side = np.where(dot(direction, ng[tri])[:, 0] < 0, hit, -1)
            keep = (bounces <= internal_bounces) & ((weight * factor).max(1) > NEGLIGIBLE)
            branches.append(
                [x[keep] for x in (ray, end, direction, side, tri, bounces, outer + ~inside, weight * factor)]
            )
        state = [np.concatenate(x) for x in zip(*branches)]
    return Segments(*(np.concatenate(x) for x in zip(*segments)))


def camera_radiance(bodies, lights, o, d, internal_bounces, subdivisions=8, *, opaque=()):
    """Single scattering that arrives along camera rays o, d (n,3) from outside all bodies, (n,C).

    bodies: list of Body; lights: list of (point (3,), intensity (C,)); opaque: list of Mesh,
    which end paths and cast shadows.  Paths as in `camera_segments`."""
    legs, total = camera_segments(bodies, o, d, internal_bounces, opaque), np.zeros((len(o), 1))
    for k, body in enumerate(bodies):
        mine = Segments(*(x[legs.body == k] for x in legs))
        others = [b.mesh for b in bodies if b is not body] + list(opaque)
        for light in lights:
            value = mine.weight * segment_radiance(body, light, mine, subdivisions, others)
            total = total + np.stack([np.bincount(mine.ray, v, len(o)) for v in value.T], 1)
    return total

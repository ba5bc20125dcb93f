"""Closed forms of single scattering that the oracle and the package are held against; all return (n,C).

medium: an ``oracle.Medium``, for which a ``Body`` may stand.  light, rays: those of ``oracle.segment_radiance``, the
intensity no function.  NumPy float64.
"""

import numpy as np
from meshes import BoxTree, dot, fresnel_reflectance, norm, panels, switches
from oracle import phase


def straight_line_radiance(mesh, medium, light, rays, steps=512):
    """eta = 1: quadrature over t, lit where V -> light crosses the mesh exactly once."""
    tree, total, (source, intensity) = BoxTree([mesh]), [], light

    def crossings(o, d, t):
        point = o + t[:, None] * d
        length = norm(source - point)
        to_light = (source - point) / length
        ray, _, tuv = tree.hits(point, to_light, length[:, 0], np.full(len(t), -1))
        count, depth = np.bincount(ray, minlength=len(t)), np.bincount(ray, tuv[:, 0], len(t))
        return count, depth, length, to_light

    for o, d, edges in zip(rays.o, rays.d, np.multiply.outer(rays.t_max, np.linspace(0, 1, steps + 1))):
        jumps = switches(lambda t: crossings(o, d, t)[0][None], (edges[1:] + edges[:-1]) / 2)
        t, w = panels(np.sort(np.concatenate([edges, jumps])), 3)
        count, depth, length, to_light = crossings(o, d, t)
        value = (w * (count == 1))[:, None] * phase(medium.g, dot(to_light, d)) / length**2
        total.append((value * np.exp(-np.multiply(medium.sigma_t, (t + depth)[:, None]))).sum(0))
    return np.array(total) * medium.sigma_s * intensity


def plane_radiance(eta, medium, light, rays, steps=32):
    """Medium below z = 0, light above: quadrature over t of the point form with the flat D."""
    (source, intensity), d = light, rays.d
    t, w = (rays.t_max[:, None] * x for x in panels(np.linspace(0, 1, steps + 1), 16))
    point = rays.o[:, None] + t[..., None] * d[:, None]
    along, (h_l, h_v) = point[..., :2] - source[:2], (source[2], -point[..., 2])
    rho = norm(along)[..., 0]
    lo, hi = np.zeros_like(rho), rho
    for _ in range(60):  # distance of P from the light's foot
        x = (lo + hi) / 2
        short = x / np.hypot(x, h_l) < eta * (rho - x) / np.hypot(rho - x, h_v)
        lo, hi = np.where(short, x, lo), np.where(short, hi, x)
    d_l, d_v = np.hypot(x, h_l), np.hypot(rho - x, h_v)
    c_l, c_v = h_l / d_l, h_v / d_v
    big_d = (d_v + eta * d_l) * (c_l / c_v * d_v + c_v / c_l * eta * d_l)
    level = (along * d[:, None, :2]).sum(-1) / np.maximum(rho, 1e-300) * (rho - x) / d_v
    w = w * (1 - fresnel_reflectance(c_l, c_v, eta)) * eta**2 / big_d
    w = w * phase(medium.g, c_v * d[:, 2:] - level)
    w = w[..., None] * np.exp(-np.multiply(medium.sigma_t, (t + d_v)[..., None]))
    return w.sum(1) * medium.sigma_s * intensity


def sphere_radiance(radius, eta, medium, light, rays, scan=20001):
    """Exact sphere about the origin: quadrature over phi, the angle at the centre from light to P.

    Its light is a cone about that axis, a quadratic in t; nodes crowd where roots begin or end."""
    source, intensity = light
    far = np.linalg.norm(source)
    axis, phi_max, total = np.asarray(source) / far, np.arccos(radius / far), []

    @np.errstate(divide="ignore", invalid="ignore")  # lanes without a root are masked
    def roots(phi, o, d, t_max):
        """Whether light of phi (m,) meets the line, t + s, dL/dphi / (sigma_s I): (2,m) each."""
        sine, cosine = np.sin(phi), np.cos(phi)
        d_l = np.hypot(radius * sine, far - radius * cosine)
        c_l = (far * cosine - radius) / d_l
        radicand = 1 - (1 - c_l**2) / eta**2
        c_v = np.sqrt(np.maximum(radicand, 0))
        bend = c_l / eta - c_v
        w_r = radius * sine / (eta * d_l) + bend * sine
        w_z = (radius * cosine - far) / (eta * d_l) + bend * cosine
        alpha, beta = radius * sine * w_z + (o @ axis - radius * cosine) * w_r, d @ axis * w_r
        a = beta**2 - w_z**2 * (1 - (d @ axis) ** 2)  # (alpha + beta t)^2 = (w_z rho(t))^2
        b = alpha * beta - w_z**2 * (o @ d - (o @ axis) * (d @ axis))
        c = alpha**2 - w_z**2 * (o @ o - (o @ axis) ** 2)
        q = -(b + np.where(b > 0, 1, -1) * np.sqrt(np.maximum(b * b - a * c, 0)))
        t = np.stack([q / a, c / q])
        point = o + t[..., None] * d
        z = point @ axis
        s = (z - radius * cosine) / w_z
        real = (b * b > a * c) & (radicand > 0) & (t > 0) & (t < t_max) & (s > 0)
        outward = (point - z[..., None] * axis) / ((alpha + beta * t) / w_z)[..., None]
        omega = w_r[:, None] * outward + w_z[:, None] * axis
        volume = np.abs(dot(np.cross(omega, np.cross(axis, point)), d)[..., 0])  # axis x V: dV/dpsi
        flux = c_l * (1 - fresnel_reflectance(c_l, c_v, eta)) * radius**2 * sine / d_l**2
        value = flux * phase(medium.g, -(omega @ d)) / volume
        return real, np.where(real, t + s, 0), np.where(real, value, 0)

    for line in zip(rays.o, rays.d, rays.t_max):
        phi = phi_max * (np.arange(scan) + 0.5) / scan
        ends = np.concatenate([[0], switches(lambda x: roots(x, *line)[0], phi), [phi_max]])
        x, w = panels(np.linspace(-1, 1, 17), 12)
        half = np.diff(ends)[:, None] / 2
        phi = (ends[:-1, None] + half * (1 + np.sin(np.pi / 2 * x))).ravel()
        w = (half * np.pi / 2 * np.cos(np.pi / 2 * x) * w).ravel()
        _, path, value = roots(phi, *line)
        path = np.exp(-np.multiply(medium.sigma_t, path[..., None]))
        total.append(((w * value)[..., None] * path).sum((0, 1)))
    return np.array(total) * medium.sigma_s * intensity


def airlight_radiance(medium, light, rays, steps=200):
    """Light and camera in the medium: quadrature over the angle phi at the light, from the ray's foot to V."""
    source, intensity = light
    to_light = source - rays.o
    x0 = (to_light * rays.d).sum(-1, keepdims=True)
    h = norm(to_light - x0 * rays.d)
    first, last = np.arctan(-x0 / h), np.arctan((rays.t_max[:, None] - x0) / h)
    x, w = panels(np.linspace(0, 1, steps + 1), 16)
    phi = first + (last - first) * x
    path = x0 + h * np.tan(phi) + h / np.cos(phi)  # from the camera to V and from V to the light
    value = (w * phase(medium.g, -np.sin(phi)))[..., None] * np.exp(-np.multiply(medium.sigma_t, path[..., None]))
    return value.sum(1) * (last - first) / h * medium.sigma_s * intensity

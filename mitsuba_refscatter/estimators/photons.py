"""Photons in place of solving: points where light scatters, or beams along its whole way in the medium.

A photon enters a body at P with uniform density in (u, v) of a triangle, which is chosen with probability p. It stands
for the flux that enters there, in the same measure as in ``estimators.curve``,

    flux = I T A2 |omega . Ng| / (2 p N d_L^2),

and both estimates replace the condition that it meets the camera ray by a blur of constant density and radius r. For
points that is over the disk across the camera ray (Jarosz, Zwicker and Jensen 2008, beam radiance estimate). For beams
it is over the shortest distance between the two lines (Jarosz et al. 2011, equation 38, one-dimensional blur):

    L += flux sigma_s p(omega, d) exp(-sigma_t (t + s)) / (pi r^2 pdf(s))   or   / (2 r |d x omega|).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import optics, tolerances
from ..core import arrays
from ..geometry import bvh, triangle
from ..scene.boundaries import Body

RECORD = 12
"""Numbers of a photon: position, omega, start and end of the part of a beam (distances behind P), flux, and padding."""

NODE = 8
"""Numbers of a node of the tree: its box and padding."""


def radius_of(first, number, alpha, mode):
    """Radius of the blur in a pass, in units of the scene.

    first   float, that in the first pass
    number  int, of the pass, from 0
    alpha   float, 0 to 1: how slowly it shrinks
    mode    "points" or "beams"

    (i + alpha) / (i + 1) is r_i+1^2 / r_i^2 for points (Knaus and Zwicker 2011, equation 15), and r_i+1 / r_i for beams
    (Jarosz et al. 2011, Progressive Photon Beams, equation 18).
    """
    i = np.arange(1, number + 1)
    shrunk = float(np.prod((i + alpha) / (i + 1)))
    return first * (shrunk**0.5 if mode == "points" else shrunk)


@dataclass
class Target:
    """How photons of a light are shared out to the triangles of a boundary.

    body       ``scene.boundaries.Body``, whose boundary it is
    records    the packed triangles of this body and others
    triangles  distribution over the body's triangles
    flux       about what all photons bring together, in W
    """

    body: Body
    records: mi.Float
    triangles: mi.DiscreteDistribution
    flux: float

    def choose(self, u):
        """Triangles for random numbers u (Float in [0, 1)), and the probability of each."""
        index, p = self.triangles.sample_pmf(u)
        return triangle.gather(self.records, index + dr.opaque(mi.UInt32, self.body.first_record)), p


def aim(body, records, pilots, exact):
    """The ``Target`` that a boundary is to a light; None if it lights none of it.

    body     ``scene.boundaries.Body``
    records  the packed triangles of this body and others
    pilots   list of ``(Illumination, intensity)`` of one light point each
    exact    whether the one of them is all of the light

    Where it is not, or where it does not send the same into all directions, triangles on which pilots find nothing get
    some photons all the same.
    """
    index = dr.opaque(mi.UInt32, body.first_record) + dr.arange(mi.UInt32, body.triangle_count)
    tri = triangle.gather(records, index)
    area, weight = dr.norm(dr.cross(tri.P_u, tri.P_v)), dr.zeros(mi.Float, body.triangle_count)
    for illumination, intensity in pilots:
        for u, v in ((1 / 3, 1 / 3), (0, 0), (1, 0), (0, 1)):
            P = tri.position(mi.Float(u), mi.Float(v))
            omega_L, d_L = illumination.light.seen_from(P)
            arriving = dr.max(mi.Spectrum(intensity * illumination.emitted(P, omega_L, d_L))) / dr.square(d_L)
            found = area * dr.maximum(dr.dot(omega_L, tri.Ng), 0) * arriving
            weight += dr.select(dr.isfinite(found), found, 0)
        dr.eval(weight)
    total, exact = dr.sum(weight)[0], exact and pilots[0][0].emission is None
    if total == 0 and exact:
        return None
    if not exact:
        weight += tolerances.UNAIMED * (area / dr.sum(area)) * dr.maximum(dr.sum(weight), 1e-30)
    return Target(body, records, mi.DiscreteDistribution(weight), float(dr.sum(weight)[0]) / len(pilots))


@dataclass
class Photons:
    """Photons where they come through a boundary, body coordinates.

    P      Point3f
    Ng     Vector3f, unit normal of the facet
    omega  Vector3f, unit direction inside
    flux   Spectrum, in W
    """

    P: mi.Point3f
    Ng: mi.Vector3f
    omega: mi.Vector3f
    flux: mi.Spectrum

    def gather(self, index):
        """Those at ``index`` (UInt32)."""
        return arrays.gather_record(self, index)


def shoot(target, count, illumination, intensity, sampler):
    """``Photons`` of a light, those that come in, of ``count`` that are sent; None if there are none.

    target        ``Target``
    count         int
    illumination  ``light.illumination.Illumination``, its light one point or one for each photon
    intensity     Spectrum, of these points
    sampler       Mitsuba's, of ``count`` lanes
    """
    lane, n = dr.arange(mi.UInt32, count), dr.opaque(mi.Float, count)
    tri, p = target.choose((mi.Float(lane) + sampler.next_1d()) / n)
    uv = mi.warp.square_to_uniform_triangle(sampler.next_2d())
    P, light = tri.position(uv.x, uv.y), illumination.light
    omega_L, d_L = light.seen_from(P)
    omega, c_L, c_V = optics.refract_in(omega_L, tri.normal(uv.x, uv.y), illumination.eta)
    comes = (c_L > 0) & (c_V > 0) & (dr.dot(omega_L, tri.Ng) > 0) & (dr.dot(omega, tri.Ng) < 0)
    if illumination.lit is not None:
        comes &= illumination.lit(P, tri.Ng, light.L, comes)
    flux = intensity * illumination.emitted(P, omega_L, d_L) * optics.transmission(c_L, c_V, illumination.eta)
    flux *= dr.norm(dr.cross(tri.P_u, tri.P_v)) * dr.abs(dr.dot(omega, tri.Ng)) / (2 * p * n * dr.square(d_L))
    flux = mi.Spectrum(flux)
    inside = dr.compress(comes & (dr.max(flux) > 0))
    return None if dr.width(inside) == 0 else Photons(P, tri.Ng, omega, flux).gather(inside)


@dataclass
class Blur:
    """What stands in place of the condition that a photon meets the camera ray.

    beams   whether photons are beams along their whole way, or else the points where they scatter
    radius  of constant density up to there, in units of the scene
    """

    beams: bool
    radius: float


@dataclass
class Cloud:
    """Photons in a tree, body coordinates.

    blur     of each of them
    records  Float, flat, ``RECORD`` numbers each
    count    how many there are
    tree     over their boxes
    """

    blur: Blur
    records: mi.Float
    count: int
    tree: bvh.Tree

    def node_test(self, segments):
        """Whether camera segments (``LocalSegments``) meet the box of a node, for ``bvh.traverse``."""
        inverse_d = segments.inverse_d

        def hit(x):
            a, b = ((mi.Vector3f(x[3 * i : 3 * i + 3]) - segments.o) * inverse_d for i in range(2))
            return (dr.min(dr.maximum(a, b)) >= dr.maximum(dr.max(dr.minimum(a, b)), 0)) & (
                dr.max(dr.minimum(a, b)) <= segments.t_max
            )

        return hit

    def add(self, value, segments, segment, leaf, phase, directed):
        """Adds what the photons in leaves scatter along camera segments, pair by pair.

        value     Spectrum, per segment: radiance per sigma_s
        segments  ``LocalSegments``
        segment   UInt32, index of each pair's segment
        leaf      UInt32, leaf of each pair
        phase     phase function (omega, d), 1/sr
        directed  extinction (omega, d) along omega relative to that along d, or None where it is the same
        """
        few, sigma_t = segments.gather(segment), segments.sigma_t_of(segment)
        count, total = dr.opaque(mi.UInt32, self.count), mi.Spectrum(0)
        for j in range(bvh.LEAF):
            place = leaf * bvh.LEAF + j
            there = place < count
            photon = triangle.gather_numbers(self.records, place, RECORD, there)
            total += dr.select(there, self._scattered(photon, few, sigma_t, phase, directed), 0)
        dr.scatter_add(value, total, segment, dr.max(total) > 0)
        dr.eval(value)

    def _scattered(self, photon, segments, sigma_t, phase, directed):
        """What one photon scatters along each segment."""
        P, omega, start, end = mi.Vector3f(photon[0:3]), mi.Vector3f(photon[3:6]), photon[6], photon[7]
        flux = mi.Spectrum(photon[8 : 8 + dr.size_v(mi.Spectrum)])
        to_P, d, radius = P - segments.o, segments.d, dr.opaque(mi.Float, self.blur.radius)
        if self.blur.beams:
            across = dr.cross(d, omega)
            sin2 = dr.squared_norm(across)
            t, s = (dr.dot(dr.cross(to_P, x), across) / sin2 for x in (omega, d))
            inside = (dr.square(dr.dot(to_P, across)) < dr.square(radius) * sin2) & (s >= start) & (s < end)
            density = dr.rcp(2 * radius) * dr.rsqrt(sin2)
            depth = sigma_t * t + (sigma_t if directed is None else sigma_t * directed(omega, d)) * s
        else:
            t = dr.dot(to_P, d)
            inside = dr.squared_norm(to_P - t * d) < dr.square(radius)
            density, depth = dr.inv_pi * dr.rcp(dr.square(radius)), sigma_t * t
        inside &= (t > 0) & (t < segments.t_max)
        return dr.select(inside, flux * phase(omega, d) * density * dr.exp(-depth), 0)


def store(photons, lengths, sigma_t, blur, body, sampler):
    """``Cloud`` of ``Photons``.

    photons  ``Photons``
    lengths  Float, how far each goes in the body
    sigma_t  Spectrum, its extinction in 1/length
    blur     ``Blur``
    body     ``scene.boundaries.Body`` that they are in
    sampler  Mitsuba's, as wide as the photons
    """
    P, omega, flux, start, end = photons.P, photons.omega, photons.flux, mi.Float(0), lengths
    if blur.beams:
        step = body.size / tolerances.BEAM_PARTS
        parent, number = arrays.repeat(np.maximum(1, np.ceil(lengths.numpy() / step)).astype(np.int64))
        P, omega, flux, end = (dr.gather(type(x), x, parent) for x in (P, omega, flux, end))
        start = mi.Float(number) * dr.opaque(mi.Float, step)
        end = dr.minimum(end, start + dr.opaque(mi.Float, step))
    else:
        # Distances as the mean of the colours is attenuated, to the end of the way at most.
        mean = dr.maximum(dr.mean(sigma_t), 1e-30)
        depth = dr.maximum(mean * lengths, tolerances.PHOTON_THIN)
        absorbed = 1 - dr.exp(-depth)
        s = -dr.log(1 - sampler.next_1d() * absorbed) * lengths / depth
        pdf = depth / lengths * dr.exp(-depth * s / lengths) / absorbed
        P, flux = P + s * omega, flux * dr.exp(-sigma_t * s) / pdf
        end = mi.Float(0)
    count = dr.width(P)
    dr.eval(P, omega, flux, start, end)
    middle = P if not blur.beams else P + 0.5 * (start + end) * omega
    order = arrays.array(mi.UInt32, bvh.morton_order(middle.numpy().T))
    numbers = [*P, *omega, start, end, *flux]
    numbers = [dr.gather(mi.Float, x + dr.zeros(mi.Float, count), order) for x in numbers]
    records = dr.empty(mi.Float, count * RECORD)
    numbers += [mi.Float(0)] * (RECORD - len(numbers))
    triangle.scatter_numbers(records, numbers, dr.arange(mi.UInt32, count))
    dr.eval(records)
    return Cloud(blur, records, count, _tree(records, count, blur.radius))


def _tree(records, count, radius):
    """The tree over boxes around photons, ``radius`` wider."""
    depth = bvh.depth_for(count)
    leaf, bounds = dr.arange(mi.UInt32, 1 << depth), None
    last, wide = dr.opaque(mi.UInt32, count - 1), dr.opaque(mi.Float, radius)
    for j in range(bvh.LEAF):
        x = triangle.gather_numbers(records, dr.minimum(leaf * bvh.LEAF + j, last), RECORD)
        P, omega = mi.Vector3f(x[0:3]), mi.Vector3f(x[3:6])
        low, high = bvh.box([P + x[6] * omega, P + x[7] * omega])
        bounds = (low - wide, high + wide) if bounds is None else _merge(bounds, (low - wide, high + wide))
    return bvh.fold(bounds, depth, _merge, lambda b: [*b[0], *b[1], mi.Float(0), mi.Float(0)], NODE)


def _merge(a, b):
    return dr.minimum(a[0], b[0]), dr.maximum(a[1], b[1])

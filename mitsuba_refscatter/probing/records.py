"""What a probe holds, as NumPy arrays in float64.

Radiance is that which arrives at the camera, without the sensor's own weight. It is in W/(m^2 sr) for lights in W/sr,
with the scene's unit for m. Radiance per unit length is that divided by the scene's unit. C is the number of the
variant's channels: 3 (linear rgb) or 1 (mono). Distances are along the probed segment, from 0 to its length, in the
scene's unit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class Segment:
    """A part of the camera ray in one region.

    origin     (3,), world
    direction  (3,), world, unit
    length     in the scene's unit
    weight     (C,), by which radiance at the origin counts at the camera: Fresnel factors, indices of refraction,
               attenuation
    region     its name
    """

    origin: np.ndarray
    direction: np.ndarray
    length: float
    weight: np.ndarray
    region: str


@dataclass
class Light:
    """A light that is one point or one direction.

    name      as messages call it
    position  (3,), world; the unit direction to the light if it is distant
    distant   whether it is infinitely far away
    """

    name: str
    position: np.ndarray
    distant: bool


@dataclass
class Boundary:
    """A refracting boundary of the segment's region.

    name     as messages call it
    corners  (F, 3, 3), of its triangles, world
    """

    name: str
    corners: np.ndarray


@dataclass
class PointSamples:
    """What the estimator ``point`` samples: M points.

    light     (M,), number of the light that a sample is of
    distance  (M,)
    radiance  (M, C), per unit length, that the estimator finds there of this light, refracted
    estimate  (C,), its result for all lights
    """

    light: np.ndarray
    distance: np.ndarray
    radiance: np.ndarray
    estimate: np.ndarray


@dataclass
class Curve:
    """The curve on the boundaries from which light is refracted onto the segment, in n cells inside one triangle each.

    Of a cell there are three points: its two ends and, between them, its middle.

    light      (n,), number of the light
    boundary   (n,), number of the boundary
    triangle   (n,), number of the triangle in its boundary
    position   (n, 3, 3), of the three points, world
    distance   (n, 3), where their light meets the segment
    radiance   (n, 3, C), per unit length there; inf at a fold
    integral   (n, C), radiance that the cell brings
    fold       (n,), distance at which the curve turns back in the cell; NaN where it doesn't

    At a fold two branches of one triangle meet, and its radiance per unit length has a pole.
    """

    light: np.ndarray
    boundary: np.ndarray
    triangle: np.ndarray
    position: np.ndarray
    distance: np.ndarray
    radiance: np.ndarray
    integral: np.ndarray
    fold: np.ndarray


@dataclass
class Triangles:
    """The M triangles that send light onto the segment, by light and boundary.

    light     (M,), number of the light
    boundary  (M,), number of the boundary
    triangle  (M,), number of the triangle in its boundary
    x_min     (M,), where the interval of distances begins that it lights (Holzschuch 2015)
    x_max     (M,), where that ends
    integral  (M, C), radiance that it brings
    of        (n,), number among these of the triangle of each cell of the ``Curve``
    """

    light: np.ndarray
    boundary: np.ndarray
    triangle: np.ndarray
    x_min: np.ndarray
    x_max: np.ndarray
    integral: np.ndarray
    of: np.ndarray


@dataclass
class LightCells:
    """The n light beams of one light in one boundary, as cells of it.

    light     name
    boundary  name
    nodes     (n, 6, 3), corners and middles of the edges 01, 12, 20, world
    flux      (n,), of a light of intensity 1
    estimate  relative L1 error of the image that they expect
    """

    light: str
    boundary: str
    nodes: np.ndarray
    flux: np.ndarray
    estimate: float


@dataclass
class Probe:
    """Single scattering along one segment of a camera ray.

    pixel       (x, y), from the upper left corner
    camera      (2, 3), where the ray starts and where it first meets a surface, world
    segments    all of the ray in regions that scatter, the one with the largest weight first
    segment     number of the one that all that follows is about
    distance    (N,), middles of N equal parts of it
    radiance    (N, C), per unit length, mean over each part
    straight    (N, C), how much of it is by light that is not refracted
    integral    (C,), radiance of the whole segment
    estimated   (C,), the same as the estimator ``curve`` finds it
    unresolved  share of the integral where the linear light beam stood in for the curve
    peaks       (K,), distances of maxima of the luminance that stand out by ``tolerances.PEAK`` of the largest
    curve       the light paths, in parts
    triangles   the same by triangles
    samples     of the estimator ``point``
    lights      those that are summed
    left_out    names of lights that are not one point or direction, and not summed
    boundaries  of the segment's region
    beams       ``LightCells`` of the lights, at the probe's tolerance; none at 0
    """

    pixel: tuple[int, int]
    camera: np.ndarray
    segments: list[Segment]
    segment: int
    distance: np.ndarray
    radiance: np.ndarray
    straight: np.ndarray
    integral: np.ndarray
    estimated: np.ndarray
    unresolved: float
    peaks: np.ndarray
    curve: Curve
    triangles: Triangles
    samples: PointSamples
    lights: list[Light]
    left_out: list[str]
    boundaries: list[Boundary]
    beams: list[LightCells]

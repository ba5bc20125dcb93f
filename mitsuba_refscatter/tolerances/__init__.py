"""Every threshold of what renders: its name, unit and reason.

``meshes`` has those of boundaries, ``cells`` those of cells of light, ``accuracy`` what the option ``tolerance``
selects; all are names of this package.

No other module of the renderer holds one, but 1e-30 for a divisor that must not be 0. Options stand in ``options.py``.
Tools (``benchmarks``, ``probing`` and others) name their own settings at the head of their modules.
``tests/test_thresholds_have_one_home.py`` holds this.
"""

from .accuracy import MAX_PAIR_SUBDIVISION, Accuracy, accuracy, levels, parts_along
from .cells import *
from .meshes import *

SHADOW_OFFSET = 2e-6
"""Relative to the body's largest coordinate: how far shadow rays start off the surface. float32 rounds
positions to 6e-8 of them and an intersection loses a few times that."""

SHADOW_END = 1e-4
"""Relative to its length: what a shadow ray leaves out at its end, where V may lie on the boundary."""

CAMERA_OFFSET = 2e-6
"""Relative to the body's largest coordinate: how far camera legs start off a boundary."""

ASIDE = 2e-6
"""Angle in radians between a ray that slipped through an edge of a mesh and the one that is traced in its place.

A few times what float32 makes of its direction."""

OVERLAP_RAYS = 16
"""Most camera rays at a time whose middles are asked whether they lie in two bodies that overlap."""

FROM_ELSEWHERE = 0.01
"""Share of the camera's first hits from a side of boundaries where another medium is than the sensor names.

Above it a scene is refused."""

NEXT_TO_CAMERA = 0.05
"""Distance of a light from the camera, relative to that of a body, below which triangles are taken themselves: camera
rays are nearly along its light, and where they meet follows from the last digits of both."""

DENSE = 16.0
"""Optical depth of a body's size above which triangles are taken themselves: all light is next to the boundary, where
the error of beams is not what it is further on."""

OPAQUE = 20.0
"""Optical depth behind which nothing is seen of a medium: 2e-9 of the light is left."""

AT_CAMERA = 1e-3
"""Distance of a light from the camera, relative to that of a body, below which light sent straight back is not found.

Its curves are too small then: at 2e-3 all of it is found, at 2e-4 a quarter."""

ENDLESS = 1e30
"""Length that stands for no end: finite, so that its product with 0 is 0."""

GRAZING = 1e-3
"""Smallest cosine to a boundary by which the offset behind it is divided."""

LEAST_DIRECTION = 1e-20
"""Size of a direction's component below which its inverse is that of this one: finite, also times a coordinate."""

LEAST_COSINES = 1e-12
"""Smallest sum of the cosines on both sides of a boundary by which Fresnel terms are divided.

For eta = 1 they are 0/0 at grazing incidence, where nothing is reflected."""

CRITICAL = 1e-6
"""Smallest cosine behind a boundary by which its derivative is divided: it has a pole at the critical angle."""

LEAST_LOBE = 1e-9
"""Smallest 1 + g^2 - 2 g cos in Henyey and Greenstein's function: for g near 1 rounding may make it negative."""

REACH_SIZE = 4.0
"""Most length of light beams in a medium without end, relative to the body's size, for which they are subdivided."""

ARRIVAL_OFFSET = 1e-5
"""Relative to the body's largest coordinate: how far towards the light its way is followed from a boundary."""

MOST_PANELS = 2048
"""Most panels of the quadrature for light that is not refracted: enough for a lobe of 0.005 rad."""

STRETCH = 2.0
"""Factor by which the distance from a light's foot changes at most in one panel of the quadrature: attenuation, smooth
in the distance, is then so in the angle."""

BISECTIONS = 10
"""Halvings that find where along a camera segment the light begins or ends to be blocked: to 1e-3 of a panel of the
quadrature."""

PARALLEL = 1e-10
"""sin^2 of the angle between light and camera ray below which where they meet is not known in float32: to 1 % there."""

WIDE = 0.999
"""Sine of a cone's half-angle that is as good as a half-space."""

COSINE = 1e-5
"""Slack of the spindle test's cosines: their rounding in float32, several times over."""

SLOPE = 0.25
"""Smallest |dg/dlambda| at a root relative to its value for a linear beam.

Below, t has an extremum on the curve inside the triangle (a fold) and the linear beam is the better estimate;
counted as unresolved."""

FLAT = 8.0
"""Change of g along an edge relative to its deviation from linear in the middle.

Below it the curve may run along the edge."""

OVERSHOOT = 2.0
"""Largest lambda taken for a root on the ray through the chord; beyond, the linear beam is used."""

MAX_SUBDIVISION = 5
"""Most levels (each cuts a triangle in 4) by which a strongly bent beam is refined, for all segments."""

MOST_LEVELS = 2 * MAX_SUBDIVISION
"""Most levels by which a triangle that no beams were made of is cut for single segments: of all the most."""

DEPTH = 1.0
"""Largest change of optical depth along the curve in one beam. Where it is larger the beam is subdivided.

Up to there two Gauss points are good to 1e-3, or one with the mean of the exponential taken exactly."""

MARGIN = 0.2
"""How near to zero, relative to its change, t, s or another limit must come on the curve in a beam to be looked at."""

CUT = 8
"""Parts into which the curve in a beam is cut where it is too complicated."""

SHORTEST = 1.5 / CUT**3
"""Length below which a part is not cut again, relative to the curve in one beam or to the shorter mean free path."""

NEAR = 0.2
"""Largest edge of a beam's triangle relative to its distance from the light: the light's 1/d^2 is then good to 1e-3."""

PARTLY_LIT = 0.005
"""Largest edge of a beam's triangle relative to the body's size, of beams that are not proven to be wholly lit.

A shadow is seen by a sample or two on each, and would have the form of their edges."""

EVENLY_SENT = 0.95
"""Least that a light sends to a place on a triangle relative to the most there, or its beams are as small."""

TURN = 0.3
"""Largest difference between the refracted directions at the corners of a beam, in radians: the cosines and the
transmittance are then good to a few 1e-3."""

EXCESS = 1e-6, 1e6
"""Range to which an excess over the thresholds above is clipped before its logarithm is taken.

Far beyond ``MAX_SUBDIVISION``, and finite."""

NEEDLE = 1e-6
"""Square of the sine between a triangle's edges below which no linear model of its light beam is made: all rounding."""

ALONG_WALL = 1e-6
"""Least component of a light beam's direction towards a wall of its box that it is taken to meet.

float32, several times over."""

BROAD = 0.5
"""Spread of a light beam (difference between unit directions) above which nothing is proven of how far it is free.

The bound is divided by 1 - spread."""

LEAVING = 1e-6
"""Smallest cosine to a triangle by which the distance to its plane is divided."""

STEEP = 1e-3
"""Cosine to a triangle, besides twice the beam's bend, above which the distance to its plane is used."""

TRUSTED = 0.999
"""Share of the distance to a triangle's plane for which a beam is proven to be free.

The rest is for rounding, where it is met at a small angle."""

LIGHT_NUMBERS = 256
"""Points of each light by which those that must be drawn are compared: to some 6 %, enough to share out samples."""

EVEN_LIGHT = 0.1
"""Share of the light samples that lights get evenly.

A light that brings nothing to the bodies' centres may light other places."""

PHOTON_PILOTS = 16
"""Light points by which photons of a light that is no point or direction are aimed."""

PHOTON_RADIUS = 0.01
"""Default radius of photons relative to a body's size."""

PHOTON_THIN = 1e-6
"""Least optical depth of a photon's way by which its place on it is drawn: below, 1 - exp(-depth) has no digits."""

UNAIMED = 0.05
"""Share of the photons that go to a boundary evenly where the light on its triangles is known by samples alone."""

BEAM_PARTS = 32.0
"""Parts into which a photon beam as long as its body is cut for the tree."""

NEAREST = 1e-3
"""Smallest distance of the light from a camera segment's line, relative to its length, that sampling assumes."""

NEAREST_LINE = 1e-6
"""Smallest distance of a light in a medium from a camera ray's line that is told from 0.

Relative to the light's distance from the ray's origin."""

EVEN_DEPTH = 8.0
"""Optical depth of both legs together below which panels of the quadrature for unrefracted light are nearly equal."""

THIN = 1e-3
"""Optical depth of a segment below which samples are spread over it as if it were this."""

ROOT_STEP = 1e-3
"""Step of Newton's method that is the last one, relative to the light beam's size: after it the error is its square.

For an interval's end it is relative to the ray from the corner."""

ROOT_LONGEST = 1.0
"""Longest step of Newton's method, relative to the light beam's size."""

ROOT_ITERATIONS = 16
"""Most evaluations of the constraint for one root; 2 to 3 are usual."""

ROOT_PARALLEL = 1e-12
"""sin^2 of the angle between the Jacobian's columns below which it is singular: its rounding in float32."""

ROOT_ROUNDING = 1e-6
"""Size of q x n at a root that is rounding, several times over."""

DOUBLE_STEPS = 3
"""Steps in double precision after a root in a part of a triangle: from float32's 1e-3 next to a fold to 1e-12."""

MOMENT = 1e-6
"""Rounding of (V - P) x omega in float32 relative to |V - P|, several times over."""

OUTSIDE = 0.5
"""How far outside of its light beam, relative to its size, a root is still taken for that of its curve.

Curves are slightly bent and may run along an edge."""

DEPTH_SAMPLES = 4.0
"""How many times more samples an interval gets per unit of optical depth that it spans.

The error of regular samples of the exponential falls with the square of their number: 3e-3 for one sample of a
quarter."""

MOST_SAMPLES = 256.0
"""Most of that: behind 64 optical depths little is left."""

FOUND = 0.5
"""Share of an interval's samples that must be found for it to count as resolved."""

MOST_UNRESOLVED = 0.05
"""Share of camera samples that are not resolved above which a render warns."""

FOLD_STEPS = 4
"""Steps of regula falsi for a fold; t there is then good to the square of their error."""

PIECES = 1 << 21
"""Most parts of beams that are looked at in one kernel."""

SAMPLED = 3.0
"""How many times the deviation in a beam's middle its length is uncertain elsewhere."""

SAMPLED_LEAST = 1e-3
"""The same at least, relative to the length."""

MISSING = 0.05
"""Share of the light in a medium from which on its lack is told."""

MISSING_BEHIND = 0.005
"""The same for light that is refracted more than once: it is all that there is in a shadow."""

MISSING_PHOTONS = 4096
"""Photons, and points on surfaces, by which it is estimated what is missing: a quarter of a percent is ten of them."""

MISSING_LIGHTS = 16
"""Most lights that send them."""

MISSING_LEGS = 24
"""Most legs of their ways."""

MISSING_SCATTERED = 0.2
"""Least share of photons that scatter, and that don't, where a medium is thin, or dense."""

MISSING_OFFSET = 1e-5
"""Relative to the largest coordinate: how far off a surface they go on."""

MISSING_CONE = 1e-6
"""Least 1 - cos of a cone in which photons are sent: the rounding of float32 a few times over."""

MISSING_TEXELS = 8
"""Points along u, and along v, at which a surface is asked what it reflects."""

MISSING_ALBEDO = 0.5
"""What a surface is taken to reflect of which that is not known."""

BUNDLED = 4
"""Camera segments that go through the tree of light beams together."""

BUNDLE = 2.0
"""How far apart segments that go through a tree together may be, relative to the width of light beams."""

CHUNK_PAIRS = 1 << 20
"""Places of the (bundle, leaf) buffer: 8 MiB; with what the filter makes of it about 0.5 GiB."""

CHUNK_BUNDLES = 1 << 16
"""Most bundles of camera segments that are traversed in one kernel: keeps kernels well below a second."""

FILLED = 0.8
"""Share of that buffer that the next chunk is meant to fill: a fifth more pairs than expected still fit."""

CHUNK_GROWTH = 4
"""Factor by which chunks grow at least as long as they may: distant segments have other numbers of pairs."""

FIRST_CHUNK = 1 << 10
"""Bundles in the first chunk, whose pairs tell how long the next may be."""

COALESCED = 4
"""Samples per pixel in a pass from which on Mitsuba puts those of a pixel into the film together."""

PASS_SAMPLES = 1 << 18
"""Most camera samples in one pass of the film, and most sample points of camera segments at a time."""

PLAIN_PASS_SAMPLES = 1 << 20
"""Most camera samples in one pass where camera rays meet neither boundaries nor mirrors: little is kept of them."""


PROFILE_CELLS = 64
"""Cells of the curve in one light beam for a probe.

The one point in each is then good to 1e-4, folds to 1e-5 of the light beam's part of the segment."""

APART = 1e-4
"""Least distance of V from P in the point form of a probe, relative to the larger of the body and the segment.

Their direction is then good to 1e-3."""

PEAK = 0.05
"""How much of the largest radiance per unit length a maximum along a probed segment stands out by."""

ROULETTE_DEPTH = 5
"""Edges after which paths between surfaces go on by Russian roulette."""

ROULETTE_MOST = 0.95
"""The largest probability to go on."""

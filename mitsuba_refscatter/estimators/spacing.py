"""Ways to spread samples along camera segments: each gives t for x in [0, 1], and the density of t."""

from __future__ import annotations

import drjit as dr

from .. import tolerances


class ByDepth:
    """With the density of the attenuation along the segment.

    sigma  Float, extinction in 1/length
    t_max  Float, length of the segment
    """

    def __init__(self, sigma, t_max):
        self.depth, self.t_max = dr.maximum(sigma * t_max, tolerances.THIN), t_max
        self.share = 1 - dr.exp(-self.depth)

    def t(self, x):
        """Float, distance along the segment of the sample ``x`` in [0, 1]."""
        return -self.t_max * dr.log(1 - x * self.share) / self.depth

    def density(self, t):
        """Float, of samples at ``t``, in 1/length."""
        return self.depth * dr.exp(-self.depth * t / self.t_max) / (self.t_max * self.share)


class ByAngle:
    """Regular in the angle under which a light sees the segment (equiangular; Kulla and Fajardo 2012).

    to_light  Vector3f, from the segment's origin to the light
    segment   ``LocalSegments``
    """

    def __init__(self, to_light, segment):
        self.t_max, self.foot = segment.t_max, dr.dot(to_light, segment.d)
        h = dr.norm(to_light - self.foot * segment.d)
        self.h = dr.maximum(h, tolerances.NEAREST * segment.t_max)
        # Angles from the segment's start on, without differences of large ones: lights may be far away.
        self.angle = dr.atan2(self.h * self.t_max, dr.square(self.h) - self.foot * (self.t_max - self.foot))

    def t(self, x):
        """Float, distance along the segment of the sample ``x`` in [0, 1]."""
        T = dr.tan(x * self.angle)
        t = T * (dr.square(self.h) + dr.square(self.foot)) / (self.h + self.foot * T)
        return dr.clip(t, 0, self.t_max)

    def density(self, t):
        """Float, of samples at ``t``, in 1/length."""
        return self.h / (self.angle * (dr.square(self.h) + dr.square(t - self.foot)))

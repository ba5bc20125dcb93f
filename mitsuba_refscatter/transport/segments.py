"""Camera segments: the parts of camera rays in regions that scatter. One record from the camera to the film."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import drjit as dr
import mitsuba as mi

from ..core import arrays
from ..geometry import bvh


@dataclass
class CameraSegments:
    """Parts of camera rays in one region, N of them, world coordinates.

    origin       Point3f, just off the boundary where a segment starts, rounded in world coordinates
    offset       Vector3f, from ``origin`` to the place on the boundary
    direction    Vector3f, unit, away from the camera
    length       Float, to the next surface, or as far as light is followed in a region without end
    region       int, index of the region
    weight       Spectrum, what a unit of radiance at the start is worth to the camera sample
    sample       UInt32, the camera sample
    wavelengths  one set, or one per segment; without components but in spectral variants
    share        Float, about how much of what its camera sample shows a segment holds, 0 to 1
    """

    origin: mi.Point3f
    offset: mi.Vector3f
    direction: mi.Vector3f
    length: mi.Float
    region: int
    weight: mi.Spectrum
    sample: mi.UInt32
    wavelengths: mi.Spectrum
    share: mi.Float

    def __len__(self):
        return dr.width(self.length)

    def gather(self, index):
        """Those at ``index`` (UInt32)."""
        gathered = {name: arrays.gather(getattr(self, name), index) for name in _ARRAYS}
        return replace(self, wavelengths=arrays.of(self.wavelengths, index), **gathered)

    @classmethod
    def concat(cls, parts):
        """All segments of a list of them, of one region."""
        joined = {name: arrays.concat(getattr(part, name) for part in parts) for name in _ARRAYS}
        one = len(parts[0].wavelengths) == 0 or any(dr.width(part.wavelengths) != len(part) for part in parts)
        wavelengths = parts[0].wavelengths if one else arrays.concat(part.wavelengths for part in parts)
        return replace(parts[0], wavelengths=wavelengths, **joined)

    def start(self):
        """Point3f, where they start on the boundary, rounded in world coordinates."""
        return mi.Point3f(self.origin + self.offset)

    def from_boundary(self, centre, sigma_t):
        """``LocalSegments`` about ``centre`` (three numbers, world), from the boundary on. ``sigma_t``: Spectrum,
        extinction along them."""
        off = self.off_boundary(centre, sigma_t)
        return replace(off, o=mi.Point3f(off.o + self.offset))

    def off_boundary(self, centre, sigma_t):
        """The same from just off the boundary on, where rays can be traced from."""
        o = mi.Point3f(self.origin - mi.Point3f(dr.opaque(mi.Point3f, centre)))
        return LocalSegments(o, self.direction, self.length, sigma_t)


_ARRAYS = [field.name for field in fields(CameraSegments) if field.name not in ("region", "wavelengths")]


@dataclass
class LocalSegments:
    """Segments about a point near by, so that float32 keeps its digits: V = o + t d, 0 < t < t_max.

    o        Point3f, relative to the centre of a body
    d        Vector3f, unit
    t_max    Float
    sigma_t  Spectrum, extinction in 1/length, of width 1 or one per segment
    """

    o: mi.Point3f
    d: mi.Vector3f
    t_max: mi.Float
    sigma_t: mi.Spectrum

    def gather(self, index, active=True):
        """Geometry of the segments at ``index``; ``sigma_t`` stays as it is (``sigma_t_of``)."""
        o, d, t_max = (dr.gather(type(x), x, index, active) for x in (self.o, self.d, self.t_max))
        return replace(self, o=o, d=d, t_max=t_max)

    def sigma_t_of(self, index):
        """Extinction of the segments at ``index``."""
        if dr.width(self.sigma_t) == 1:
            return self.sigma_t
        return dr.gather(type(self.sigma_t), self.sigma_t, index)

    @property
    def inverse_d(self):
        """1 / d, finite."""
        return bvh.finite_inverse(self.d)

    def __len__(self):
        return dr.width(self.t_max)

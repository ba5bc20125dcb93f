"""What of a scene's surfaces is asked for estimates: their names, and what they reflect."""

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import tolerances
from ..core import arrays
from .errors import name_shape
from .media import visible


def shape_number(shape):
    """Mitsuba's number of a shape: what shape pointers are in kernels."""
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def names(mi_scene):
    """Names of all shapes by their number."""
    return {shape_number(shape): name_shape(shape) for shape in mi_scene.shapes()}


def box(mi_scene):
    """Box around all shapes (low, high), or None where there are none."""
    whole = mi_scene.bbox()
    return tuple(np.array(x).ravel() for x in (whole.min, whole.max)) if whole.valid() else None


def albedos(mi_scene, shapes):
    """A table (Float) by the number of a shape: the share of light that ``shapes`` reflect, in the mean over
    themselves and the wavelengths, as far as their BSDFs tell; 0 for others."""
    known, out = {}, np.zeros(1 + max(map(shape_number, mi_scene.shapes()), default=0))
    n = tolerances.MISSING_TEXELS
    si = dr.zeros(mi.SurfaceInteraction3f, n**2)
    si.uv = mi.Point2f(dr.meshgrid(*2 * [(dr.arange(mi.Float, n) + 0.5) / n]))
    si.wi, si.n, si.wavelengths = mi.Vector3f(0, 0, 1), mi.Normal3f(0, 0, 1), visible()
    si.sh_frame = mi.Frame3f(si.n)
    for shape in shapes:
        bsdf = shape.bsdf()
        if bsdf is not None and id(bsdf) not in known:
            known[id(bsdf)] = _reflected(bsdf, si)
        out[shape_number(shape)] = known.get(id(bsdf), tolerances.MISSING_ALBEDO)
    return arrays.array(mi.Float, out)


def _reflected(bsdf, si):
    """The mean over ``si`` of the share of light that a BSDF reflects."""
    try:
        seen = np.nan_to_num(np.array(dr.mean(bsdf.eval_diffuse_reflectance(si))))
    except RuntimeError:  # some plugins can't be asked in some variants, and an estimate must not end a render
        return tolerances.MISSING_ALBEDO
    return float(np.clip(seen, 0, 1).mean())

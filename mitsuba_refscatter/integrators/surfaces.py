"""The surfaces at the ends of camera paths, shaded by sampled paths."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .. import options
from ..transport.surface_paths import SurfacePaths


def shade(scene, paths, ray, limits, seed):
    """Radiance (Spectrum) that surfaces bring to camera rays, and which of these count as hits for alpha (Bool).

    scene   ``scene.Scene``
    paths   ``camera_paths.Paths``
    ray     the camera's, mi.Ray3f
    limits  ``surface_paths.SurfaceLimits``
    seed    of random numbers
    """
    out, hit = dr.zeros(mi.Spectrum, dr.width(ray)), paths.hit
    for i, legs in enumerate(paths.ends + paths.dropped):
        if len(legs) == 1:  # Dr.Jit takes the state of a loop over one lane for a constant
            legs = legs.gather(mi.UInt32(0, 0))
            legs.weight = legs.weight * 0.5
        value, seen = SurfacePaths(scene, ray, legs, limits).radiance(i < len(paths.ends), seed + i)
        dr.scatter_add(out, legs.weight * value, legs.sample)
        dr.scatter(hit, seen, legs.sample, legs.depth == 0)
        dr.eval(out, hit)
    return out, hit


def seed_from(sampler):
    """A seed for independent samples of another number of lanes, drawn from the sampler."""
    return int(sampler.next_1d()[0] * 2**31)


def leave_out_nested(props):
    """Warns of nested integrators, which are left out; refuses nested objects that are none."""
    for name in props.keys():
        if props.type(name) == mi.Properties.Type.Object:
            other = props[name]
            if not isinstance(other, mi.Integrator):
                raise options.OptionError(f"refscatter: the nested {other.class_name()} is no integrator: remove it")
            mi.Log(
                mi.LogLevel.Warn,
                f"refscatter: the nested {other.class_name()} is left out, as surfaces are shaded by paths of "
                f"refscatter: remove it",
            )

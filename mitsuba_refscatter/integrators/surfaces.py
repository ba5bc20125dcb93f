"""The surfaces at the ends of camera paths, shaded by a nested integrator that ignores media."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .. import options
from ..core import arrays
from ..scene import REFUSED

NESTED_WITH_MEDIA = ("Volumetric", "VolpathMis", "PRBVolpath", "Refscatter")
"""Parts of the names of integrators that sample media, as they show in descriptions, too."""


def shade(nested, mi_scene, paths, sampler, ray):
    """Radiance that the ends of the camera paths bring, by the nested integrator, and which camera rays count as
    hits for alpha: its say where no body is met, so that emitters can be hidden."""
    out, hit = dr.zeros(mi.Spectrum, dr.width(ray)), paths.hit
    for i, legs in enumerate(paths.ends):
        if len(legs) == 1:  # Dr.Jit takes the state of a loop over one lane for a constant
            legs = legs.gather(mi.UInt32(0, 0))
            legs.weight = legs.weight * 0.5
        leg = mi.RayDifferential3f(mi.Ray3f(legs.o, legs.d))
        leg.time = arrays.of(ray.time, legs.sample)
        leg.wavelengths = arrays.of(ray.wavelengths, legs.sample)
        fresh = mi.load_dict({"type": "independent"})
        fresh.seed(seed_from(sampler), len(legs))
        value, valid, _ = nested.sample(mi_scene, fresh, leg, None, True)
        dr.scatter_add(out, legs.weight * value, legs.sample)
        if i == 0 and paths.direct:
            dr.scatter(hit, valid, legs.sample)
        dr.eval(out, hit)
    return out, hit


def seed_from(sampler):
    """A seed for independent samples of another number of lanes, drawn from the sampler."""
    return int(sampler.next_1d()[0] * 2**31)


def nested_integrator(props, hide_emitters):
    """The nested integrator, or the default one."""
    nested = [props[name] for name in props.keys() if props.type(name) == mi.Properties.Type.Object]
    for other in nested:
        if not isinstance(other, mi.Integrator):
            raise options.OptionError(f"refscatter: the nested {other.class_name()} is no integrator: remove it")
    if len(nested) > 1:
        names = ", ".join(other.class_name() for other in nested)
        raise options.OptionError(f"refscatter: more than one nested integrator is given ({names}): give one")
    if not nested:
        return mi.load_dict({"type": "path", "hide_emitters": hide_emitters})
    if not isinstance(nested[0], mi.SamplingIntegrator):
        raise options.OptionError(f"refscatter: the nested {nested[0].class_name()} does not work along rays: use path")
    names = f"{nested[0].class_name()} {type(nested[0]).__name__} {nested[0]}"
    if any(name in names for name in NESTED_WITH_MEDIA):
        raise options.OptionError(f"refscatter: the nested {nested[0].class_name()} {REFUSED['twice'].says}")
    return nested[0]

"""Registers the Mitsuba plugins, for the variant that is set now and for every one set later."""

import importlib
import sys

import mitsuba as mi

from . import platform

_MODULE = "mitsuba_refscatter.integrators.refscatter"


def _register(*_):
    """Makes the integrator class under the current variant; under others registers a clear refusal."""
    variant = mi.variant()
    if variant is None:
        return
    if platform.is_supported(variant):
        loaded = sys.modules.get(_MODULE)
        module = importlib.reload(loaded) if loaded else importlib.import_module(_MODULE)
        mi.register_integrator("refscatter", lambda props: module.RefscatterIntegrator(props))
    else:
        mi.register_integrator("refscatter", lambda props: platform.require_usable(variant))


def register():
    """Registers once; safe to call again and to reload."""
    mi.detail.add_variant_callback(_register)
    _register()

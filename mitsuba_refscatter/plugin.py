"""Registers the Mitsuba plugins, for the variant that is set now and for every one set later."""

import importlib
import sys

import mitsuba as mi

from . import platform

_PLUGINS = {
    "refscatter": ("refscatter", "RefscatterIntegrator"),
    "refscatter_straight": ("straight_line", "StraightIntegrator"),
    "refscatter_photons": ("photons", "PhotonIntegrator"),
}
"""Name of each plugin: its module in ``integrators``, after those that it needs, and its class."""


def _register(*_):
    """Makes the integrator classes under the current variant; under others registers a clear refusal."""
    variant = mi.variant()
    if variant is None:
        return
    for name, (where, kind) in _PLUGINS.items():
        if platform.is_supported(variant):
            path = f"mitsuba_refscatter.integrators.{where}"
            loaded = sys.modules.get(path)
            module = importlib.reload(loaded) if loaded else importlib.import_module(path)
            mi.register_integrator(name, getattr(module, kind))
        else:
            mi.register_integrator(name, lambda props: platform.require_usable(variant))


def register():
    """Registers once; safe to call again and to reload."""
    mi.detail.add_variant_callback(_register)
    _register()

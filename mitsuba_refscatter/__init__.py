"""mitsuba_refscatter: single scattering in media with refractive boundaries, as a Mitsuba 3 integrator.

``import mitsuba_refscatter`` registers the plugin ``refscatter``, before or after ``mi.set_variant``. ``probe`` looks
at one camera ray.
"""

from . import plugin

__version__ = "0.1.0"

plugin.register()


def __getattr__(name):
    """``probe``, which needs a variant only when it is called, is imported when it is asked for."""
    if name == "probe":
        from .probing import probe

        return probe
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

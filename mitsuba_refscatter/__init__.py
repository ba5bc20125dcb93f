"""mitsuba_refscatter: single scattering in media with refractive boundaries, as a Mitsuba 3 integrator.

``import mitsuba_refscatter`` registers the plugin ``refscatter``, before or after ``mi.set_variant``.
"""

from . import plugin

__version__ = "0.1.0"

plugin.register()

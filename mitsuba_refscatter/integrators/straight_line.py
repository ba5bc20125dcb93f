"""The Mitsuba plugin ``refscatter_straight``. Reloaded by ``plugin.py`` for every variant."""

from .. import options
from . import single_scattering
from .prepared import prepare
from .refscatter import RefscatterIntegrator


class StraightIntegrator(RefscatterIntegrator):
    """Single scattering of light that goes straight through boundaries, as production renderers approximate it:
    as if each were ``null`` to light. Camera rays are refracted and reflected as by ``refscatter``; at eta = 1
    both agree. So a second refracting boundary on the way is a shadow here, too.

    .. pluginparameters::

     * - tolerance, internal_bounces, light_samples, surfaces, max_depth, aovs
       -
       - As of ``refscatter``. Light points are those of its culling ``beams``.

    .. code-block:: python

        'type': 'refscatter_straight', 'surfaces': False
    """

    known, refracts = options.Common, False
    missing_in_media = staticmethod(lambda scene, bounces: [])  # what it leaves out is what it is for

    def prepare(self, scene, seed, changes=None):
        return prepare(scene, options.Options(**vars(self.options)), self.cache, seed, straight=True, changes=changes)

    def scatter(self, prepared, paths, samples, counts, _sampler):
        return single_scattering.scatter(prepared, paths, samples, counts, refracted=False)

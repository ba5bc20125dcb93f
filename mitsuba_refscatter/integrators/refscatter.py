"""The Mitsuba plugin ``refscatter``. Reloaded by ``plugin.py`` for every variant."""

import drjit as dr
import mitsuba as mi

from .. import film, missing, options, platform, tolerances
from ..core.cache import Cache
from ..core.sobol import Batch, Sequence
from ..estimators.wavefront import Counts
from ..scene import SceneError, refuse_gradients
from ..transport.surface_paths import SurfaceLimits
from . import messages, single_scattering
from .hooks import Hooks
from .prepared import prepare
from .render_pass import RenderPass
from .surfaces import leave_out_nested, seed_from


class RefscatterIntegrator(mi.SamplingIntegrator):
    """Single scattering in media with refractive boundaries; without noise, but for the estimator ``point`` and
    for lights that are not a point or a direction. Raises ``OptionError`` for properties when it is made,
    ``SceneError`` for scenes when it renders.

    .. pluginparameters::

     * - estimator
       - |string|
       - How light is summed along a camera segment: ``curve`` (exact integration over the light's side), ``interval``
         (Holzschuch 2015) or ``point`` (Walter et al. 2009); what the latter two do otherwise than published stands at
         the head of their modules in ``estimators``. (Default: curve)
     * - culling
       - |string|
       - How triangles are found for a segment: ``beams`` (light beams, made once per light) or ``spindle`` (the test of
         both publications, nothing made per light). (Default: beams)
     * - tolerance
       - |float|
       - Relative error of the single-scattering image that is aimed at, 0 to 1; 0 is exact to float32 (``curve``).
         (Default: 0.01)
     * - samples
       - |int|
       - Samples per interval (``interval``; as published: 1) or per camera segment (``point``); 0: chosen by
         the tolerance, which ``point`` does not reach: its noise is about 0.5 / sqrt(samples). Not with ``curve``.
         (Default: 0)
     * - internal_bounces
       - |int|
       - Internal reflections of the camera ray, and hits from outside and of mirrors after the first. (Default: 4)
     * - light_bounces
       - |int|
       - Refractions and reflections of light before it scatters, besides a first refraction. 0 is that one alone; a
         first reflection by a mirror is 1. Known by ``curve`` with ``beams`` alone. (Default: 0)
     * - light_samples
       - |int|
       - Light points per pass for emitters that are not a point or a direction. With the culling ``beams`` the camera
         samples of a pass share them, with ``spindle`` each has its own. Places in the pixels then come from one
         sequence with the light points, not from the sampler (``sequence``). (Default: 16)
     * - surfaces
       - |bool|
       - Also what is seen by reflection and through the bodies, shaded by sampled paths. Media
         absorb light on them. (Default: true)
     * - aovs
       - |string|
       - Extra channels: ``single_scatter``, ``surfaces``, ``candidates``, ``contributions``,
         ``unresolved``, comma-separated. (Default: none)
     * - max_depth
       - |int|
       - Edges of the longest path between surfaces, counted from the camera, as of ``volpath``; -1: any number.
         (Default: -1)

    .. code-block:: python

        'type': 'refscatter', 'tolerance': 0.01, 'surfaces': False

        # Nearest to the publication of 2015:
        'type': 'refscatter', 'estimator': 'interval', 'culling': 'spindle', 'samples': 1

    The implementation departs from the published methods where light or digits would be lost:

    - Intervals are searched from the zeros of g on a triangle's edges, not from the camera ray's intersection with its
      plane, where the walk to the edges may lose the curve (``estimators.interval``). For both estimators triangles
      are cut where refraction is far from linear on them.
    - Newton's method solves q x n = 0 (q = 0 at eta = 1), which holds its digits near eta = 1, instead of the half
      vector's constraint (``solve.constraint``).
    - Intervals are split at folds, and samples are regular in the curve's own parameter (``estimators.interval``).
    - The spindle culling tests, besides the spindle and the normals, whether the refracted light line can meet the
      segment (``culling.spindle``).
    """

    known = options.Options
    """What its properties are read as."""

    missing_in_media = staticmethod(missing.in_media)
    """What is said of light that is not computed in the media of a scene."""

    refracts = True
    """Whether light that is refracted is solved for."""

    estimated_error = None
    """Relative L1 error of single scattering that the last render expects of itself, but for exact triangles, where it
    is 0. None before the first, and where light is not solved for."""

    def __init__(self, props):
        super().__init__(props)
        platform.require_usable(mi.variant())
        self.options = options.read(props, self.known)
        leave_out_nested(props)
        self.surfaces = SurfaceLimits(self.options.max_depth, self.hide_emitters)
        self.cache, self.messages = Cache(), messages.Messages()

    def aov_names(self):
        """Names of the extra channels, in order."""
        return [channel for name in options.aov_list(self.options) for channel in options.AOVS[name]]

    def to_string(self):
        """All properties with their values, which is what an EXR's header says, too."""
        inside = ", ".join(f"{key} = {value}" for key, value in vars(self.options).items())
        return f"{type(self).__name__}[{inside}]"

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Radiance along the rays. Evaluates kernels, so it cannot be part of a symbolic loop or call."""
        if dr.flag(dr.JitFlag.SymbolicScope):
            raise RuntimeError("refscatter cannot run inside a symbolic loop or call: call it on evaluated rays")
        refuse_gradients(scene)
        with dr.suspend_grad():
            prepared = self.prepare(scene, lambda: seed_from(sampler))
            render_pass = self._pass(prepared, medium, Counts(), whole=False)
            return render_pass(sampler, ray, mi.Spectrum(1), active, Batch(), None)

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True, *, hooks=None):
        """As Mitsuba's; ``sensor`` is one or its number, ``hooks``: ``Hooks``. Raises ``SceneError`` for a scene
        that is not supported."""
        platform.require_usable(mi.variant())
        if isinstance(sensor, int):
            if not scene.sensors():
                raise SceneError("the scene has no sensor: add one")
            sensor = scene.sensors()[sensor]
        refuse_gradients(scene)
        hooks, number = hooks or Hooks(), int(mi.UInt32(seed)[0])
        with dr.suspend_grad():
            prepared = self.prepare(scene, lambda: number, hooks.accuracy)
            self.messages.begin()
            hooks.counts = Counts()
            sequence = prepared.sequence
            if (
                hooks.watch is not None
            ):  # then the number of samples is not known, and samplers stratify for a known one
                sequence = sequence or Sequence(number)
            most = tolerances.PASS_SAMPLES if prepared.scene.splits else tolerances.PLAIN_PASS_SAMPLES
            frame = film.Frame(sensor, seed, spp, sequence, most, self.aov_names(), hooks.progress, hooks.watch)
            render_pass = self._pass(prepared, sensor.get_medium(), hooks.counts, whole=True, silent=hooks.silent)
            image = film.render(render_pass, frame, develop, evaluate)
            self.estimated_error = hooks.counts.estimated_error if self.refracts else None
            self.messages.warn(messages.unresolved(hooks.counts, self.options.tolerance))
            return image

    def prepare(self, scene, seed, changes=None):
        """``Prepared`` for a scene; ``seed()`` gives the seed of its random numbers, ``changes``: as
        ``prepared.prepare`` has them."""
        return prepare(scene, self.options, self.cache, seed, changes=changes)

    def scatter(self, prepared, paths, samples, counts, sampler):
        """``Sums`` of single scattering along the camera paths, per camera sample."""
        samples.seed = seed_from(sampler) if prepared.estimator.draws else 0
        return single_scattering.scatter(prepared, paths, samples, counts)

    def _pass(self, prepared, medium, counts, whole, silent=False):
        """``RenderPass`` of this plugin."""
        return RenderPass(
            prepared=prepared,
            options=self.options,
            medium=medium,
            scatter=self.scatter,
            missing=self.missing_in_media,
            surfaces=self.surfaces,
            messages=self.messages,
            counts=counts,
            refracts=self.refracts,
            whole=whole,
            silent=silent,
        )

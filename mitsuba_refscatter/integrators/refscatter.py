"""The Mitsuba plugin ``refscatter``. Reloaded by ``plugin.py`` for every variant."""

import drjit as dr
import mitsuba as mi

from .. import camera, film, lanes, missing, options, platform, tolerances, wavefront
from ..kept import Kept
from ..scene import REFUSED, SceneError, refuse_gradients
from ..sequence import Batch, Sequence
from .lit import Prepared, scatter

NESTED_WITH_MEDIA = ("Volumetric", "VolpathMis", "PRBVolpath", "Refscatter")
"""Parts of the names of integrators that sample media, as they show in descriptions, too."""


class RefscatterIntegrator(mi.SamplingIntegrator):
    """Single scattering in media with refractive boundaries; without noise, but for the estimator ``point`` and for lights
    that are not a point or a direction. Raises ``OptionError`` for properties when it is made, ``SceneError`` for scenes when it
    renders.

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
     * - light_samples
       - |int|
       - Light points per pass for emitters that are not a point or a direction. With the culling ``beams`` the camera
         samples of a pass share them, with ``spindle`` each has its own. Places in the pixels then come from one
         sequence with the light points, not from the sampler (``sequence``). (Default: 16)
     * - surfaces
       - |bool|
       - Also what is seen by reflection and through the bodies, shaded by the nested integrator.
         (Default: true)
     * - aovs
       - |string|
       - Extra channels: ``single_scatter``, ``surfaces``, ``candidates``, ``contributions``,
         ``unresolved``, comma-separated. (Default: none)
     * - (Nested plugin)
       - |integrator|
       - Shades surfaces; must ignore media. (Default: ``path``)

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

    def __init__(self, props):
        super().__init__(props)
        platform.require_usable(mi.variant())
        self.options = options.read(props, self.known)
        self.nested = _nested(props, self.hide_emitters)
        self.progress = self.watch = None  # for ``film.render``
        self.counts, self.kept = wavefront.Counts(), Kept()
        self.changes = {}  # fields of ``tolerances.Accuracy``, for measurements
        self.told = set()  # sentences that warned since the last render began

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
            return self._sample(prepared, medium, sampler, ray, mi.Spectrum(1), active, Batch(), None)

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """As Mitsuba's; ``sensor`` is one or its number. Raises ``SceneError`` for a scene that is not supported."""
        platform.require_usable(mi.variant())
        if isinstance(sensor, int):
            if not scene.sensors():
                raise SceneError("the scene has no sensor: add one")
            sensor = scene.sensors()[sensor]
        refuse_gradients(scene)
        with dr.suspend_grad():
            prepared = self.prepare(scene, lambda: int(mi.UInt32(seed)[0]))
            self.counts, self.told, prepared.whole = prepared.counts, set(), True
            medium, sequence = sensor.get_medium(), prepared.sequence
            if self.watch is not None:  # then the number of samples is not known, and samplers stratify for a known one
                sequence = sequence or Sequence(int(mi.UInt32(seed)[0]))
            image = film.render(lambda *a: self._sample(prepared, medium, *a), sensor, seed, spp, sequence,
                                self.aov_names(), develop, evaluate, self.progress, self.watch)  # fmt: skip
            self.counts.warn(self.options.tolerance)
            return image

    def prepare(self, scene, seed):
        """``Prepared`` for a scene; ``seed()`` gives the seed of its random numbers."""
        return Prepared(scene, self.options, seed, self.kept, changes=self.changes)

    def scatter(self, prepared, paths, ray, n, batch, sampler, detail, progress):
        """``Sums`` of single scattering along the camera paths, per camera sample."""
        seed = seed_from(sampler) if self.options.estimator == "point" else 0
        return scatter(prepared, paths, ray, n, batch, seed, detail, progress)

    def _tell(self, sentences):
        """Warns of what is missing, once per render and sentence."""
        for sentence in sentences:
            if sentence not in self.told:
                mi.Log(mi.LogLevel.Warn, f"refscatter: {sentence}.")
            self.told.add(sentence)

    def _sample(self, prepared, medium, sampler, ray, ray_weight, active, batch, progress):
        """One wavefront of camera rays: chain, single scattering along it, surfaces at its ends.

        ``ray_weight`` is the sensor's; it goes into the channels that show radiance, not into the result. ``batch``: which
        samples these are.
        """
        n, opt = dr.width(ray), self.options
        wanted = options.aov_list(opt)
        ray = mi.Ray3f(ray)
        # Of a few rays nothing is told: the estimate would cost more than they do.
        tells = prepared.whole or n >= tolerances.MISSING_PHOTONS
        if tells:
            prepared.once(lambda: self._tell(self.missing_in_media(prepared.scene)), "missing in media")
        start = prepared.start(medium, ray)
        paths = camera.trace(
            prepared.scene, ray, active, start, opt.internal_bounces, opt.surfaces, prepared.accuracy.weight
        )
        detail = bool({"candidates", "contributions"} & set(wanted))
        single = self.scatter(prepared, paths, ray, n, batch, sampler, detail, progress)
        unresolved = single.unresolved > dr.opaque(mi.Float, opt.tolerance) * dr.max(single.value)
        prepared.counts.saw(n, unresolved)
        shown, hit = mi.Spectrum(0), paths.hit
        if opt.surfaces:
            shown, hit = shade(self.nested, prepared.scene.mi_scene, paths, sampler, ray, n)
            if tells and paths.ends:
                prepared.once(
                    lambda: self._tell(missing.on_surfaces(prepared.scene, paths.ends)), "missing on surfaces"
                )
        extra = {
            "single_scatter": lambda: film.to_rgb(ray_weight * single.value, ray.wavelengths),
            "surfaces": lambda: film.to_rgb(ray_weight * shown + dr.zeros(mi.Spectrum, n), ray.wavelengths),
            "candidates": lambda: [single.candidates],
            "contributions": lambda: [single.contributions],
            "unresolved": lambda: [dr.select(unresolved, mi.Float(1), 0)],
        }
        return single.value + shown, hit, [x for name in wanted for x in extra[name]()]


def shade(nested, mi_scene, paths, sampler, ray, n):
    """Radiance that the ends of the camera paths bring, by the nested integrator, and which camera rays count as
    hits for alpha: its say where no body is met, so that emitters can be hidden."""
    out, hit = dr.zeros(mi.Spectrum, n), paths.hit
    for i, legs in enumerate(paths.ends):
        if len(legs) == 1:  # Dr.Jit takes the state of a loop over one lane for a constant
            legs = legs.gather(mi.UInt32(0, 0))
            legs.weight = legs.weight * 0.5
        leg = mi.RayDifferential3f(mi.Ray3f(legs.o, legs.d))
        leg.time = lanes.of(ray.time, legs.sample)
        leg.wavelengths = lanes.of(ray.wavelengths, legs.sample)
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


def _nested(props, hide_emitters):
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

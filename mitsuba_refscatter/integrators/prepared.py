"""What one render needs to know of a scene, made step by step: the records, the accuracy, the methods, the
structures."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..core.cache import Cache
from ..core.sobol import Sequence
from ..culling import CULLINGS, chains
from ..culling.protocol import Culling
from ..culling.structures import Structures
from ..estimators import ESTIMATORS, unrefracted, wavefront
from ..estimators.protocol import Estimator
from ..light.illumination import Illumination, illuminate, shadows
from ..scene import Scene, parameters, read
from ..scene.media import visible


@dataclass(frozen=True)
class ChainsKey:
    """Of the light beams behind chains.

    scene       Mitsuba's, the object itself
    parameters  digest of all that can be changed in it but for its sensors
    emitter     number of the light
    accuracy    what the tolerance decides
    bounces     events that are followed
    """

    scene: mi.Scene
    parameters: bytes
    emitter: int
    accuracy: tolerances.Accuracy
    bounces: int


@dataclass
class Prepared:
    """A scene that is ready to be rendered.

    scene          the records
    given          Mitsuba's scene, as it was given
    accuracy       what the tolerance decides
    estimator      how light is summed
    culling        how light beams, or triangles, are found: the class
    on_triangles   (estimator, culling) that take triangles themselves
    light_samples  light samples per pass of emitters that are not one point or direction
    cache          for what other renders use, too
    structures     over the triangles of the scene's boundaries
    sequence       of random numbers for light samples; None where none must be drawn
    made           what was made in this render, by keys that need not name the scene, the camera or options
    near           indices of emitters next to the camera
    light_bounces  events besides a first refraction that light is followed through; None by methods that know none
    """

    scene: Scene
    given: mi.Scene
    accuracy: tolerances.Accuracy
    estimator: Estimator
    culling: type[Culling]
    on_triangles: tuple[Estimator, type[Culling]]
    light_samples: int
    cache: Cache
    structures: Structures
    sequence: Sequence | None
    made: dict = field(default_factory=dict)
    near: set = field(default_factory=set)
    light_bounces: int | None = None

    def once(self, make, *key):
        """What ``make()`` makes in this render at the first use of ``key``."""
        if key not in self.made:
            self.made[key] = make()
        return self.made[key]

    def angle_panels(self, region):
        """``unrefracted.angle_panels`` of a region's phase function."""
        return self.once(lambda: unrefracted.angle_panels(region.phase, self.accuracy), "panels", region.index)

    def pace(self, *what):
        """``wavefront.Pace`` for segments of a kind."""
        return self.once(wavefront.Pace, "pace", *what)

    def parameters(self):
        """Digest of all that can be changed in the scene but for its sensors."""
        return self.once(lambda: parameters(self.given), "parameters")

    def shadows(self, body, sample):
        """``visibility.Shadows`` of a ``LightSample`` at a boundary."""
        return shadows(self.scene, body, self.scene.records, sample, self.accuracy.samples_visibility)

    def method(self, emitter, body):
        """(Estimator, class of culling) for the light of an ``Emitter`` that a boundary refracts."""
        exact = emitter.index in self.near or self.once(lambda: self._is_dense(body), "dense", body.inside)
        return self.on_triangles if exact else (self.estimator, self.culling)

    def _is_dense(self, body):
        """Whether nothing of the medium behind a boundary is seen but next to it."""
        _, sigma_t = self.scene.regions[body.inside].coefficients(visible(), mi.Vector3f(0, 0, 1))
        return bool(dr.all(sigma_t * body.size > tolerances.DENSE)[0])

    def culled(self, body, sample, emitter):
        """``(Shadows, Culling)`` of a ``LightSample`` of an ``Emitter`` at a boundary; the culling is None if
        nothing is lit. Made once per render where the emitter is one point or direction."""

        def make():
            found = self.shadows(body, sample)
            culling = self.method(emitter, body)[1]
            return found, culling.of(body, found, self.structures, self.light_samples if emitter.drawn else 0)

        return make() if emitter.drawn else self.once(make, "culled", body.index, body.key, emitter.index)

    def illuminated(self, body, region, sample, emitter, wavelengths=None):
        """``(Illumination, Culling)`` of a ``LightSample`` of an ``Emitter`` at a boundary of a region."""
        found, culling = self.culled(body, sample, emitter)
        illumination = self.illumination(body, region, sample, found, wavelengths)
        return illumination if culling is None else illumination.off(culling.apart), culling

    @property
    def accuracy_of_chains(self):
        """``Accuracy`` of light behind chains, of which there are no exact triangles."""
        exact = self.accuracy.cells == 0
        return tolerances.accuracy(tolerances.CHAINS_FINEST) if exact else self.accuracy

    def chains(self, sample, emitter):
        """``{region: LightBeams}`` of what a ``LightSample`` of an ``Emitter`` sends through chains. Made once for all
        renders where the emitter is one point or direction."""

        def make():
            drawn = self.light_samples if emitter.drawn else 0
            return chains.of(self.structures, sample, self.light_bounces, self.accuracy_of_chains, drawn)

        if emitter.drawn:
            return make()
        key = ChainsKey(self.given, self.parameters(), emitter.index, self.accuracy, self.light_bounces)
        return self.cache.once(make, key)

    def illumination(self, body, region, sample, shadows, wavelengths=None) -> Illumination:
        """``Illumination`` of a boundary by a ``LightSample``."""
        return illuminate(self.scene, body, region, sample, shadows, wavelengths)


def prepare(scene, options, cache, seed, straight=False, changes=None):
    """``Prepared`` for one render of a ``mi.Scene``.

    options   ``options.Options``
    cache     ``Cache``, whose next round begins
    seed      () -> seed of random numbers, asked for where lights must be drawn
    straight  whether light is never refracted
    changes   fields of ``tolerances.Accuracy`` by name, in place of those that the tolerance decides
    """
    cache.next_round()
    records = read(scene, options.tolerance, cache, straight, options.surfaces)
    estimator = ESTIMATORS[options.estimator]
    accuracy = replace(tolerances.accuracy(options.tolerance), **(changes or {}))
    if options.samples:
        accuracy = replace(accuracy, **{estimator.samples_field: options.samples}, adapts=False)
    culling = CULLINGS[options.culling]
    on_triangles = estimator, culling
    on_beams = estimator.of_beams is not None and culling.of_beams is not None
    if accuracy.cells > 0 and on_beams:
        estimator, culling = estimator.of_beams, culling.of_beams
    drawn = any(emitter.drawn for emitter in records.emitters)
    return Prepared(
        scene=records, given=scene, accuracy=accuracy, estimator=estimator, culling=culling, on_triangles=on_triangles,
        light_samples=options.light_samples, cache=cache, structures=Structures(records, cache, accuracy),
        sequence=Sequence(seed()) if drawn else None, light_bounces=options.light_bounces if on_beams else None,
    )  # fmt: skip

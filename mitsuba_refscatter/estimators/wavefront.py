"""The wavefront over camera segments: traverse the culling's tree, filter the pairs, solve and accumulate.

Segments go in, radiance comes out. Each stage is one kernel per chunk. The chunks are as long as the buffer of pairs
allows: a chunk whose pairs do not fit is traversed again in smaller ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi

from .. import tolerances
from ..core import arrays
from ..culling.bundles import Bundles, bundles_of
from ..culling.pairs import Pairs
from ..culling.protocol import Culling
from ..estimators.accumulator import Sums
from ..geometry import bvh
from ..light.illumination import Illumination
from ..transport.segments import LocalSegments
from .chord import may_meet
from .protocol import Estimator


@dataclass
class Counts:
    """Work done, in numbers.

    segments    camera segments
    leaves      (segment, leaf) pairs that the trees' traversal found
    samples     camera samples
    unresolved  those samples of which light paths that were not found bring more than the tolerance of their radiance
    radiance    sum of all that was found
    errors      what of it may be wrong, by light: one that is the same in all passes, or one of a pass
    """

    segments: int = 0
    leaves: int = 0
    samples: int = 0
    unresolved: int = 0
    radiance: float = 0.0
    errors: dict = field(default_factory=dict)

    def found(self, light, radiance, estimate):
        """Adds radiance (float) of a light, of which the share ``estimate`` may be wrong. ``light``: a key, or None
        for one whose errors no other shares."""
        self.radiance += radiance
        light = len(self.errors) if light is None else ("the same", light)
        self.errors[light] = self.errors.get(light, 0.0) + estimate * radiance

    @property
    def estimated_error(self):
        """Relative L1 error that is expected of the image: errors of different lights are independent."""
        return sum(x * x for x in self.errors.values()) ** 0.5 / self.radiance if self.radiance > 0 else 0.0

    def add(self, other):
        """Adds the work of another render."""
        self.segments += other.segments
        self.leaves += other.leaves

    def saw(self, samples, unresolved):
        """Adds camera samples, and of which the light paths are ``unresolved`` (Bool)."""
        self.samples += samples
        self.unresolved += int(dr.count(unresolved)[0])


@dataclass
class Pace:
    """How many bundles of segments are traversed at once.

    Goes on from light to light and from pass to pass, as their pairs are about as many.

    bundles  in the next chunk; 0 at first for ``tolerances.FIRST_CHUNK``
    """

    bundles: int = 0

    def __post_init__(self):
        self.bundles = self.bundles or tolerances.FIRST_CHUNK

    def slower(self, size, found):
        """After ``size`` bundles had too many pairs, ``found``."""
        self.bundles = max(1, min(size - 1, _fitting(size, found)))

    def next(self, size, found):
        """After ``size`` bundles had ``found`` pairs.

        Neighbouring bundles are alike, distant ones are not: it grows step by step.
        """
        self.bundles = min(
            tolerances.CHUNK_BUNDLES, _fitting(size, found), max(tolerances.CHUNK_GROWTH * size, self.bundles)
        )


@dataclass
class Run:
    """How a wavefront is gone through.

    accuracy  ``tolerances.Accuracy``
    pace      goes on from one run to the next
    seed      of random numbers, where the estimator draws any
    detail    whether pairs are counted
    progress  called per chunk with the share that is done, 0 to 1; or None
    """

    accuracy: tolerances.Accuracy
    pace: Pace = field(default_factory=Pace)
    seed: int = 0
    detail: bool = False
    progress: Callable | None = None

    def part(self, start, end):
        """A run of a part of the work, between two shares of it, 0 to 1."""
        whole = self.progress
        return replace(self, progress=None if whole is None else lambda x: whole(start + (end - start) * x))


def scatter(segments, culling, illumination, estimator, run):
    """Single scattering along every segment by one light: (``Sums``, ``Counts``).

    segments      ``LocalSegments``
    culling       ``culling.protocol.Culling`` of the boundary
    illumination  ``Illumination``, its light one or one for each segment
    estimator     ``protocol.Estimator``
    run           ``Run``

    Raises ``ValueError`` for one light per segment where the culling is made for one light.
    """
    if culling.for_one_light and dr.width(illumination.light.L) > 1:
        raise ValueError(
            'refscatter: culling "beams" is made for one light point, not for one per segment: use "spindle"'
        )
    queries = estimator.queries(segments, illumination, run.accuracy, run.seed)
    if queries is None:
        return sweep(segments, culling, illumination, estimator, run)
    sums, counts = Sums.nothing(len(segments), run.detail), Counts(segments=len(segments))
    for query in queries:
        found, more = sweep(query.points, culling, illumination.at(query.index), estimator, run.part(*query.done))
        sums.add_all(found, query.weight, query.index)
        counts.leaves += more.leaves
    return sums.first(len(segments)), counts


def sweep(segments, culling, illumination, estimator, run):
    """``scatter`` with all segments as they are."""
    n = len(segments)
    sums, counts = Sums.nothing(n, run.detail), Counts(segments=n)
    bundles = bundles_of(segments, culling.bundle, culling.width)
    work = Work(sums, segments, bundles, culling, illumination, run.accuracy, estimator)
    n_bundles = len(bundles)
    for lane, leaf, found, done in chunks(n_bundles, work.traverse, run.pace):
        counts.leaves += found
        if found > 0:
            whole, parts = work.filter(lane, leaf, found)
            work.solve(whole)
            work.refine(parts)
        if run.progress is not None:
            run.progress(done / n_bundles)
    return sums.first(n), counts


def chunks(n, traverse, pace):
    """Takes ``n`` bundles (or single segments) through a tree, as many at once as the buffer holds pairs of.

    n         int
    traverse  (start, size): as ``bvh.traverse`` with ``size`` bundles from ``start`` on
    pace      ``Pace``

    Yields the traversal's ``(bundle, leaf, found)`` and the number of bundles that are done.
    """
    start = 0
    while start < n:
        size = min(pace.bundles, n - start)
        lane, leaf, found = traverse(start, size)
        if found > tolerances.CHUNK_PAIRS:
            if size == 1:
                raise RuntimeError(
                    f"refscatter: a bundle of camera segments meets {found} leaves of a tree, the buffer holds "
                    f"{tolerances.CHUNK_PAIRS}; raise tolerances.CHUNK_PAIRS"
                )
            pace.slower(size, found)
            continue
        pace.next(size, found)
        start += size
        yield lane, leaf, found, start


def gather(segments, cloud, phase, directed, pace):
    """Radiance (Spectrum per segment, per sigma_s) that photons scatter along every segment.

    segments  ``LocalSegments``
    cloud     ``estimators.photons.Cloud``
    phase     phase function (omega, d), 1/sr
    directed  extinction (omega, d) along omega relative to that along d, or None where it is the same
    pace      ``Pace``
    """
    n = len(segments)
    value = dr.zeros(mi.Spectrum, arrays.room(n))

    def traverse(start, size):
        index = dr.opaque(mi.UInt32, start) + dr.arange(mi.UInt32, size)
        return bvh.traverse(cloud.tree, index, cloud.node_test(segments.gather(index)), tolerances.CHUNK_PAIRS)

    for lane, leaf, found, _ in chunks(n, traverse, pace):
        if found > 0:
            i = dr.arange(mi.UInt32, found)
            cloud.add(value, segments, arrays.gather(lane, i), arrays.gather(leaf, i), phase, directed)
    return dr.gather(mi.Spectrum, value, dr.arange(mi.UInt32, n))


@dataclass
class Work:
    """The stages: finding pairs, solving them, and cutting beams where they are too complicated for a segment.

    sums          what is found is added to them
    segments      camera segments, body coordinates
    bundles       of these
    culling       of the boundary
    illumination  of the boundary, its light one or one for each segment
    accuracy      what the option ``tolerance`` selects
    estimator     how pairs are summed
    """

    sums: Sums
    segments: LocalSegments
    bundles: Bundles
    culling: Culling
    illumination: Illumination
    accuracy: tolerances.Accuracy
    estimator: Estimator

    def traverse(self, start, size):
        """The (bundle, leaf) pairs of ``size`` bundles from number ``start`` on, as ``bvh.traverse`` gives them."""
        index = dr.opaque(mi.UInt32, start) + dr.arange(mi.UInt32, size)
        bundles = self.bundles.gather(index)
        hit = self.culling.node_test(bundles, self.illumination.at(bundles.first))
        return bvh.traverse(self.culling.tree, index, hit, tolerances.CHUNK_PAIRS)

    def filter(self, lane, leaf, found):
        """The (segment, beam) pairs that can be solved whole, and those whose beams must be cut: two ``Pairs``.

        lane, leaf  UInt32, (bundle, leaf) pairs
        found       int, how many of these there are
        """
        place, bundles = dr.arange(mi.UInt32, found * bvh.LEAF), self.bundles
        bundle = arrays.gather(lane, place // bvh.LEAF)
        if bundles.most > 1:  # first those of which no segment may meet the beam are left out
            item = arrays.gather(leaf, place // bvh.LEAF) * bvh.LEAF + (place & (bvh.LEAF - 1))
            (place,) = arrays.chosen((self.culling.near(item, bundles.gather(bundle)),))
            if dr.width(place) == 0:
                return [bundles.pairs(lane, leaf, place)] * 2
            bundle = arrays.gather(lane, place // bvh.LEAF)
        pairs = bundles.pairs(lane, leaf, place * dr.opaque(mi.UInt32, bundles.most))
        count, taken, masks = arrays.gather(bundles.count, bundle), None, []
        for j in range(bundles.most):
            active, zeros, bent, taken = self.classify(pairs, taken, j < count)
            self.sums.look_at(pairs, zeros.possible if self.culling.for_one_light else active)
            masks.append((zeros.bracketed & ~bent, zeros.possible & bent))
            pairs = Pairs(pairs.segment + 1, pairs.beam)
        return [bundles.pairs(lane, leaf, self._number(place, index)) for index in arrays.chosen(*zip(*masks))]

    def _number(self, place, index):
        """Numbers of pairs (``Bundles.pairs``) from those in a list of places, each with all segments of a bundle."""
        if dr.width(index) == 0:
            return index
        most = dr.opaque(mi.UInt32, self.bundles.most)
        at = index // most
        return arrays.gather(place, at) * most + (index - at * most)

    def classify(self, pairs, taken=None, active=True):
        """``(exists, zeros, bent, taken)`` of pairs.

        ``exists``: Bool; ``zeros``: ``culling.beam.Zeros``; ``bent``: Bool, which are too complicated; ``taken``:
        ``culling.pairs.Taken``.

        pairs   ``Pairs``
        taken   of them, if that is known already
        active  Bool, those that are asked for
        """
        segment, illumination = self.segments.gather(pairs.segment, active), self.illumination.at(pairs.segment)
        exists = self.culling.plausible(pairs, segment, illumination) & active
        taken = taken or self.culling.take(pairs, illumination, exists)
        zeros = self.estimator.classify(taken.piece, segment)
        zeros.possible &= exists
        zeros.bracketed &= exists
        bent = zeros.nonlinearity > dr.opaque(mi.Float, self.accuracy.linear)
        return exists, zeros, bent | taken.coarse if self.estimator.needs_fine else bent, taken

    def solve(self, pairs):
        """Accumulates the pairs, and where the curve is too complicated the parts into which it is cut."""
        todo = [pairs]
        while todo:
            part = todo.pop()
            if len(part) > tolerances.PIECES and (part.tau0 is not None or part.code is not None):
                todo += part.halves()
            elif len(part) > 0:
                rest = self.estimator.accumulate(
                    self.sums, part, self.segments, self.culling, self.illumination, self.accuracy
                )
                if rest is not None and len(rest) > 0:
                    todo.append(rest)

    def refine(self, pairs):
        """Cuts the beams of ``pairs`` into parts until g is close to linear on them, and solves these."""
        if len(pairs) == 0:
            return
        zero = dr.zeros(mi.UInt32, len(pairs))
        open_parts, solvable = [Pairs(pairs.segment, pairs.beam, zero, zero)], []
        while open_parts:
            part = open_parts.pop()
            if len(part) > tolerances.PIECES // 4:
                open_parts += part.halves()
                continue
            for parts, found in zip((solvable, open_parts), self._quarter(part)):
                if len(found) > 0:
                    parts.append(found)
            if sum(map(len, solvable)) > tolerances.PIECES or (solvable and not open_parts):
                self.solve(Pairs(*(arrays.concat(x) for x in list(zip(*(vars(p).values() for p in solvable)))[:4])))
                solvable = []

    def _quarter(self, part):
        """Of the four parts of each part: those that can be solved, and those that must be cut again."""
        quarters = part.quarters()
        _, zeros, bent, taken = self.classify(quarters)
        bent &= quarters.level < self.culling.most_levels
        solvable, go_on = zeros.bracketed & ~bent, zeros.possible & bent
        go_on &= may_meet(taken.piece, self.segments.gather(quarters.segment))
        dr.eval(quarters.code, quarters.level, quarters.segment, quarters.beam, solvable, go_on)
        return quarters.gather(dr.compress(solvable)), quarters.gather(dr.compress(go_on))


def _fitting(size, found):
    """Bundles whose pairs should fill ``tolerances.FILLED`` of the buffer, judged by ``size`` that had ``found``."""
    return int(tolerances.FILLED * size * tolerances.CHUNK_PAIRS / max(found, 1)) + 1

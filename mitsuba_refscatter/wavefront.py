"""The wavefront over camera segments: traverse the beams' tree, filter the pairs, solve and accumulate.

Segments go in, radiance comes out. Each stage is one kernel per chunk; the chunks are as long as the
buffer of pairs allows: a chunk whose pairs do not fit is traversed again in two halves.
"""

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from . import tolerances
from .culling import beams as light_beams
from .estimators import curve
from .geometry import bvh


@dataclass
class Segments:
    """Camera segments inside one body, in body coordinates: ``o + t d``, 0 < t < t_max.

    ``sigma_t``: extinction, a Spectrum of width 1 or one per segment.
    """

    o: object
    d: object
    t_max: object
    sigma_t: object

    def gather(self, index, active=True):
        """Geometry of the segments at ``index``."""
        return replace(self, o=dr.gather(type(self.o), self.o, index, active),
                       d=dr.gather(type(self.d), self.d, index, active),
                       t_max=dr.gather(type(self.t_max), self.t_max, index, active))  # fmt: skip

    def sigma_t_of(self, index):
        if dr.width(self.sigma_t) == 1:
            return self.sigma_t
        return dr.gather(type(self.sigma_t), self.sigma_t, index)

    @property
    def inverse_d(self):
        """1 / d with zeros kept finite, for box tests."""
        return mi.Vector3f(*(dr.rcp(dr.select(dr.abs(x) < 1e-20, dr.mulsign(1e-20, x), x)) for x in self.d))

    def __len__(self):
        return dr.width(self.t_max)


@dataclass
class Counts:
    """Work done, for the AOVs and the benchmark: pairs per stage."""

    segments: int = 0
    leaves: int = 0
    candidates: int = 0

    def add(self, other):
        self.segments += other.segments
        self.leaves += other.leaves
        self.candidates += other.candidates


def scatter(segments, beams, records, lighting, accuracy, detail=False, progress=None):
    """Single scattering along every segment by one light. Returns (``curve.Sums``, candidates, ``Counts``).

    ``candidates``: pairs per segment, None unless ``detail``. ``progress(done, total)`` is called per chunk.
    """
    n = len(segments)
    sums = curve.Sums(dr.zeros(mi.Spectrum, n))
    candidates = None
    if detail:
        sums.contributions, sums.unresolved, candidates = (dr.zeros(mi.Float, n) for _ in range(3))
    counts = Counts(segments=n)
    chunk, start = tolerances.FIRST_CHUNK, 0
    while start < n:
        size = min(chunk, n - start)
        lane, leaf, found = _traverse(segments, beams, start, size)
        if found > tolerances.CHUNK_PAIRS:
            if size == 1:
                raise RuntimeError(f"refscatter: one camera segment meets {found} light beams' leaves, the buffer holds "
                                   f"{tolerances.CHUNK_PAIRS}; raise tolerances.CHUNK_PAIRS")  # fmt: skip
            chunk = max(1, min(size - 1, _fitting(size, found)))
            continue
        chunk = min(tolerances.CHUNK_SEGMENTS, _fitting(size, found))
        counts.leaves += found
        if found > 0:
            index, beam = light_beams.filter_pairs(beams, segments, lane, leaf, found)
            counts.candidates += dr.width(index)
            if dr.width(index) > 0:
                if detail:
                    dr.scatter_add(candidates, mi.Float(1), index)
                curve.accumulate(sums, index, beam, segments, beams, records, lighting, accuracy)
        start += size
        if progress is not None:
            progress(start, n)
    return sums, candidates, counts


def _fitting(size, found):
    """Segments whose pairs should fill 80 % of the buffer, judged by ``size`` that had ``found``."""
    return int(0.8 * size * tolerances.CHUNK_PAIRS / max(found, 1)) + 1


def _traverse(segments, beams, start, size):
    lanes = dr.opaque(mi.UInt32, start) + dr.arange(mi.UInt32, size)
    hit = light_beams.node_test(segments.gather(lanes))
    return bvh.traverse(beams.tree, lanes, hit, tolerances.CHUNK_PAIRS)

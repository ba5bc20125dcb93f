"""Newton's method for three equations in two unknowns that have a common root. Knows no optics."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


class Status(enum.IntEnum):
    """How a lane ended."""

    CONVERGED = 0
    LEFT = 1
    """outside the domain"""
    SINGULAR = 2
    """the columns of the Jacobian are parallel, or no step makes the residual smaller"""
    OUT_OF_ITERATIONS = 3
    NON_FINITE = 4


@dataclass(frozen=True)
class Limits:
    """Of the iteration, lengths in units of the unknowns.

    step        a root is found when the next step is shorter
    longest     longer steps are shortened to it
    iterations  evaluations of the system, at most
    parallel    square of the sine between the Jacobian's columns below which it is singular
    rounding    size of residuals that are rounding errors
    """

    step: float
    longest: float
    iterations: int
    parallel: float
    rounding: float


@dataclass
class Solution:
    """How each lane ended, in single or double precision.

    x           the two unknowns, Float each
    status      UInt32, ``Status``
    iterations  UInt32, number of evaluations
    """

    x: tuple[mi.Float, mi.Float]
    status: mi.UInt32
    iterations: mi.UInt32

    @property
    def converged(self):
        """Whether each lane's is a solution (Bool)."""
        return self.status == int(Status.CONVERGED)


@dataclass
class _State:
    """Of the loop, lane by lane.

    x        the two unknowns, Float each
    step     the next step, Float each
    size2    Float, square of the residual at ``x``
    verdict  UInt32, the ``Status``, or ``_GO_ON``
    count    UInt32, number of evaluations
    going    Bool, whether the lane goes on
    """

    x: tuple[mi.Float, mi.Float]
    step: tuple[mi.Float, mi.Float]
    size2: mi.Float
    verdict: mi.UInt32
    count: mi.UInt32
    going: mi.Bool


def solve(system, x, domain, limits, active=True):
    """The ``Solution`` of a system of equations.

    system  (x0, x1) -> (r, c0, c1): residual and its two derivatives (vectors of 3 numbers), always together
    x       (x0, x1), Float each: where to start
    domain  (x0, x1) -> Bool: where the iteration may be
    limits  ``Limits``
    active  Bool; other lanes are judged at their start and go no further

    Each step is that of the pseudo-inverse, -(J^T J)^-1 J^T r. Where the residual has grown it is taken back and
    halved.
    """
    UInt32 = dr.uint32_array_t(type(x[0]))
    r, c0, c1 = system(*x)
    size2, step, verdict = _judge(r, c0, c1, limits)
    x, verdict = _finish(x, step, verdict, domain)
    going = (verdict == _GO_ON) & active
    # Copies, for the loop changes its state.
    count = dr.full(UInt32, 1, dr.width(verdict))
    state = _State((x[0] + 0, x[1] + 0), step, size2, verdict, count, going)

    def body(state):
        (x0, x1), (s0, s1), going = state.x, state.step, state.going
        trial = (x0 + s0, x1 + s1)
        r, c0, c1 = system(*trial)
        trial_size2, (t0, t1), judged = _judge(r, c0, c1, limits)
        grown = ~(trial_size2 < state.size2)
        short = dr.square(s0) + dr.square(s1) < limits.step**2
        accept = going & ~grown
        trial, judged = _finish(trial, (t0, t1), judged, domain)
        x = dr.select(accept, trial[0], x0), dr.select(accept, trial[1], x1)
        size2 = dr.select(accept, trial_size2, state.size2)
        step = dr.select(accept, t0, 0.5 * s0), dr.select(accept, t1, 0.5 * s1)
        # No step makes it smaller: it is the root to within rounding, or there is none here.
        end = dr.select(size2 < limits.rounding**2, UInt32(int(Status.CONVERGED)), UInt32(int(Status.SINGULAR)))
        stuck = dr.select(short, end, UInt32(_GO_ON))
        verdict = dr.select(accept, judged, dr.select(going, stuck, state.verdict))
        count = state.count + 1
        going = going & (verdict == _GO_ON) & (count < limits.iterations)
        return (_State(x, step, size2, verdict, count, going),)

    (end,) = dr.while_loop((state,), lambda state: state.going, body, label="newton", mode="symbolic")
    status = dr.select(end.verdict == _GO_ON, int(Status.OUT_OF_ITERATIONS), end.verdict)
    return Solution(end.x, status, end.count)


def improve(system, x, steps, longest):
    """``x`` after some steps, taken without looking back: for a root that is near.

    system   as ``solve`` takes it
    x        (x0, x1), Float each
    steps    int, how many
    longest  float, no step is longer
    """
    for _ in range(steps):
        s, length, _ = _step(*system(*x), 0)
        shorter = dr.minimum(1, longest / dr.maximum(length, 1e-30))
        x = tuple(a + shorter * b for a, b in zip(x, s))
    return x


_GO_ON = 99
"""No status yet."""


def _step(r, c0, c1, parallel):
    """The step of the pseudo-inverse, its length, and whether the columns are parallel."""
    # (J^T J)^-1 J^T by cross products: |c0 x c1|^2 = det J^T J keeps its digits where the columns are nearly parallel.
    across = dr.cross(c0, c1)
    det = dr.squared_norm(across)
    singular = det <= parallel * dr.squared_norm(c0) * dr.squared_norm(c1)
    scale = -dr.rcp(dr.select(singular, 1, det))
    s = dr.dot(across, dr.cross(r, c1)) * scale, dr.dot(across, dr.cross(c0, r)) * scale
    return s, dr.sqrt(dr.square(s[0]) + dr.square(s[1])), singular


def _judge(r, c0, c1, limits):
    """Square of the residual, the next step, and the status that it ends with (or ``_GO_ON``)."""
    UInt32 = dr.uint32_array_t(type(r.x))
    (s0, s1), length, singular = _step(r, c0, c1, limits.parallel)
    size2 = dr.squared_norm(r)
    # A root, not a place where the residual is smallest: the step takes it away, but for its second-order part.
    left = dr.norm(r + s0 * c0 + s1 * c1)
    most = length * dr.sqrt(dr.maximum(dr.squared_norm(c0), dr.squared_norm(c1))) + limits.rounding
    found = (length < limits.step) & (left <= most)
    verdict = dr.select(found, UInt32(int(Status.CONVERGED)), UInt32(_GO_ON))
    verdict = dr.select(singular, int(Status.SINGULAR), verdict)
    verdict = dr.select(dr.isfinite(size2) & dr.isfinite(length), verdict, int(Status.NON_FINITE))
    shorter = dr.minimum(1, limits.longest / dr.maximum(length, 1e-30))
    return size2, (s0 * shorter, s1 * shorter), verdict


def _finish(x, step, verdict, domain):
    """Takes the last step of lanes that have converged; those outside the domain have left."""
    last = verdict == int(Status.CONVERGED)
    x = tuple(dr.select(last, a + s, a) for a, s in zip(x, step))
    ends = last | (verdict == _GO_ON)
    return x, dr.select(ends & ~domain(*x), int(Status.LEFT), verdict)

"""Newton's method on systems that have nothing to do with light."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mitsuba_refscatter.solve import newton
from mitsuba_refscatter.solve.newton import Limits, Status

LIMITS = Limits(step=1e-4, longest=1.0, iterations=20, parallel=1e-8, rounding=1e-7)
EVERYWHERE = lambda a, b: mi.Bool(True) | (a < a)  # noqa: E731


def run(system, x0, x1, domain=EVERYWHERE, limits=LIMITS, kind=None, **more):
    kind = kind or mi.Float
    start = tuple(kind(np.atleast_1d(np.asarray(x, float))) for x in (x0, x1))
    return newton.solve(system, start, domain, limits, **more)


def statuses(solution):
    return [Status(int(x)) for x in np.array(solution.status)]


def vector(x, *rest):
    return (mi.Vector3d if dr.type_v(x) == dr.VarType.Float64 else mi.Vector3f)(x, *rest)


def linear(rng, n):
    """Systems A x = A r with the roots r: matrices (n, 3, 2), roots (n, 2)."""
    A, roots = rng.normal(size=(n, 3, 2)), rng.uniform(-1, 1, (n, 2))
    c0, c1 = (mi.Vector3f(np.ascontiguousarray(A[:, :, k].T)) for k in range(2))
    r0, r1 = (mi.Float(roots[:, k]) for k in range(2))
    return (lambda a, b: (c0 * (a - r0) + c1 * (b - r1), c0, c1)), roots


def test_linear_systems_take_one_step(rgb):
    system, roots = linear(np.random.default_rng(1), 1000)
    solution = run(system, np.zeros(1000), np.zeros(1000), limits=Limits(1e-4, 10.0, 20, 1e-8, 1e-7))
    found = np.array(solution.status) == Status.CONVERGED
    assert found.mean() > 0.99  # the others' matrices are nearly singular
    error = np.abs(np.stack([np.array(x) for x in solution.x], 1) - roots)[found]
    assert error.max() < 1e-4 and np.median(np.array(solution.iterations)) == 2


def circle_and_line(a, b):
    """a^2 + b^2 = 1 and a = b, and their sum: roots at +-(1, 1) / sqrt 2."""
    f, g = a * a + b * b - 1, a - b
    return vector(f, g, f + g), vector(2 * a, 1 + 0 * a, 2 * a + 1), vector(2 * b, -1 + 0 * b, 2 * b - 1)


@pytest.mark.parametrize("precision", ["single", "double"])
def test_quadratic_convergence_to_the_root_nearby(rgb, precision):
    kind = mi.Float if precision == "single" else mi.Float64
    solution = run(circle_and_line, [0.5, -2.0, 1.5], [0.9, -1.0, 0.1], kind=kind)
    assert statuses(solution) == [Status.CONVERGED] * 3
    error = [np.abs(np.array(x) * np.sqrt(2) - [1, -1, 1]).max() for x in solution.x]
    assert max(error) < (1e-6 if precision == "single" else 1e-8)
    assert np.array(solution.iterations).max() <= 8


def test_damping_where_newton_diverges(rgb):
    """atan: the full step from |x| > 1.4 leads away, ever further; halved it comes back."""

    def system(a, b):
        slope = 1 / (1 + a * a)
        return vector(dr.atan(a), b, 0 * a), vector(slope, 0 * a, 0 * a), vector(0 * a, 1 + 0 * a, 0 * a)

    solution = run(system, [1.5, 3.0, -8.0], [0.3, -0.2, 0.1], limits=Limits(1e-4, 100.0, 40, 1e-8, 1e-7))
    assert statuses(solution) == [Status.CONVERGED] * 3
    assert np.abs(np.array(solution.x[0])).max() < 1e-4


def test_statuses(rgb):
    """Each way to end: outside the domain, parallel columns, no root, too few iterations, not a number."""
    inside = lambda a, b: (dr.abs(a) < 0.5) & (dr.abs(b) < 0.5)  # noqa: E731
    assert statuses(run(circle_and_line, 0.4, 0.4, inside)) == [Status.LEFT]

    def parallel(a, b):
        return (
            vector(a + b - 1, a + b - 1, a - a),
            vector(1 + 0 * a, 1 + 0 * a, 0 * a),
            vector(1 + 0 * a, 1 + 0 * a, 0 * a),
        )

    assert statuses(run(parallel, 0.1, 0.2)) == [Status.SINGULAR]

    def without_root(a, b):
        """|r| is smallest, 1, at the origin."""
        return vector(a, b, 1 + a * a + b * b), vector(1 + 0 * a, 0 * a, 2 * a), vector(0 * a, 1 + 0 * a, 2 * b)

    assert statuses(run(without_root, 0.1, 0.2))[0] in (Status.SINGULAR, Status.OUT_OF_ITERATIONS)
    assert statuses(run(circle_and_line, 30.0, -40.0, limits=Limits(1e-4, 0.1, 5, 1e-8, 1e-7))) == [
        Status.OUT_OF_ITERATIONS
    ]

    def root(a, b):
        return (
            vector(dr.sqrt(a), b, 0 * a),
            vector(0.5 / dr.sqrt(a), 0 * a, 0 * a),
            vector(0 * a, 1 + 0 * a, 0 * a),
        )

    assert statuses(run(root, -1.0, 0.0)) == [Status.NON_FINITE]


def test_lanes_are_independent(rgb):
    """Each lane ends as it would alone; lanes that are not active are left alone."""
    a, b = [0.5, 30.0, -2.0, 0.9], [0.9, -40.0, -1.0, 0.9]
    limits = Limits(1e-4, 0.5, 12, 1e-8, 1e-7)
    together = run(circle_and_line, a, b, limits=limits, active=mi.Bool([True, True, True, False]))
    for k in range(3):
        alone = run(circle_and_line, a[k], b[k], limits=limits)
        assert np.array(together.status)[k] == np.array(alone.status)[0]
        assert np.array(together.iterations)[k] == np.array(alone.iterations)[0]
        for x, y in zip(together.x, alone.x):
            np.testing.assert_allclose(np.array(x)[k], np.array(y)[0], rtol=1e-6)
    assert statuses(together)[3] == Status.OUT_OF_ITERATIONS
    assert [float(x[3]) for x in together.x] == pytest.approx([0.9, 0.9])

"""The bounded local search against SciPy's and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from aero_bayes.estimate.climb import LocalSettings, Products, Stop, bounded_step, search


def test_bounded_step_agrees_with_bvls() -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        p = int(rng.integers(1, 8))
        a = rng.normal(size=(p + 3, p))
        b = rng.normal(size=p + 3) * 3.0
        low, high = -rng.exponential(0.5, p), rng.exponential(0.5, p)
        low[rng.random(p) < 0.2] = 0.0
        high[rng.random(p) < 0.2] = 1e-9
        step = bounded_step(a.T @ a, a.T @ b, low, high)
        reference = lsq_linear(a, -b, bounds=(low, high), method="bvls", tol=1e-14).x
        np.testing.assert_allclose(a @ step, a @ reference, atol=1e-7)
        assert np.all((step >= low) & (step <= high))


def rosenbrock(x: np.ndarray) -> np.ndarray:
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0], 0.3 * (x[2] - x[0] * x[1])])


def rosenbrock_jacobian(x: np.ndarray) -> np.ndarray:
    return np.array([[-20.0 * x[0], 10.0, 0.0], [-1.0, 0.0, 0.0], [-0.3 * x[1], -0.3 * x[0], 0.3]])


def products(points: np.ndarray) -> Products:
    r = np.array([rosenbrock(x) for x in points])
    j = np.array([rosenbrock_jacobian(x) for x in points])
    return Products(0.5 * np.sum(r**2, axis=1), np.einsum("kij,ki->kj", j, r), np.einsum("kia,kib->kab", j, j))


@pytest.mark.parametrize(
    ("low", "high"),
    [([-5.0] * 3, [5.0] * 3), ([-5.0, -5.0, -5.0], [0.7, 5.0, 5.0]), ([-1.5, 0.2, -0.5], [0.8, 0.5, 0.1])],
)
def test_agrees_with_scipy_trust_region_reflective(low: list[float], high: list[float]) -> None:
    low, high = np.array(low), np.array(high)
    rng = np.random.default_rng(2)
    starts = low + rng.random((6, 3)) * (high - low)
    result = search(
        products, starts, low, high, LocalSettings(max_iterations=200, tolerance=1e-20, relative_tolerance=0)
    )
    reference = [least_squares(rosenbrock, s, rosenbrock_jacobian, (low, high), xtol=1e-15, gtol=1e-15) for s in starts]
    best = min(r.cost for r in reference)
    assert result.cost[result.best] <= best + 1e-9
    np.testing.assert_allclose(result.points[result.best], min(reference, key=lambda r: r.cost).x, atol=2e-5)
    assert result.reasons[result.best].converged


def test_cost_first_takes_the_same_path() -> None:
    low, high = np.full(3, -3.0), np.full(3, 3.0)
    starts = np.array([[-1.2, 1.0, 0.0], [2.0, -2.0, 1.0]])
    plain = search(products, starts, low, high)
    cheap = search(products, starts, low, high, cost=lambda x: products(x).cost)
    np.testing.assert_array_equal(plain.points, cheap.points)


def test_failures_are_walls_and_a_failed_start_is_said() -> None:
    def walled(points: np.ndarray) -> Products:
        full = products(points)
        full.cost[points[:, 0] > 0.5] = np.nan
        return full

    result = search(walled, np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]), np.full(3, -3.0), np.full(3, 3.0))
    assert result.reasons[1] is Stop.FAILED_START
    assert np.isfinite(result.cost[0])
    assert result.points[0, 0] <= 0.5
    assert result.failures >= 1


def test_a_column_without_effect_stays_where_it_is() -> None:
    def blind(points: np.ndarray) -> Products:
        full = products(points)
        gradient = np.concatenate([full.gradient, np.zeros((len(points), 1))], axis=1)
        hessian = np.zeros((len(points), 4, 4))
        hessian[:, :3, :3] = full.hessian
        return Products(full.cost, gradient, hessian)

    def four(points: np.ndarray) -> Products:
        return blind(points[:, :3])

    result = search(four, np.array([[-1.0, 1.0, 0.0, 0.25]]), np.full(4, -3.0), np.full(4, 3.0))
    assert result.points[0, 3] == 0.25
    np.testing.assert_allclose(result.points[0, :3], 1.0, atol=1e-4)

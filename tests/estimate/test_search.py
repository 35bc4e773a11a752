"""The bounded local search against SciPy's and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from aero_bayes.estimate.levenberg_marquardt import (
    CostShape,
    FixedCost,
    LocalSettings,
    QuadraticModel,
    Stop,
    bounded_step,
    levenberg_marquardt,
)

pytestmark = pytest.mark.fast


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


def quadratic(point: np.ndarray) -> QuadraticModel:
    r, j = rosenbrock(point), rosenbrock_jacobian(point)
    return QuadraticModel(0.5 * float(r @ r), j.T @ r, j.T @ j)


TIGHT = LocalSettings(iterations=200, tolerance=1e-20, relative_tolerance=0)


@pytest.mark.parametrize(
    ("low", "high"),
    [([-5.0] * 3, [5.0] * 3), ([-5.0, -5.0, -5.0], [0.7, 5.0, 5.0]), ([-1.5, 0.2, -0.5], [0.8, 0.5, 0.1])],
)
def test_agrees_with_scipy_trust_region_reflective(low: list[float], high: list[float]) -> None:
    low, high = np.array(low), np.array(high)
    rng = np.random.default_rng(2)
    starts = low + rng.random((6, 3)) * (high - low)
    found = min((levenberg_marquardt(FixedCost(quadratic), s, low, high, TIGHT) for s in starts), key=lambda f: f.cost)
    reference = [least_squares(rosenbrock, s, rosenbrock_jacobian, (low, high), xtol=1e-15, gtol=1e-15) for s in starts]
    best = min(reference, key=lambda r: r.cost)
    assert found.cost <= best.cost + 1e-9
    np.testing.assert_allclose(found.point, best.x, atol=2e-5)
    assert found.reason.converged


def test_failures_are_walls_and_a_failed_start_is_said() -> None:
    walls = []

    def walled(point: np.ndarray) -> QuadraticModel | None:
        if point[0] > 0.5:
            walls.append(point)
            return None
        return quadratic(point)

    low, high = np.full(3, -3.0), np.full(3, 3.0)
    found = levenberg_marquardt(FixedCost(walled), np.zeros(3), low, high)
    assert walls
    assert found.evaluations > len(walls)
    # Next to the wall, where the valley's floor ends.
    assert 0.45 < found.point[0] <= 0.5
    np.testing.assert_allclose(found.point[1], found.point[0] ** 2, atol=0.02)
    failed = levenberg_marquardt(FixedCost(walled), np.ones(3), low, high)
    assert failed.reason is Stop.FAILED_START
    assert failed.quadratic is None
    assert failed.cost == np.inf
    np.testing.assert_array_equal(failed.point, np.ones(3))


def test_a_start_is_brought_inside_and_no_evaluation_leaves_the_box() -> None:
    seen = []

    def watched(point: np.ndarray) -> QuadraticModel:
        seen.append(point.copy())
        return quadratic(point)

    low, high = np.array([-0.5, 0.1, 0.0]), np.array([0.6, 0.3, 0.0])
    found = levenberg_marquardt(FixedCost(watched), np.full(3, 9.0), low, high, TIGHT)
    assert np.all((np.array(seen) >= low) & (np.array(seen) <= high))
    assert found.point[2] == 0.0
    reference = least_squares(
        lambda x: rosenbrock(np.array([*x, 0.0])), [0.5, 0.2], bounds=(low[:2], high[:2]), xtol=1e-15, gtol=1e-15
    )
    assert found.cost <= reference.cost + 1e-9
    np.testing.assert_allclose(found.point[:2], reference.x, atol=2e-5)


def test_noise_estimated_between_steps_converges_with_the_parameters() -> None:
    """Mean and width of a normal sample in turn: steps change the mean, the noise update changes the width."""
    sample = np.random.default_rng(3).normal(2.0, 0.7, 50)

    class Sample:
        sd = 10.0

        def evaluate(self, point: np.ndarray) -> QuadraticModel:
            z = (sample - point[0]) / self.sd
            cost = 0.5 * float(z @ z) + sample.size * np.log(self.sd)
            self.at = point
            return QuadraticModel(cost, np.array([-z.sum() / self.sd]), np.array([[sample.size / self.sd**2]]))

        def update_noise(self, here: QuadraticModel) -> QuadraticModel:
            self.sd = float(np.sqrt(np.mean((sample - self.at[0]) ** 2)))
            return self.evaluate(self.at)

    cost_function = Sample()
    found = levenberg_marquardt(cost_function, np.array([-4.0]), np.array([-9.0]), np.array([9.0]))
    assert found.point[0] == pytest.approx(sample.mean(), abs=1e-3)
    assert cost_function.sd == pytest.approx(sample.std(), rel=1e-3)
    assert found.reason.converged


def kinked(point: np.ndarray) -> QuadraticModel:
    """A valley along y = 1 + x that ends at a wall on the left of every whole x; at the wall its slope is the valley's.

    What is lost beyond the wall is far more than the valley promises there.
    """
    x, y = point
    gap = y - 1.0 - x
    gradient = np.array([2.0 - 40.0 * gap, 40.0 * gap])
    beyond = 1e4 * max(math.floor(3.0 + 1e-9) - x, 0.0)
    return QuadraticModel(2.0 * x + 20.0 * gap**2 + beyond, gradient, np.array([[41.0, -40.0], [-40.0, 40.0]]))


def test_a_kink_ends_what_goes_across_it_and_not_the_search() -> None:
    start, box = np.array([3.0, 0.0]), (np.array([0.0, -9.0]), np.array([9.0, 9.0]))
    few = LocalSettings(max_rejections=6)
    assert levenberg_marquardt(FixedCost(kinked), start, *box, few).point == pytest.approx(start, abs=0.1)
    shape = CostShape(lambda p: (np.array([3.0, -np.inf]), np.array([4.0, np.inf])))
    cell = levenberg_marquardt(FixedCost(kinked), start, *box, few, shape=shape)
    assert cell.point == pytest.approx([3.0, 4.0])
    assert cell.reason.converged


def test_who_leaves_the_wall_is_confined_no_more() -> None:
    def valley(point: np.ndarray) -> QuadraticModel:
        """Falls towards (5.5, 1), but for a wall at x = 3, beside which x seems to fall until y is right."""
        x, y = point
        slope = 50.0 if abs(y - 1.0) > 0.5 else x - 5.5
        cost = 0.5 * (x - 5.5) ** 2 + 0.5 * (y - 1.0) ** 2 + (1e4 if x < 3.0 else 0.0)
        return QuadraticModel(cost, np.array([slope, y - 1.0]), np.eye(2))

    def cells(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        first = np.floor(point[0])
        return np.array([first, -np.inf]), np.array([first + 1.0 - 1e-6, np.inf])

    box = np.array([0.0, -9.0]), np.array([9.0, 9.0])
    found = levenberg_marquardt(FixedCost(valley), np.array([3.0, 0.0]), *box, shape=CostShape(cells))
    assert found.point == pytest.approx([5.5, 1.0], abs=1e-3)


def test_a_valley_that_is_straight_in_the_values_is_walked_at_once() -> None:
    """Two terms of nearly the same shape: one of them goes, by orders of magnitude, while the other comes."""
    t = np.linspace(1.0, 1.5, 50)
    design = np.stack([t**2, t, np.ones_like(t)], axis=1)
    read = design @ np.array([1e-4, 1.0, 0.5])

    def quadratic(point: np.ndarray) -> QuadraticModel:
        values = np.array([math.exp(point[0]), point[1], point[2]])
        slopes = design * np.array([values[0], 1.0, 1.0])
        residual = (design @ values - read) / 1e-3
        return QuadraticModel(0.5 * float(residual @ residual), slopes.T @ residual / 1e-3, slopes.T @ slopes / 1e-6)

    box = np.array([math.log(1e-4), -9.0, -9.0]), np.array([math.log(10.0), 9.0, 9.0])
    start = np.array([0.0, -1.1, 1.6])
    many, shape = LocalSettings(iterations=200), CostShape(logarithmic=np.array([True, False, False]))
    bent = levenberg_marquardt(FixedCost(quadratic), start, *box, many)
    straight = levenberg_marquardt(FixedCost(quadratic), start, *box, many, shape=shape)
    assert straight.evaluations < 0.5 * bent.evaluations
    assert straight.cost < 1.0
    assert straight.point[1:] == pytest.approx([1.0, 0.5], abs=0.02)

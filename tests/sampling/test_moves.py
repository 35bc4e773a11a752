"""One statistical test for every move: it must leave known distributions as they are.

The walkers start from exact draws; after some steps every marginal and every second moment must still be right. The
statistics are compared over independent ensembles, so that correlation within one does not matter. Bounds of 5
standard errors with 15 degrees of freedom and more: false alarms below 1e-4 a comparison.
"""

from __future__ import annotations

from collections.abc import Callable

import emcee
import numpy as np
import pytest
from emcee.moves import StretchMove
from scipy import stats

from aero_bayes.estimate.adaptation import (
    Surrogate,
    SurrogateDensity,
    independence_acceptance,
    log_prior_of,
    scan_axes,
    steps_to_leave,
)
from aero_bayes.estimate.moves import (
    DelayedAcceptanceMove,
    DelayedAcceptanceWalkMove,
    DifferentialMove,
    IndependenceMove,
    TriangularMap,
    WarpedStudentT,
)

ENSEMBLES, STEPS = 40, 60
CORRELATED = np.array([[1.0, 0.95, 0.3], [0.95, 1.0, 0.2], [0.3, 0.2, 2.0]])


class Gaussian:
    """Any covariance."""

    def __init__(self, covariance: np.ndarray) -> None:
        self.factor = np.linalg.cholesky(covariance)
        self.d = len(covariance)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        z = np.linalg.solve(self.factor, x.T)
        return -0.5 * np.sum(z**2, axis=0)

    def draw(self, rng: np.random.Generator, n: int) -> np.ndarray:
        return rng.normal(size=(n, self.d)) @ self.factor.T


class Truncated(Gaussian):
    """The part of a correlated Gaussian with a positive first coordinate and a small second."""

    def __init__(self) -> None:
        super().__init__(CORRELATED)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        return np.where((x[:, 0] > 0.0) & (x[:, 1] < 1.0), super().__call__(x), -np.inf)

    def draw(self, rng: np.random.Generator, n: int) -> np.ndarray:
        x = super().draw(rng, 4 * n + 100)
        return x[(x[:, 0] > 0.0) & (x[:, 1] < 1.0)][:n]


TARGETS = {
    "gaussian": Gaussian(np.diag([1.0, 4.0, 0.01])),
    "correlated": Gaussian(CORRELATED),
    "truncated": Truncated(),
}
#: A surrogate with wrong mean, widths and correlations: moves must be exact in spite of it.
POOR = WarpedStudentT.of(np.array([0.4, 0.2, -0.3]), np.diag([1.5, 1.0, 1.0]), 5.0)
MOVES: dict[str, Callable[[], list[tuple[object, float]]]] = {
    "independence": lambda: [(IndependenceMove(WarpedStudentT.of(np.full(3, 0.3), 1.5 * np.eye(3), 5.0)), 1.0)],
    "differential": lambda: [(DifferentialMove(), 1.0)],
    "delayed acceptance": lambda: [
        (DelayedAcceptanceMove(POOR.log_density, WarpedStudentT.of(np.zeros(3), 2.0 * np.eye(3), 4.0), 6), 1.0)
    ],
    "delayed acceptance walk": lambda: [
        (DelayedAcceptanceWalkMove(POOR.log_density, WarpedStudentT.of(np.zeros(3), CORRELATED), 3), 1.0)
    ],
    "mixture": lambda: [
        (IndependenceMove(WarpedStudentT.of(np.zeros(3), CORRELATED)), 0.6),
        (DifferentialMove(), 0.25),
        (StretchMove(), 0.15),
    ],
}


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("move", MOVES)
def test_move_keeps_its_target(move: str, target: str) -> None:
    density, walkers = TARGETS[target], 14
    rng = np.random.default_rng([len(move), len(target)])
    moments, first = [], []
    middle = np.median(density.draw(np.random.default_rng(99), 20000), axis=0)
    moved = 0
    for child in rng.spawn(ENSEMBLES):
        start = density.draw(child, walkers)
        state = emcee.State(start, random_state=np.random.RandomState(child.integers(2**32)).get_state())
        sampler = emcee.EnsembleSampler(walkers, density.d, density, moves=MOVES[move](), vectorize=True)
        visited = []
        for now in sampler.sample(state, iterations=STEPS, store=False):
            visited.append(now.coords.copy())
        x = np.concatenate(visited)
        moved += int(np.sum(np.any(np.diff(np.array(visited), axis=0) != 0, axis=2)))
        moments.append(np.concatenate([x.mean(axis=0), (x[:, :, None] * x[:, None, :]).mean(axis=0).ravel()]))
        first.append(np.mean(x < middle, axis=0))
    exact = density.draw(np.random.default_rng(7), 400_000 if target != "truncated" else 60_000)
    truth = np.concatenate([exact.mean(axis=0), (exact[:, :, None] * exact[:, None, :]).mean(axis=0).ravel()])
    error = np.sqrt(np.var(moments, axis=0, ddof=1) / ENSEMBLES + exact.var(axis=0).max() / len(exact))
    score = (np.mean(moments, axis=0) - truth) / error
    assert np.all(np.abs(score) < stats.t.isf(1e-6, ENSEMBLES - 1)), score
    error = np.sqrt(np.var(first, axis=0, ddof=1) / ENSEMBLES + 0.25 / 20000)
    assert np.all(np.abs(np.mean(first, axis=0) - 0.5) / error < stats.t.isf(1e-6, ENSEMBLES - 1))
    assert moved > 0.05 * ENSEMBLES * STEPS * walkers


def test_heavy_tail_is_the_multivariate_t() -> None:
    proposal = WarpedStudentT.of(np.array([1.0, -2.0, 0.5]), CORRELATED, 6.0)
    reference = stats.multivariate_t(proposal.mean, CORRELATED, 6.0)
    x = np.random.default_rng(1).normal(size=(20, 3)) * 3
    np.testing.assert_allclose(proposal.log_density(x), reference.logpdf(x), rtol=1e-7)
    draws = proposal.sample(np.random.RandomState(2), 40000)
    for j in range(3):
        marginal = stats.t(6.0, proposal.mean[j], np.sqrt(CORRELATED[j, j]))
        assert stats.kstest(draws[:, j], marginal.cdf).pvalue > 1e-4


def test_shear_straightens_a_banana_and_can_be_undone() -> None:
    rng = np.random.default_rng(3)
    x = rng.normal(size=(2000, 3))
    x[:, 2] += 0.8 * (x[:, 0] ** 2 - 1.0) - 0.5 * x[:, 0] * x[:, 1]
    triangular = TriangularMap.fit(x)
    straight = triangular.forward(x)
    np.testing.assert_allclose(triangular.inverse(straight), x, atol=1e-12)
    np.testing.assert_array_equal(straight[:, 0], x[:, 0])
    assert np.var(straight[:, 2]) == pytest.approx(1.0, rel=0.15)
    assert triangular.coefficients[2, 0, 0] == pytest.approx(0.8, abs=0.1)
    assert triangular.coefficients[2, 0, 1] == pytest.approx(-0.5, abs=0.12)


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("axes", [np.eye(2), np.array([[1.0, -2.0], [0.3, 1.0]])])
def test_fitted_density_is_that_of_its_draws(curved: bool, axes: np.ndarray) -> None:
    """Its integral over a grid is one, and its draws have the mean that the grid says."""
    rng = np.random.default_rng(5)
    x = rng.normal(size=(3000, 2))
    x[:, 1] = np.exp(0.7 * x[:, 1]) + 0.5 * x[:, 0] ** 2
    fitted = WarpedStudentT.fit(x, 20.0, curved=curved, axes=axes)
    axis = [np.linspace(-14.0, 14.0, 900), np.linspace(-14.0, 40.0, 1800)]
    grid = np.stack(np.meshgrid(*axis, indexing="ij"), axis=-1).reshape(-1, 2)
    cell = np.exp(fitted.log_density(grid)) * (axis[0][1] - axis[0][0]) * (axis[1][1] - axis[1][0])
    assert cell.sum() == pytest.approx(1.0, abs=0.01)
    draws = fitted.sample(np.random.RandomState(4), 40_000)
    error = 5.0 * draws.std(axis=0) / np.sqrt(len(draws))
    assert np.all(np.abs(draws.mean(axis=0) - cell @ grid) < error + 0.02)


def test_overlap_is_the_acceptance_of_an_independence_chain() -> None:
    rng = np.random.default_rng(7)
    target, other = Gaussian(np.eye(3)), Gaussian(np.diag([0.6, 0.9, 0.8]))
    x, new = target.draw(rng, 20_000), other.draw(rng, 20_000)
    ratio = target(new) - other(new) - target(x) + other(x)
    assert independence_acceptance(other(x) - target(x)) == pytest.approx(
        np.mean(np.minimum(1.0, np.exp(ratio))), abs=0.04
    )
    assert independence_acceptance(np.zeros(100)) == pytest.approx(1.0)
    assert steps_to_leave(np.zeros(100)) == pytest.approx(1.5)


def test_a_surrogate_density_is_never_far_below_its_proposal() -> None:
    rng = np.random.default_rng(8)
    points = rng.normal(size=(300, 2))
    level = -0.5 * np.sum(points**2, axis=1)
    plain, prior = WarpedStudentT.of(np.zeros(2), np.eye(2), 5.0), log_prior_of(TARGETS["gaussian"])
    surrogate_density = SurrogateDensity.of(Surrogate.fit(plain, points, level, -level), prior, points)
    far = 12.0 * rng.normal(size=(50, 2))
    least = np.log(2.0 * np.pi) + plain.log_density(far) + np.log(0.05)
    assert np.all(surrogate_density.log_density(far, prior) > least - 0.5)


def test_cuts_find_a_bound_and_a_ledge() -> None:
    def density(x: np.ndarray) -> np.ndarray:
        ledge = np.where(x[:, 0] > 0.0, np.maximum(-0.5 * x[:, 0] ** 2, -2.0 - 0.05 * x[:, 0]), -0.5 * x[:, 0] ** 2)
        return np.where(x[:, 1] > 0.5, ledge - 0.5 * x[:, 1] ** 2 - 0.5 * x[:, 2] ** 2, -np.inf)

    middle = WarpedStudentT.of(np.array([0.0, 0.6, 0.0]), np.eye(3))
    draws = scan_axes(density, middle).sample(np.random.RandomState(2), 4000)
    assert np.quantile(draws[:, 0], 0.9) > 10.0
    assert np.mean(draws[:, 1] < 0.3) < 0.1
    assert list(scan_axes(density, middle).warp.warped) == [True, True, False]
    nowhere = WarpedStudentT.of(np.array([0.0, -5.0, 0.0]), np.eye(3))
    assert scan_axes(density, nowhere) is nowhere


def test_surrogate_knows_a_function_with_a_corner() -> None:
    """Narrow and normal to the left of zero, wide and exponential to the right: a delay next to a reading."""
    rng = np.random.default_rng(9)

    def draw(n: int) -> np.ndarray:
        left = rng.random(n) < 0.75
        first = np.where(left, -1.0 + 0.35 * rng.standard_normal(n), rng.exponential(7.0, n))
        return np.column_stack([first, rng.normal(size=(n, 2))])

    def value(x: np.ndarray) -> np.ndarray:
        left = -0.5 * ((x[:, 0] + 1.0) / 0.35) ** 2
        right = -0.5 / 0.35**2 - x[:, 0] / 7.0 * (1.0 + 0.1 * x[:, 1])
        return np.where(x[:, 0] < 0.0, left, right) - 0.5 * np.sum(x[:, 1:] ** 2, axis=1)

    points, fresh = draw(500), draw(400)
    level = value(points)
    found = Surrogate.fit(WarpedStudentT.fit(points), points, level, level.max() - level)
    assert np.all(found(40.0 * fresh[:20]) < found(fresh[:20]))
    error = np.clip(found(fresh) - value(fresh), -2.0, 2.0)
    assert np.sqrt(np.mean(error**2)) < 0.1  # 0.24 with a smooth kernel alone

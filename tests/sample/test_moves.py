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
from scipy import stats

from aero_bayes.sample.moves import DifferentialMove, HeavyTail, IndependenceMove, StretchMove

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
MOVES: dict[str, Callable[[], list[tuple[object, float]]]] = {
    "independence": lambda: [(IndependenceMove(HeavyTail.of(np.full(3, 0.3), 1.5 * np.eye(3), 5.0)), 1.0)],
    "differential": lambda: [(DifferentialMove(jump=0.3), 1.0)],
    "stretch": lambda: [(StretchMove(), 1.0)],
    "mixture": lambda: [
        (IndependenceMove(HeavyTail.of(np.zeros(3), CORRELATED)), 0.6),
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
    proposal = HeavyTail.of(np.array([1.0, -2.0, 0.5]), CORRELATED, 6.0)
    reference = stats.multivariate_t(proposal.mean, CORRELATED, 6.0)
    x = np.random.default_rng(1).normal(size=(20, 3)) * 3
    np.testing.assert_allclose(proposal.log_density(x), reference.logpdf(x), rtol=1e-7)
    draws = proposal.sample(np.random.RandomState(2), 40000)
    for j in range(3):
        marginal = stats.t(6.0, proposal.mean[j], np.sqrt(CORRELATED[j, j]))
        assert stats.kstest(draws[:, j], marginal.cdf).pvalue > 1e-4

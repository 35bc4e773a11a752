"""Diagnostics against processes whose answers are known and against ArviZ."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import arviz as az
import numpy as np
import pytest
from facts import facts

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.convergence import autocorrelation_time, check_convergence, r_hat
from aero_bayes.estimate.prediction import predictives
from aero_bayes.simulation.interface import Outcome

pytestmark = pytest.mark.fast


def ar1(rng: np.random.Generator, rho: float, shape: tuple[int, int, int]) -> np.ndarray:
    x = np.empty(shape)
    z = rng.normal(size=shape)
    x[:, 0] = z[:, 0]
    for k in range(1, shape[1]):
        x[:, k] = rho * x[:, k - 1] + np.sqrt(1 - rho**2) * z[:, k]
    return x


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_autocorrelation_time_of_ar1(rho: float) -> None:
    x = ar1(np.random.default_rng(1), rho, (4, 4000, 10))
    truth = (1 + rho) / (1 - rho)
    assert autocorrelation_time(x) == pytest.approx(truth, rel=0.25)
    found = check_convergence(x)
    assert found.ess_bulk == pytest.approx(x.size / truth, rel=0.25)
    assert found.r_hat < 1.01


def test_what_walkers_share_is_counted() -> None:
    rng = np.random.default_rng(2)
    common = ar1(rng, 0.0, (4, 2000, 1))
    x = np.sqrt(0.5) * common + np.sqrt(0.5) * ar1(rng, 0.0, (4, 2000, 20))
    truth = 20 * np.var(x.mean(axis=2)) / np.var(x)
    assert truth > 9
    assert autocorrelation_time(x) == pytest.approx(truth, rel=0.2)


def test_a_walker_that_stays_where_it_is_counts_for_little() -> None:
    x = np.random.default_rng(6).normal(size=(4, 500, 12))
    x[:, :, 0] = 3.0
    assert autocorrelation_time(x, coupled=False) > 20.0
    assert autocorrelation_time(np.random.default_rng(6).normal(size=(4, 500, 12)), coupled=False) < 1.3


@pytest.mark.parametrize("kind", ["same", "shifted", "wider"])
def test_r_hat_agrees_with_arviz(kind: str) -> None:
    x = np.random.default_rng(3).normal(size=(4, 300, 8))
    if kind == "shifted":
        x[0] += 0.5
    if kind == "wider":
        x[0] *= 2.0
    reference = float(az.rhat(x.reshape(4, -1)))
    assert r_hat(x) == pytest.approx(reference, abs=2e-4)
    assert (r_hat(x) > 1.01) == (kind != "same")


def test_walkers_of_one_ensemble_do_not_pass_for_chains() -> None:
    rng = np.random.default_rng(4)
    x = np.repeat(rng.normal(size=(4, 1, 1)), 400, axis=1) * 0.5 + rng.normal(size=(4, 400, 30))
    assert r_hat(x) > 1.02


def test_draws_that_all_fail_are_one_line() -> None:
    failed = SimpleNamespace(outcomes=np.full((25, 1), Outcome.SOLVER_FAILED), outputs=())
    calibration: Any = SimpleNamespace(data=SimpleNamespace(experiments=(), recordings=()), process=None)
    simulator: Any = SimpleNamespace(simulate=lambda values: failed)
    draws = np.zeros((50, 4)), np.ones((50, 1, 3)), np.ones(1)
    with pytest.raises(CannotFinishError, match=facts("no draw")):
        predictives(calibration, simulator, *draws, np.random.default_rng(1), read=())

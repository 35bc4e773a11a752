"""Predictions from draws of a posterior."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from facts import facts

from aero_bayes.errors import CannotFinishError
from aero_bayes.posterior.sample import posterior_predictive
from aero_bayes.simulation.interface import Outcome

pytestmark = pytest.mark.fast


def test_draws_that_all_fail_are_one_line() -> None:
    def simulate(values: np.ndarray) -> Any:
        return SimpleNamespace(outcomes=np.full((len(values), 1), Outcome.SOLVER_FAILED), outputs=())

    target = SimpleNamespace(
        objective=SimpleNamespace(filters=False),
        free=(0,),
        calibration=SimpleNamespace(data=SimpleNamespace(experiments=())),
        simulator=SimpleNamespace(simulate=simulate),
        values=lambda coordinates: coordinates,
        spread=None,
    )
    joint: Any = SimpleNamespace(target=target, layout=SimpleNamespace(unpack=lambda noise: noise[:, None]))
    with pytest.raises(CannotFinishError, match=facts("no draw")):
        posterior_predictive(joint, np.zeros((30, 4)), np.ones(1), np.random.default_rng(1))

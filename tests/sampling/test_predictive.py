"""Predictions from draws of a posterior."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from facts import facts

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.prediction import predictives
from aero_bayes.simulation.interface import Outcome

pytestmark = pytest.mark.fast


def test_draws_that_all_fail_are_one_line() -> None:
    failed = SimpleNamespace(outcomes=np.full((25, 1), Outcome.SOLVER_FAILED), outputs=())
    calibration: Any = SimpleNamespace(data=SimpleNamespace(experiments=(), recordings=()), process=None)
    simulator: Any = SimpleNamespace(simulate=lambda values: failed)
    draws = np.zeros((50, 4)), np.ones((50, 1, 3)), np.ones(1)
    with pytest.raises(CannotFinishError, match=facts("no draw")):
        predictives(calibration, simulator, *draws, np.random.default_rng(1), read=())

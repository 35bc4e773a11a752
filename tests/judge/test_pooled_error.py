"""The standard deviation of an error that is pooled over recordings, against draws."""

from __future__ import annotations

import numpy as np
import pytest

from aero_bayes.estimate.predict_recordings import Prediction, RmsError

pytestmark = pytest.mark.fast


def test_deviation_of_a_pooled_error(rng: np.random.Generator):
    parts = {("a", "y"): RmsError(1.0, 0.02, 500), ("b", "y"): RmsError(0.1, 0.02, 3000)}
    found = Prediction({}, {}, parts, {})
    draws = {key: e.rms + e.sd * rng.standard_normal(20_000) for key, e in parts.items()}
    squares = sum(e.readings * draws[key] ** 2 for key, e in parts.items())
    pooled = np.sqrt(squares / sum(e.readings for e in parts.values()))
    assert found.uncertainty("test")["y"] == pytest.approx(pooled.std(), rel=0.05)

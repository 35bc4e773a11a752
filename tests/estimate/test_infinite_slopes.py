"""Slopes that are infinite at the optimum end in a fit and not in an error of the linear algebra."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

import aero_bayes


@pytest.mark.parametrize("truth", [0.0, 1e-9])
def test_a_root_of_a_parameter_that_is_zero(tmp_path: Path, truth: float) -> None:
    (tmp_path / "Root.mo").write_text(
        """model Root
  parameter Real a(min = 0, max = 1) = 0.3;
  parameter Real tau(unit = "s", min = 0.1, max = 10) = 1.5;
  input Real u;
  output Real y(start = 0, fixed = true);
equation
  tau * der(y) = u + sqrt(a) * sqrt(abs(y)) - y;
end Root;
"""
    )
    time = np.linspace(0.0, 8.0, 161)
    u = np.sign(np.sin(1.3 * time))
    y = np.zeros_like(time)
    for k in range(160):
        y[k + 1] = u[k] + (y[k] - u[k]) * np.exp(-0.05)
    y += 0.01 * np.random.default_rng(1).standard_normal(time.size) + np.sqrt(truth)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        found = aero_bayes.fit(
            aero_bayes.Recording("run", time, {"u": u}, {"y": y}),
            aero_bayes.load_model(tmp_path / "Root.mo"),
            parameters=["a", "tau"],
            workers=0,
        )
    assert found["tau"].value == pytest.approx(1.0, rel=0.03)
    assert found["a"].value < 1e-2
    assert np.isfinite(found.covariance).all()

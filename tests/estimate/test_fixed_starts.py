"""``fixed = true`` holds the start of a state that is read, too, unless its first reading contradicts it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import aero_bayes
from aero_bayes import FitSettings, Model, Recording
from aero_bayes.estimate import CalibrationSettings

pytestmark = pytest.mark.fast
LAG = """
model Lag
  parameter Real T(unit = "s", min = 0.1, max = 100) = 1;
  input Real u;
  output Real y = x;
  Real x(start = 1{fixed});
equation
  T * der(x) = u - x;
end Lag;
"""
FIXED = LAG.format(fixed=", fixed = true")


def lag(start: float) -> Recording:
    """A lag of 4 s under a square wave, in closed form, with noise of 0.01."""
    time = np.arange(0.0, 40.0, 0.2)
    u = np.where(np.floor(time / 10.0) % 2 == 0, 2.0, -1.0)
    y = np.full(time.size, start)
    for k in range(1, time.size):
        y[k] = u[k - 1] + (y[k - 1] - u[k - 1]) * np.exp(-0.2 / 4.0)
    noise = 0.01 * np.random.default_rng(1).standard_normal(time.size)
    return Recording("run", time, {"u": u}, {"y": y + noise}, {})


def fitted(recording: Recording, model: Model, **settings: tuple[str, ...]) -> aero_bayes.Fit:
    given = FitSettings("local", calibration=CalibrationSettings(**settings))
    return aero_bayes.fit(recording, model, parameters=["T"], settings=given, workers=0)


def test_a_fixed_start_is_held(exported: Callable[[str], Model]) -> None:
    model = exported(FIXED)
    assert model.fixed_starts == ("y",)  # the state, by the output that is an alias of it
    fit = fitted(lag(1.0), model)
    assert list(fit.parameters) == ["T"]
    assert fit["T"].value == pytest.approx(4.0, abs=0.03)
    assert not fit.diagnosis["model"].found


def test_a_start_that_the_first_reading_contradicts_is_estimated(exported: Callable[[str], Model]) -> None:
    fit = fitted(lag(1.2), exported(FIXED))
    assert fit["y_start"].value == pytest.approx(1.2, abs=0.02)
    assert fit["T"].value == pytest.approx(4.0, abs=0.03)


def test_a_start_that_is_a_guess_is_estimated(exported: Callable[[str], Model]) -> None:
    model = exported(LAG.format(fixed=""))
    assert model.fixed_starts == ()
    assert list(fitted(lag(1.0), model).parameters) == ["T", "y_start"]


def test_a_setting_counts_for_more(exported: Callable[[str], Model]) -> None:
    assert list(fitted(lag(1.0), exported(FIXED), may_start_at_rest=("y",)).parameters) == ["T", "y_start"]

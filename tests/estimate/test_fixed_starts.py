"""``fixed = true`` holds the start of a state that is read, too, unless its first reading contradicts it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from closed_form import square_wave_lag

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


def lag(start: float) -> Recording:
    """A lag of 4 s under a square wave, in closed form, with noise of 0.01."""
    time, u, y = square_wave_lag(start=start)
    return Recording("run", time, {"u": u}, {"y": y + 0.01 * np.random.default_rng(1).standard_normal(time.size)}, {})


@pytest.mark.parametrize(
    ("fixed", "start", "settings", "estimated"),
    [
        (", fixed = true", 1.0, {}, False),  # the first reading agrees
        (", fixed = true", 1.2, {}, True),  # it contradicts
        ("", 1.0, {}, True),  # a guess
        (", fixed = true", 1.0, {"may_start_at_rest": ("y",)}, True),  # a setting counts for more
    ],
)
def test_a_start_is_held_or_estimated(
    exported: Callable[[str], Model], fixed: str, start: float, settings: dict[str, tuple[str, ...]], estimated: bool
) -> None:
    model = exported(LAG.format(fixed=fixed))
    assert model.fixed_starts == (("y",) if fixed else ())  # the state, by the output that is an alias of it
    given = FitSettings("local", calibration=CalibrationSettings(**settings))
    fit = aero_bayes.fit(lag(start), model, parameters=["T"], settings=given, workers=0)
    assert list(fit.parameters) == (["T", "y_start"] if estimated else ["T"])
    assert fit["T"].value == pytest.approx(4.0, abs=0.03)
    assert not fit.diagnosis["model"].found
    if estimated:
        assert fit["y_start"].value == pytest.approx(start, abs=0.02)

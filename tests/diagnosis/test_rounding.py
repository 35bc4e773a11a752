"""Intervals are as wide as what the rounding of a corner leaves open, of a law whose rounding has a closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import aero_bayes
from aero_bayes.data import Recording

pytestmark = pytest.mark.fast
LATE = """model Late
  parameter Real T(unit = "s", min = 0.01, max = 1) = 0.2;
  DECLARED = 0.06;
  input Real u;
  output Real y(start = 0, fixed = true);
equation
  (T ^ 4 + NAME ^ 4) ^ 0.25 * der(y) = u - y;
end Late;
"""


@pytest.mark.parametrize(
    "declared", ["constant Real T_min", "constant Real T_smooth", "parameter Real T_smooth", "constant Real T_c"]
)
def test_the_truth_lies_in_intervals_that_know_of_the_rounding(declared: str, tmp_path: Path) -> None:
    """The fitted lag is off by a closed form: ``(T^4 - T_min^4)^(1/4)`` where the truth is ``T``."""
    name = declared.split()[-1]
    (tmp_path / "Late.mo").write_text(LATE.replace("DECLARED", declared).replace("NAME", name))
    time = np.arange(0.0, 2.0, 0.01)
    readings = 1.0 - np.exp(-time / 0.1) + 1e-4 * np.random.default_rng(5).standard_normal(time.size)
    recording = Recording("step", time, {"u": np.ones(time.size)}, {"y": readings}, {"time": "s"})
    model, settings = aero_bayes.load_model(tmp_path / "Late.mo"), aero_bayes.FitSettings(method="local")
    fit = aero_bayes.fit(recording, model, parameters=["T"], settings=settings, workers=0)
    lag, off = fit["T"], 0.1 - (0.1**4 - 0.06**4) ** 0.25
    assert lag.value == pytest.approx(0.1 - off, abs=1e-4)
    assert (lag.q05 < 0.1 < lag.q95) == (name != "T_c")  # a width by another name is a value of the law
    assert lag.q95 - lag.q05 < 8.0 * off
    assert (fit.rounding_shift.get("T", 0.0) > 1.0) == (name != "T_c")
    assert ("rounding" in lag.note) == (name != "T_c")

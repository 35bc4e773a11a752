"""The noise of an input's meter that passes through the model is told where it is as large as the residual."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import aero_bayes
from aero_bayes import FitSettings
from aero_bayes.data import Recording
from aero_bayes.data.find_table import DataFinding
from aero_bayes.estimate.input_noise import asked_again
from aero_bayes.estimate.other_reading import told_fit
from aero_bayes.simulation import open_simulator

pytestmark = pytest.mark.fast

CART = """
model Cart "A mass on a spring and a damper"
  parameter Real k(unit="N/m") = 40;
  parameter Real d(unit="N.s/m") = 1;
  input Real F(unit="N");
  output Real x(unit="m", start=0, fixed=true);
  Real v(unit="m/s", start=0, fixed=true);
equation
  der(x) = v;
  1.0*der(v) = F - k*x - d*v;
end Cart;
"""


def driven(seed: int, noise: float, cubic: float = 0.0) -> Recording:
    """A cart of scipy under a smooth force, which is read with noise; the spring may be cubic, too."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 40.0, 0.02)
    force = CubicSpline(np.arange(0.0, 41.0, 0.8), 5.0 * rng.standard_normal(52))

    def rates(t: float, y: np.ndarray) -> list[float]:
        return [y[1], float(force(t)) - 50.0 * y[0] - cubic * y[0] ** 3 - 2.0 * y[1]]

    position = solve_ivp(rates, (0.0, 40.0), (0.0, 0.0), t_eval=time, rtol=1e-9, atol=1e-11, max_step=0.02).y[0]
    read = position + 1e-4 * rng.standard_normal(time.size)
    given = force(time) + noise * rng.standard_normal(time.size)
    return Recording("run", time, {"F": given}, {"x": read}, {"F": "N", "x": "m"})


def told(recording: Recording, model: aero_bayes.Model) -> tuple[aero_bayes.Fit, list[tuple[str, str]]]:
    settings = FitSettings(method="local")
    fit = aero_bayes.fit(recording, model, parameters=["k", "d"], settings=settings, workers=0)
    return fit, [(f.kind, f.signal) for f in fit.calibration.data.recordings[0].findings]


def test_the_noise_of_a_meter_is_told(exported: Callable[[str], aero_bayes.Model]) -> None:
    fit, found = told(driven(1, 0.8), exported(CART))
    assert found == [("noise", "F")]
    assert "0.8 N" in fit.diagnosis["data"].what
    assert fit.diagnosis.explanation is None  # a missing effect may leave as much: it is still looked for
    assert "F was read with noise" in fit.verdict
    assert {fit[name].status for name in ("k", "d")} == {"weak"}
    quiet, _ = told(driven(1, 0.0), exported(CART))
    assert {quiet[name].status for name in ("k", "d")} == {"identified"}


def test_a_quiet_meter_is_not_blamed_for_a_missing_effect(exported: Callable[[str], aero_bayes.Model]) -> None:
    for noise in (0.0, 0.1):
        fit, found = told(driven(2, noise, cubic=300.0), exported(CART))
        assert fit.diagnosis["model"].found
        assert ("noise", "F") not in found


def test_an_extended_fit_is_asked_again(exported: Callable[[str], aero_bayes.Model]) -> None:
    """What was found of a first fit does not stand for one that leaves something else."""
    noisy, _ = told(driven(1, 0.8), exported(CART))
    again = asked_again(noisy, (), partial(open_simulator, workers=0))
    assert [f.kind for f in again.calibration.data.recordings[0].findings] == ["noise"]
    quiet, found = told(driven(1, 0.0), exported(CART))
    start = DataFinding("value", "run", "v", "v starts elsewhere", "run", "Estimate it.", False)
    held = told_fit(told_fit(quiet, start), noisy.calibration.data.recordings[0].findings[0])

    def left(*started: str) -> list[tuple[str, str]]:
        again = asked_again(held, started, partial(open_simulator, workers=0))
        return [(f.kind, f.signal) for f in again.calibration.data.recordings[0].findings]

    assert left() == [("value", "v"), *found]
    assert left("v") == found

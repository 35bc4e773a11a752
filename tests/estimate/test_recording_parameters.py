"""Values of each recording alone: of parameters, of parameters that are the initial value of a state, of states.

``fixed = true`` holds the start of a state that is read, too, unless its first reading contradicts it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from closed_form import square_wave_lag
from numpy.random import Generator

import aero_bayes
from aero_bayes import FitSettings, Recording
from aero_bayes.estimate import CalibrationSettings, ParameterSpec
from aero_bayes.estimate.initial_states import mended_recordings
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.probed_facts import start_parameters

LAG = """
model Lag
  parameter Real tau(unit = "s", min = 0.1, max = 100) = 1;
  parameter Real gain(min = 0.1, max = 10) = 1;
  parameter Real y0(min = -20, max = 20) = 5;
  parameter Real z0(min = -20, max = 20) = 0;
  parameter Real rest(min = -20, max = 20) = 0 "starts z, and acts on y";
  input Real u;
  output Real y(start = y0 + 1, fixed = true);
  output Real z(start = rest, fixed = true);
equation
  tau * der(y) = gain * u + rest - y;
  der(z) = z0 - z;
end Lag;
"""
LOCAL = FitSettings("local")
SEARCHED = {"gain": ParameterSpec(per_recording=True), "tau": None}


def lag(rng: Generator, name: str, gain: float, start: float) -> Recording:
    """The lag, and beside it z, which stays zero."""
    given = square_wave_lag(rng, gain, start, name)
    return replace(given, outputs=given.outputs | {"z": 0.01 * rng.standard_normal(given.rows)})


def test_only_what_does_nothing_else_is_an_initial_value(exported: Callable[[str], Model]):
    names = ["tau", "gain", "y0", "z0", "rest"]
    assert dict(start_parameters(exported(LAG), names)) == {"y0": ("y",)}


def test_a_value_for_each_recording(exported: Callable[[str], Model], rng: Generator):
    recordings = [lag(rng, "empty", 2.0, 0.0), lag(rng, "loaded", 3.5, 1.0)]
    fit = aero_bayes.fit(recordings, exported(LAG), parameters=SEARCHED, settings=LOCAL, workers=0)
    assert [n for n in fit.parameters if n.startswith("gain")] == ["gain@empty", "gain@loaded"]
    for name, truth in (("gain@empty", 2.0), ("gain@loaded", 3.5), ("tau", 4.0)):
        assert abs(fit[name].value - truth) < 4.0 * (fit[name].sd or 0.0)
        assert str(fit[name].status) == "identified"
    assert fit["gain@loaded"].recording == "loaded"
    # each recording is simulated with its own, another one with their mean
    own = fit.simulate(recordings[1]).outputs["y"]
    np.testing.assert_allclose(own, fit.fitted[1][:, 0], rtol=1e-4, atol=1e-4)
    other = fit.simulate({"time": np.arange(0.0, 60.0, 0.5), "u": np.ones(120)})
    assert other.outputs["y"][-1] == pytest.approx(2.75, rel=0.01)


def test_posterior_has_each(exported: Callable[[str], Model], rng: Generator):
    recordings = [lag(rng, "a", 2.0, 0.0), lag(rng, "b", 3.5, 1.0)]
    fit = aero_bayes.fit(recordings, exported(LAG), parameters=SEARCHED, settings=LOCAL, workers=0)
    posterior = aero_bayes.sample(fit, settings=aero_bayes.SampleSettings(max_steps=300), workers=0)
    assert posterior["gain@b"].value == pytest.approx(3.5, rel=0.01)
    assert posterior["gain@a"].value == pytest.approx(2.0, rel=0.01)


def test_an_initial_value_is_fitted_as_the_parameter_it_is(exported: Callable[[str], Model], rng: Generator):
    recording = lag(rng, "run", 2.0, 7.0)
    fit = aero_bayes.fit(recording, exported(LAG), parameters=["tau", "gain", "y0"], settings=LOCAL, workers=0)
    assert fit["y0"].value == pytest.approx(6.0, abs=0.03)  # y starts at y0 + 1
    assert str(fit["y0"].status) == "identified"
    assert "y_start" not in fit.parameters
    several = [recording, lag(rng, "cold", 2.0, -3.0)]
    both = aero_bayes.fit(several, exported(LAG), parameters=["tau", "gain", "y0"], settings=LOCAL, workers=0)
    assert both["y0@run"].value == pytest.approx(6.0, abs=0.03)
    assert both["y0@cold"].value == pytest.approx(-4.0, abs=0.03)
    # another recording starts at its own first readings
    other = fit.simulate(lag(rng, "other", 2.0, 4.0))
    assert other.outputs["y"][0] == pytest.approx(4.0, abs=0.05)


def test_written_model_says_what_it_holds(tmp_path: Path, rng: Generator):
    (tmp_path / "Lag.mo").write_text(LAG)
    model = aero_bayes.load_model(tmp_path / "Lag.mo")
    recordings = [lag(rng, "a", 2.0, 7.0), lag(rng, "b", 3.0, 7.0)]
    fit = aero_bayes.fit(recordings, model, parameters=SEARCHED, settings=LOCAL, workers=0)
    written = fit.calibrated
    assert written.parameters["gain"] == pytest.approx(2.5, rel=0.01)
    assert "gain@a = " in written.remarks["gain"]
    assert "gain@b = " in written.remarks["gain"]


def test_parts_of_a_recording_share_its_value(exported: Callable[[str], Model], rng: Generator):
    whole = lag(rng, "empty", 2.0, 0.0)
    # No sample around a change of the input: the recording is cut there.
    keep = (whole.time < 18.0) | (whole.time > 22.0)
    recordings = [whole.rows_where(keep, "empty"), lag(rng, "loaded", 3.5, 1.0)]
    fit = aero_bayes.fit(recordings, exported(LAG), parameters=SEARCHED, settings=LOCAL, workers=0)
    parts = fit.calibration.data.recordings
    assert len(parts) == 3
    assert mended_recordings(parts, fit.calibration.model) == parts  # what was mended is not mended again
    assert [n for n in fit.parameters if n.startswith("gain")] == ["gain@empty", "gain@loaded"]
    for name, truth in (("gain@empty", 2.0), ("gain@loaded", 3.5)):
        assert abs(fit[name].value - truth) < 4.0 * (fit[name].sd or 0.0)
    assert fit.diagnosis.first is not None
    assert fit.diagnosis.first.cause == "data"


HELD = """
model Lag
  parameter Real T(unit = "s", min = 0.1, max = 100) = 1;
  input Real u;
  output Real y = x;
  Real x(start = 1{fixed});
equation
  T * der(x) = u - x;
end Lag;
"""


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
    model = exported(HELD.format(fixed=fixed))
    assert model.fixed_starts == (("y",) if fixed else ())  # the state, by the output that is an alias of it
    given = FitSettings("local", calibration=CalibrationSettings(**settings))
    recording = square_wave_lag(np.random.default_rng(1), start=start)
    fit = aero_bayes.fit(recording, model, parameters=["T"], settings=given, workers=0)
    assert list(fit.parameters) == (["T", "y_start"] if estimated else ["T"])
    assert fit["T"].value == pytest.approx(4.0, abs=0.03)
    assert not fit.diagnosis["model"].found
    if estimated:
        assert fit["y_start"].value == pytest.approx(start, abs=0.02)

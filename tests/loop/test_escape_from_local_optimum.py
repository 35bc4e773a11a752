"""A candidate far from the model as it stands is found from the beginning of the recording on."""

from __future__ import annotations

from dataclasses import replace

import closed_form
import numpy as np
import pytest
from closed_form import held

from aero_bayes import FitSettings
from aero_bayes.data import Recording, to_experiment
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.estimate.interpolation import with_interpolation
from aero_bayes.loop import LoopSettings, close_loop

SOURCE = """model Spring "A mass on a spring"
  parameter Real m(unit = "kg", min = 0) = 2;
  parameter Real c(unit = "N.s/m", min = 0) = 10;
  parameter Real k(unit = "N/m", min = 0) = 5e4;
  input Real F(unit = "N");
  output Real y(unit = "m");
protected
  Real x(unit = "m", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(x) = v;
  m*der(v) = F - c*v - k*x;
  y = x;
end Spring;
"""
M, C, K, K_3, RATE, NOISE = 2.0, 10.0, 5e4, 1.2e10, 750.0, 1e-6


def recording(name: str, seed: int, samples: int) -> Recording:
    """A resonance whose hardening force is larger than the linear one: fourth-order Runge-Kutta, the force held."""
    rng = np.random.default_rng(seed)
    frequency = np.fft.rfftfreq(samples, 1.0 / RATE)
    band = (frequency >= 5.0) & (frequency <= 150.0)
    spectrum = np.where(band, np.exp(2j * np.pi * rng.random(frequency.size)), 0.0)
    force = np.fft.irfft(spectrum, samples)
    force *= 20.0 / force.std()

    def slope(x, f):
        return np.array([x[1], (f - C * x[1] - K * x[0] - K_3 * x[0] ** 3) / M])

    y = held(slope, np.zeros(2), force, 1.0 / RATE, 20)[:, 0]
    assert K_3 * np.max(y**2) > 1.2 * K
    return Recording(name, np.arange(samples) / RATE, {"F": force}, {"y": y + rng.normal(0.0, NOISE, samples)})


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    folder = tmp_path_factory.mktemp("spring")
    (folder / "Spring.mo").write_text(SOURCE, encoding="utf-8")
    settings = LoopSettings(
        max_effects=1, parameters=("m", "c", "k"), laws=("cubic_stiffness", "end_stop"),
        cache=folder / "fmus",
        fit=FitSettings(method="local", calibration=CalibrationSettings(initial_states="estimated")),
    )  # fmt: skip
    train, test = recording("train", 1, 4000), recording("test", 2, 1500)
    return close_loop([train], [test], model=folder / "Spring.mo", settings=settings, workers=0)


def test_a_hardening_spring_is_told_from_a_stop_after_a_bad_first_fit(result) -> None:
    assert result.predicted_before.test["test", "y"].rms > 100.0 * NOISE
    assert [effect.id for effect in result.effects] == ["cubic_stiffness@v"]
    for name, truth in {"m": M, "c": C, "k": K}.items():
        assert result.parameters[name].value == pytest.approx(truth, rel=1e-2)
    # what the last digits of the parameters make of an unseen run at a resonance
    assert result.predicted_after.test["test", "y"].rms < 0.05 * result.predicted_before.test["test", "y"].rms


def test_inputs_read_the_other_way_twice_are_as_they_were() -> None:
    run = recording("run", 3, 200)
    held = closed_form.calibration([(run.time, run.outputs["y"][:, None])], ["y"], [])
    held = replace(held, data=replace(held.data, recordings=(run,), experiments=(to_experiment(run),)))
    lines = with_interpolation(held, {"F": "linear"})
    assert lines.data.interpolation == {"F": "linear"}
    again = with_interpolation(lines, {"F": "hold"})
    assert again.data.interpolation == {"F": "hold"}
    before, after = held.data.experiments[0].inputs[0], again.data.experiments[0].inputs[0]
    assert (after.name, after.interpolation) == (before.name, "hold")
    np.testing.assert_array_equal(after.time, before.time)
    np.testing.assert_array_equal(after.values, before.values)

"""A fitted model on other inputs, held against closed forms, and bands against data that they have not seen."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import aero_bayes
from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings


def swing(time: np.ndarray, force: float, m: float, k: float, d: float) -> np.ndarray:
    """Position of a mass on a spring and a damper after a step of the force, from rest."""
    rate, omega = d / (2 * m), np.sqrt(k / m - (d / (2 * m)) ** 2)
    decay = np.exp(-rate * time) * (np.cos(omega * time) + rate / omega * np.sin(omega * time))
    return force / k * (1 - decay)


def test_a_step_is_answered_as_the_closed_form_says(cart: SimpleNamespace):
    time = np.linspace(0.0, 3.0, 601)
    values = {"k": 80.0, "d": 2.5, "m": 1.4}
    found = cart.fit.simulate({"time": time, "F": 2.0}, parameters=values)
    expected = swing(time, 2.0, values["m"], values["k"], values["d"])
    assert found.outputs["position"] == pytest.approx(expected, abs=2e-5 * expected.max())
    assert found.units["position"] == "m"


def test_a_state_starts_where_it_is_told_to(cart: SimpleNamespace):
    """Let go from 0.1 m without a force: the step's answer, upside down."""
    time = np.linspace(0.0, 3.0, 301)
    found = cart.fit.simulate({"time": time, "F": 0.0}, parameters={"k": 80.0, "d": 2.5}, start={"position": 0.1})
    expected = 0.1 - swing(time, 8.0, 1.2, 80.0, 2.5)
    assert found.outputs["position"] == pytest.approx(expected, abs=1e-5)


def test_a_fitted_recording_comes_out_as_fitted(cart: SimpleNamespace):
    again = cart.fit.simulate(cart.recording)
    assert np.array_equal(again.outputs["position"], cart.fit.fitted[0][:, 0])


def test_another_recording_starts_at_its_own_readings(cart: SimpleNamespace):
    moved = replace(cart.recording, outputs={"position": cart.recording.outputs["position"] + 0.05}, sha256="")
    found = cart.fit.simulate(moved).outputs["position"]
    first = cart.recording.outputs["position"][cart.recording.time < 1.0]  # at rest until the force first changes
    assert cart.fit.simulate(cart.recording).outputs["position"][0] == 0.0  # where the model fixes it
    assert found[0] == pytest.approx(np.mean(first) + 0.05, abs=3.0 * np.std(first) / np.sqrt(first.size))
    settings = aero_bayes.FitSettings(method="local", calibration=CalibrationSettings(initial_states="estimated"))
    fit = aero_bayes.fit(cart.recording, cart.model, parameters=cart.free, settings=settings, workers=0)
    moving = cart.test.slice(5.0, 8.0)  # where the initial state is estimated, so is its velocity, which is not read
    assert fit.predict(moving).rms["position"] < 0.5 * cart.fit.predict(moving).rms["position"]


@pytest.mark.parametrize(
    ("inputs", "more", "said"),
    [
        ({"F": [0.0, 1.0]}, {}, "need their times in s under 'time'"),
        ({"time": [0.0, 1.0]}, {}, "input F is missing"),
        ({"time": [0.0, 1.0], "F": 1.0, "U": 1.0}, {}, "has no input U; it has F"),
        ({"time": [0.0, 0.0], "F": 1.0}, {}, "times must be at least two and increase"),
        ({"time": [0.0, 1.0], "F": [0.0, np.nan]}, {}, "input F is not finite everywhere"),
        ({"time": [0.0, 1.0], "F": 1.0}, {"parameters": {"stiffness": 1.0}}, "no parameter 'stiffness'"),
        ({"time": [0.0, 1.0], "F": 1.0}, {"parameters": {"k": np.inf}}, "parameter k is inf"),
        ({"time": [0.0, 1.0], "F": 1.0}, {"start": {"w": 1.0}}, "no state 'w'"),
    ],
)
def test_what_the_model_does_not_take_is_said_in_one_line(cart: SimpleNamespace, inputs, more, said: str):
    with pytest.raises(aero_bayes.InputError, match=said) as error:
        cart.fit.simulate(inputs, **more)
    assert "\n" not in str(error.value)


def test_nine_tenths_of_unseen_readings_lie_in_the_band(cart: SimpleNamespace):
    """Of a recording that the model itself made, with white noise of 1 mm: 1400 readings, 5 sd of a binomial."""
    rng = np.random.default_rng(7)

    def made(name: str, source: Recording) -> Recording:
        plain = cart.fit.simulate({"time": source.time, "F": source.inputs["F"]}, parameters={"k": 60.0})
        read = plain.outputs["position"] + rng.normal(0.0, 1e-3, source.rows)
        return Recording(name, source.time, source.inputs, {"position": read}, source.units)

    settings = aero_bayes.FitSettings(method="local", calibration=CalibrationSettings(delay="none"))
    fit = aero_bayes.fit(made("a", cart.recording), cart.model, parameters=cart.free, settings=settings, workers=0)
    posterior = aero_bayes.sample(fit, settings=aero_bayes.SampleSettings(max_steps=30), workers=0)
    found = posterior.predict(made("b", cart.test.slice(0.0, 28.0)))
    assert found.coverage["position"] == pytest.approx(0.9, abs=0.04)
    assert found.rms["position"] == pytest.approx(1e-3, rel=0.1)


def test_a_posterior_predicts_as_it_was_sampled_and_a_fit_as_its_posterior(
    cart: SimpleNamespace, posterior: aero_bayes.Posterior
):
    again, kept = posterior.predict(cart.recording).predictive, posterior.predictive[0]
    one, other = (source.predict(cart.test).predictive for source in (cart.fit, posterior))
    for mine, known, far, wide in ((again, kept, 0.05, 0.1), (one, other, 0.1, 0.15)):
        spread = known.upper - known.lower
        assert np.abs(mine.median - known.median).max() < far * spread.mean()
        assert mine.upper - mine.lower == pytest.approx(spread, rel=wide)


def test_the_band_of_a_wrong_model_is_as_wide_as_its_residual(cart: SimpleNamespace):
    found = cart.fit.predict(cart.recording)
    left = np.quantile(np.abs(cart.fit.residuals[0][:, 0]), 0.9)
    half = 0.5 * (found.predictive.upper - found.predictive.lower)
    assert found.coverage["position"] >= 0.88  # the draws' variance stands for the exact one
    assert half.mean() >= 0.95 * left
    assert cart.fit.predictor.band_factors[0] >= 1.6448

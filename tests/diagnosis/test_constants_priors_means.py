"""A constant at a channel, a prior that the readings contradict, and means over an interval are told with values."""

from __future__ import annotations

from dataclasses import replace

import heated_room
import numpy as np
import pytest

import aero_bayes
from aero_bayes.data import Recording
from aero_bayes.data.means import with_means
from aero_bayes.estimate import LogNormal
from aero_bayes.estimate.target import CurvatureAdjustment

pytestmark = pytest.mark.fast
HOUR = 3600.0


def findings(fit: aero_bayes.Fit) -> list[tuple[str, str]]:
    return [(f.kind, f.signal) for f in fit.calibration.data.recordings[0].findings]


def test_a_reading_whose_zero_is_off(room: aero_bayes.Model) -> None:
    given = heated_room.with_readings(heated_room.recording(), lambda v: v + 4.0)
    fit = aero_bayes.fit(given, room, parameters=["C", "G"], workers=0)
    assert findings(fit) == [("offset", "T")]
    told = fit.diagnosis["data"].what
    value = float(told.split("with ")[1].split(" K")[0])
    assert value == pytest.approx(-4.0, abs=0.1)
    assert fit.diagnosis.explanation is None  # an effect may do the same: it is still looked for


def test_a_prior_that_the_readings_contradict(room: aero_bayes.Model) -> None:
    prior = aero_bayes.ParameterSpec(prior=LogNormal.tolerance(1.3 * heated_room.C, 0.005))
    fit = aero_bayes.fit(heated_room.recording(), room, parameters={"C": prior, "G": (1.0, 1e4)}, workers=0)
    assert findings(fit) == [("prior", "C")]
    assert fit.diagnosis.explanation is fit.diagnosis["data"]


def slow(sd: float, memory: float, seed: int = 5) -> Recording:
    """The room with noise that is correlated over ``memory`` samples, beside the white one."""
    rng, left = np.random.default_rng(seed), np.exp(-1.0 / memory)
    noise = np.zeros(600)
    for k in range(1, 600):
        noise[k] = left * noise[k - 1] + sd * np.sqrt(1.0 - left**2) * rng.standard_normal()
    return heated_room.with_readings(heated_room.recording(), lambda v: v + noise)


def test_causes_are_named_beside_correlated_noise(room: aero_bayes.Model) -> None:
    given = slow(0.05, 8.0)
    clear = aero_bayes.fit(given, room, parameters=["C", "G"], workers=0)
    assert clear.noise["T"].kind == "ou"
    assert findings(clear) == []
    prior = aero_bayes.ParameterSpec(prior=LogNormal.tolerance(1.3 * heated_room.C, 0.001))
    fit = aero_bayes.fit(given, room, parameters={"C": prior, "G": (1.0, 1e4)}, workers=0)
    assert findings(fit) == [("prior", "C")]
    off = heated_room.with_readings(given, lambda v: v + 4.0)
    assert findings(aero_bayes.fit(off, room, parameters=["C", "G"], workers=0)) == [("offset", "T")]


def test_a_right_prior_is_not_named(room: aero_bayes.Model) -> None:
    prior = aero_bayes.ParameterSpec(prior=LogNormal.tolerance(1.005 * heated_room.C, 0.01))
    fit = aero_bayes.fit(heated_room.recording(), room, parameters={"C": prior, "G": (1.0, 1e4)}, workers=0)
    assert findings(fit) == []


def test_a_widened_likelihood_keeps_its_slope_at_the_fit() -> None:
    """So the posterior has its mode where the fit has it: the slope of the prior there is balanced."""
    prior, shrunk, centre = np.array([3.0, -1.0]), np.array([[0.3, 0.1], [0.1, 0.6]]), np.array([0.2, 0.5])
    wide = CurvatureAdjustment(centre, shrunk, prior)

    def log_likelihood(x: np.ndarray) -> float:
        off = wide(x[None])[0] - centre
        return float(-prior @ off - 0.5 * off @ off) + float(wide.added(x[None])[0])

    step = 1e-6 * np.eye(2)
    slope = [(log_likelihood(centre + s) - log_likelihood(centre - s)) / 2e-6 for s in step]
    assert slope == pytest.approx(-prior, abs=1e-6)


def averaged(seed: int = 1) -> tuple[Recording, Recording]:
    """The room with the heater's means of an hour and the temperature at its end, and with its mean; both exact."""
    rng = np.random.default_rng(seed)
    rows, a = 400, heated_room.G / heated_room.C
    power = rng.choice([0.0, 1500.0, 3000.0], rows)
    ends, means, x = np.empty(rows), np.empty(rows), 293.15
    for k in range(rows):
        rest = 278.0 + power[k] / heated_room.G
        decay = np.exp(-a * HOUR)
        means[k] = rest + (x - rest) * (1.0 - decay) / (a * HOUR)
        x = ends[k] = rest + (x - rest) * decay
    time = HOUR * np.arange(1, rows + 1)
    inputs = {"P": power, "T_amb": np.full(rows, 278.0)}
    noise = heated_room.SD * rng.standard_normal(rows)
    made = [Recording("run", time, inputs, {"T": y + noise}, heated_room.UNITS) for y in (ends, means)]
    return made[0], made[1]


def test_an_input_that_is_a_mean_before_its_time(room: aero_bayes.Model) -> None:
    fit = heated_room.fit(averaged()[0], room)
    assert findings(fit) == [("mean", "P")]
    assert 'stamp = "end"' in fit.diagnosis["data"].done
    assert fit.diagnosis.explanation is fit.diagnosis["data"]
    again = heated_room.fit(with_means(averaged()[0], {"P": "end"}), room)
    assert again["C"].value == pytest.approx(heated_room.C, rel=0.01)
    assert findings(again) == []
    assert not again.diagnosis["model"].found


def test_readings_and_input_that_are_means(room: aero_bayes.Model) -> None:
    declared = with_means(averaged()[1], {"P": "end", "T": "end"})
    fit = heated_room.fit(declared, room)
    assert fit["C"].value == pytest.approx(heated_room.C, rel=0.01)
    assert fit["G"].value == pytest.approx(heated_room.G, rel=0.01)
    assert not fit.diagnosis["model"].found
    assert fit.noise["T"].sd == pytest.approx(heated_room.SD, rel=0.2)
    told = heated_room.fit(replace(averaged()[1]), room)
    assert [kind for kind, _ in findings(told)] == ["mean"]


def test_a_heater_that_switches_within_the_samples(room: aero_bayes.Model) -> None:
    """Both channels are means and read as such; when the heater was on within an hour is not known."""
    rng, rows, minutes, a = np.random.default_rng(4), 400, 60, heated_room.G / heated_room.C
    power = np.repeat(rng.choice([0.0, 1500.0, 3000.0], rows * minutes // 28 + 1), 28)[: rows * minutes]
    x, means, decay = 293.15, np.empty(rows * minutes), np.exp(-60.0 * a)
    for k, now in enumerate(power):
        rest = 278.0 + now / heated_room.G
        means[k] = rest + (x - rest) * (1.0 - decay) / (60.0 * a)
        x = rest + (x - rest) * decay
    hourly = (values.reshape(rows, minutes).mean(axis=1) for values in (power, means))
    inputs = {"P": next(hourly), "T_amb": np.full(rows, 278.0)}
    readings = next(hourly) + heated_room.SD * rng.standard_normal(rows)
    given = Recording("run", HOUR * np.arange(rows), inputs, {"T": readings}, heated_room.UNITS)
    fit = heated_room.fit(with_means(given, {"T": "beginning"}), room)
    assert fit["C"].value == pytest.approx(heated_room.C, rel=0.05)
    assert fit["G"].value == pytest.approx(heated_room.G, rel=0.01)
    assert fit.rms["T"] > 2.0 * heated_room.SD
    assert fit.diagnosis.explanation is fit.diagnosis["noise"]
    assert "alternate" in fit.diagnosis["noise"].what

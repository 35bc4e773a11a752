"""Whiteness tests keep their size on long records and see what they should; errors by recording, by known noise."""

from __future__ import annotations

from dataclasses import replace

import closed_form
import numpy as np
import pytest
from scipy.stats import kstest

from aero_bayes.data import Recording
from aero_bayes.data.split import Part
from aero_bayes.estimate import Normal
from aero_bayes.estimate.local_fit import local_fit
from aero_bayes.estimate.noise import OutputNoise, SampleTimes, autocorrelation, correlation_p_value
from aero_bayes.estimate.noise_estimation import whiten
from aero_bayes.estimate.objective import Objective, Series
from aero_bayes.estimate.predict_recordings import Prediction, RmsError, rms_error
from aero_bayes.estimate.reading_spread import SpreadModel
from aero_bayes.estimate.residual_tests import (
    check_residuals,
    recording_errors,
    slow_variation_test,
    smooth_dependence_test,
)
from aero_bayes.simulation.interface import InputSignal

pytestmark = pytest.mark.fast

N = 4000
TIME = np.arange(N) * 0.01
NOISE = OutputNoise(1.0, 0.8, 0.3)


@pytest.fixture(scope="module")
def series():
    return Series(0, 0, "theta", SampleTimes.of(TIME, np.zeros(N)), np.zeros(N))


def test_structure_tests_keep_their_size_with_fitted_directions_out(series):
    rng = np.random.default_rng(3)
    state = np.sin(0.9 * TIME) + 0.3 * np.sin(2.3 * TIME)
    slopes, _ = whiten(np.stack([state, np.ones(N)]), series.sampling, NOISE)
    gram = slopes @ slopes.T
    slow, smooth = [], []
    for _ in range(300):
        e = rng.normal(size=N)
        e -= slopes.T @ np.linalg.solve(gram, slopes @ e)
        slow.append(slow_variation_test(e, series, NOISE, slopes))
        smooth.append(smooth_dependence_test(state, e, series, NOISE, slopes))
    assert kstest(slow, "uniform").pvalue > 1e-4
    assert kstest(smooth, "uniform").pvalue > 1e-4


def test_structure_over_a_state_is_seen(series):
    rng = np.random.default_rng(4)
    state = np.sin(0.9 * TIME)
    shape, _ = whiten(1.0 * np.abs(state)[None], series.sampling, NOISE)
    e = rng.normal(size=N) + shape[0]
    assert smooth_dependence_test(state, e, series, NOISE, np.empty((0, N))) < 1e-6


def test_autocorrelation_of_a_known_process():
    rng = np.random.default_rng(5)
    e = rng.normal(size=20000)
    x = e[1:] + 0.5 * e[:-1]
    acf = autocorrelation(x, 5)
    np.testing.assert_allclose(acf, [1.0, 0.4, 0, 0, 0, 0], atol=0.04)


def test_rms_and_its_spread():
    rng = np.random.default_rng(6)
    white = rms_error(rng.normal(size=5000))
    assert white.rms == pytest.approx(1.0, abs=0.05)
    assert white.sd == pytest.approx(1.0 / np.sqrt(2 * 5000), rel=0.4)
    slow = rms_error(np.repeat(rng.normal(size=100), 50))
    assert slow.sd > 3.0 * white.sd


def test_deviation_of_a_pooled_error(rng):
    parts = {("a", "y"): RmsError(1.0, 0.02, 500), ("b", "y"): RmsError(0.1, 0.02, 3000)}
    found = Prediction({}, {}, parts, {})
    draws = {key: e.rms + e.sd * rng.standard_normal(20_000) for key, e in parts.items()}
    squares = sum(e.readings * draws[key] ** 2 for key, e in parts.items())
    pooled = np.sqrt(squares / sum(e.readings for e in parts.values()))
    assert found.uncertainty("test")["y"] == pytest.approx(pooled.std(), rel=0.05)


def test_an_input_that_a_controller_sets_by_the_reading_is_no_structure():
    """The reading's noise is in the input that follows from it, and has not acted on the reading."""
    rng = np.random.default_rng(5)
    time = np.arange(2000) * 0.01
    measured = 1.0 + rng.normal(size=time.size)
    given = closed_form.calibration(
        [(time, measured[:, None])], ["y"], [closed_form.parameter("a", 1.0, -9.0, 9.0, Normal(0.0, 3.0))]
    )
    signal = InputSignal("u", time, -2.0 * measured, "hold")
    (run,) = given.data.experiments
    given = replace(given, data=given.data.with_experiments((replace(run, inputs=(signal,)),)))
    simulator = closed_form.FormulaSimulator(given.problem(), lambda t, p: (p[0] + 0.0 * t)[:, None])
    study = Objective(given, simulator)
    (report,) = check_residuals(
        given, study.series, local_fit(study, np.zeros(1), (0,), noise={"y": OutputNoise(1.0)}), {}
    )
    assert report.verdict == "adequate"
    assert report.tests["u"] > 1e-4


@pytest.mark.parametrize(("digits", "exact"), [(12, True), (5, False)])
def test_the_rounding_of_a_register_is_no_exact_agreement(digits: int, exact: bool):
    """A sum that grows by 1000 is counted in steps of 1e-5: fine enough for the solver's error, and yet not exact."""
    t = np.linspace(0.0, 10.0, 500)
    y = np.round(100.0 * t + 3.0 * np.sin(t) * t, digits)[:, None]

    def line(time: np.ndarray, v: np.ndarray) -> np.ndarray:
        return (100.0 * time + v[0] * np.sin(time) * time)[:, None]

    items = [closed_form.parameter("a", 2.9, 0.0, 9.0, Normal(3.0, 9.0, 0.0, 9.0))]
    fit = closed_form.fitted(line, closed_form.calibration([(t, y)], ["y"], items))
    (report,) = check_residuals(fit.calibration, fit.series, fit.optimum, {})
    assert report.verdict == "adequate"
    assert report.exact == exact


def test_the_test_keeps_its_size_within_and_between_series():
    """2,000 p-values each: a tenth lies below 0.1, uncertain by 0.0067; the chi-square law is approximate."""
    rng = np.random.default_rng(1)
    scale = 1.0 + 0.8 * np.sin(np.linspace(0.0, 9.0, 1000))
    series = scale * rng.standard_normal((2000, 2, 1000))
    within = [correlation_p_value(a, a) for a, _ in series]
    between = [correlation_p_value(a, b) for a, b in series]
    for p in (within, between):
        assert abs(np.mean(np.array(p) < 0.1) - 0.1) < 0.03
        assert abs(np.mean(np.array(p) < 0.5) - 0.5) < 0.06


def test_short_series_do_not_fail_too_often():
    """75 values: of 4,000 independent series 4 are expected below 1e-3; 20 or more are so with a chance below 1e-7."""
    rng = np.random.default_rng(3)
    p = [correlation_p_value(a, a) for a in rng.standard_normal((4000, 75))]
    assert np.sum(np.array(p) < 1e-3) < 20


def test_a_common_part_of_two_white_series_is_seen():
    """Each is white by itself; a common part of a quarter of the variance is beyond chance in every run."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        common = rng.standard_normal(N)
        a, b = (0.87 * rng.standard_normal(N) + 0.5 * np.roll(common, shift) for shift in (0, 3))
        assert correlation_p_value(a, b) < 1e-4


CLOCK = np.arange(2000) * 0.01
WHITE = {"y": OutputNoise(0.1)}


def recorded(residual: np.ndarray, name: str = "test") -> tuple[Recording, dict[tuple[str, str], np.ndarray]]:
    model = np.sin(CLOCK)
    return Recording(name, CLOCK, {"u": np.ones(CLOCK.size)}, {"y": model + residual}), {(name, "y"): model}


def spoilt(rows: np.ndarray | slice, by: float) -> np.ndarray:
    """White noise to which some is added at some rows."""
    residual = 0.1 * np.random.default_rng(3).normal(size=CLOCK.size)
    residual[rows] += by
    return residual


WHITE_NOISE = 0.1 * np.random.default_rng(1).normal(size=CLOCK.size)
#: A residual, what is said of it, and its size over that of the noise.
JUDGED = {
    "noise": (WHITE_NOISE, "noise", 1.0),
    "too large": (1.5 * WHITE_NOISE, "too large", 1.5),
    "a small wave": (WHITE_NOISE + 0.06 * np.sin(2.0 * CLOCK), "structured", np.sqrt(1.18)),
    "a large wave": (WHITE_NOISE + 0.3 * np.sin(2.0 * CLOCK), "too large", np.sqrt(5.5)),
    "gaps": (spoilt(np.random.default_rng(4).random(CLOCK.size) < 0.3, np.nan), "noise", 1.0),
    "outliers, which do not count": (spoilt(slice(20, None, 40), 5.0), "noise", 1.0),
}


@pytest.mark.parametrize("kind", JUDGED)
def test_size_and_structure_are_told_apart(kind: str) -> None:
    residual, verdict, ratio = JUDGED[kind]
    recording, fitted = recorded(residual)
    (error,) = recording_errors([Part(recording, "test")], None, fitted, {("test", "y"): 0.1}, WHITE)
    assert error.verdict == verdict
    assert error.noise_known
    assert error.ratio == pytest.approx(ratio, rel=0.05)


def test_the_structure_of_rounding_says_nothing() -> None:
    recording, fitted = recorded(1e-8 * np.sin(2.0 * CLOCK))
    (error,) = recording_errors([Part(recording, "test")], None, fitted, {}, WHITE)
    assert error.verdict == "noise"


def test_parts_of_a_recording_are_judged_apart_and_unknown_noise_is_that_of_the_fit() -> None:
    rng = np.random.default_rng(2)
    residual = np.where(CLOCK < 10.0, 0.1, 0.2) * rng.normal(size=CLOCK.size)
    recording, fitted = recorded(residual)
    parts = [Part(recording, "train", None, 10.0), Part(recording, "test", 10.0)]
    first, last = recording_errors(parts, fitted, fitted, {}, WHITE)
    assert (first.verdict, last.verdict) == ("noise", "too large")
    assert (first.begin, last.begin) == (None, 10.0)
    assert last.after == pytest.approx(0.2, rel=0.1)
    assert last.before == last.after
    assert not last.noise_known
    assert last.noise == 0.1


def test_noise_that_grows_with_the_reading_is_judged_by_its_own_size() -> None:
    rng = np.random.default_rng(4)
    level = np.exp(-0.3 * CLOCK)
    recording = Recording(
        "test", CLOCK, {"u": np.ones(CLOCK.size)}, {"y": level * (1.0 + 0.05 * rng.normal(size=CLOCK.size))}
    )
    spread = {"y": SpreadModel("relative", 0.0, 0.05, least=1e-9)}
    floors = {("test", "y"): 1e-3}
    (error,) = recording_errors([Part(recording, "test")], None, {("test", "y"): level}, floors, WHITE, spread)
    assert error.verdict == "noise"
    assert error.noise == pytest.approx(0.05 * np.sqrt(np.mean(level**2)), rel=1e-6)

"""Errors by recording, against noise of known size."""

from __future__ import annotations

import numpy as np
import pytest

from aero_bayes.data import Recording
from aero_bayes.data.split import Part
from aero_bayes.estimate.noise import OutputNoise
from aero_bayes.estimate.reading_spread import SpreadModel
from aero_bayes.estimate.residual_tests import recording_errors

TIME = np.arange(2000) * 0.01
WHITE = {"y": OutputNoise(0.1)}


def recorded(residual: np.ndarray, name: str = "test") -> tuple[Recording, dict[tuple[str, str], np.ndarray]]:
    model = np.sin(TIME)
    return Recording(name, TIME, {"u": np.ones(TIME.size)}, {"y": model + residual}), {(name, "y"): model}


@pytest.mark.parametrize(
    ("scale", "wave", "verdict"),
    [(1.0, 0.0, "noise"), (1.5, 0.0, "too large"), (1.0, 0.06, "structured"), (1.0, 0.3, "too large")],
)
def test_size_and_structure_are_told_apart(scale: float, wave: float, verdict: str) -> None:
    rng = np.random.default_rng(1)
    recording, fitted = recorded(0.1 * scale * rng.normal(size=TIME.size) + wave * np.sin(2.0 * TIME))
    (error,) = recording_errors([Part(recording, "test")], None, fitted, {("test", "y"): 0.1}, WHITE)
    assert error.verdict == verdict
    assert error.noise_known
    assert error.ratio == pytest.approx(np.sqrt(scale**2 + 50.0 * wave**2), rel=0.05)


def test_parts_of_a_recording_are_judged_apart_and_unknown_noise_is_that_of_the_fit() -> None:
    rng = np.random.default_rng(2)
    residual = np.where(TIME < 10.0, 0.1, 0.2) * rng.normal(size=TIME.size)
    recording, fitted = recorded(residual)
    parts = [Part(recording, "train", None, 10.0), Part(recording, "test", 10.0)]
    first, last = recording_errors(parts, fitted, fitted, {}, WHITE)
    assert (first.verdict, last.verdict) == ("noise", "too large")
    assert (first.begin, last.begin) == (None, 10.0)
    assert last.after == pytest.approx(0.2, rel=0.1)
    assert last.before == last.after
    assert not last.noise_known
    assert last.noise == 0.1


@pytest.mark.parametrize("seed", range(5))
def test_white_noise_passes_however_many_readings_are_missing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    residual = 0.1 * rng.normal(size=TIME.size)
    residual[rng.random(TIME.size) < 0.3] = np.nan
    recording, fitted = recorded(residual)
    (error,) = recording_errors([Part(recording, "test")], None, fitted, {("test", "y"): 0.1}, WHITE)
    assert error.verdict == "noise"


def test_outliers_are_not_counted() -> None:
    rng = np.random.default_rng(3)
    residual = 0.1 * rng.normal(size=TIME.size)
    residual[20::40] += 5.0
    recording, fitted = recorded(residual)
    (error,) = recording_errors([Part(recording, "test")], None, fitted, {("test", "y"): 0.1}, WHITE)
    assert error.verdict == "noise"
    assert error.after == pytest.approx(0.1, rel=0.1)


def test_noise_that_grows_with_the_reading_is_judged_by_its_own_size() -> None:
    rng = np.random.default_rng(4)
    level = np.exp(-0.3 * TIME)
    recording = Recording(
        "test", TIME, {"u": np.ones(TIME.size)}, {"y": level * (1.0 + 0.05 * rng.normal(size=TIME.size))}
    )
    spread = {"y": SpreadModel("relative", 0.0, 0.05, least=1e-9)}
    floors = {("test", "y"): 1e-3}
    (error,) = recording_errors([Part(recording, "test")], None, {("test", "y"): level}, floors, WHITE, spread)
    assert error.verdict == "noise"
    assert error.noise == pytest.approx(0.05 * np.sqrt(np.mean(level**2)), rel=1e-6)


def test_the_structure_of_rounding_says_nothing() -> None:
    recording, fitted = recorded(1e-8 * np.sin(2.0 * TIME))
    (error,) = recording_errors([Part(recording, "test")], None, fitted, {}, WHITE)
    assert error.verdict == "noise"

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


def spoilt(rows: np.ndarray | slice, by: float) -> np.ndarray:
    """White noise to which some is added at some rows."""
    residual = 0.1 * np.random.default_rng(3).normal(size=TIME.size)
    residual[rows] += by
    return residual


WHITE_NOISE = 0.1 * np.random.default_rng(1).normal(size=TIME.size)
#: A residual, what is said of it, and its size over that of the noise.
JUDGED = {
    "noise": (WHITE_NOISE, "noise", 1.0),
    "too large": (1.5 * WHITE_NOISE, "too large", 1.5),
    "a small wave": (WHITE_NOISE + 0.06 * np.sin(2.0 * TIME), "structured", np.sqrt(1.18)),
    "a large wave": (WHITE_NOISE + 0.3 * np.sin(2.0 * TIME), "too large", np.sqrt(5.5)),
    "gaps": (spoilt(np.random.default_rng(4).random(TIME.size) < 0.3, np.nan), "noise", 1.0),
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
    recording, fitted = recorded(1e-8 * np.sin(2.0 * TIME))
    (error,) = recording_errors([Part(recording, "test")], None, fitted, {}, WHITE)
    assert error.verdict == "noise"


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

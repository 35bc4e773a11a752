"""Where readings tell noise from signal and where they cannot: signals in closed form, noise of known size on top."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from aero_bayes.data import Recording, noise_floor, noise_floors

pytestmark = pytest.mark.fast

SAMPLES = 3000
COUNT = np.arange(SAMPLES)
Generator = np.random.Generator
Array = np.ndarray


def lag(u: Array, samples: float) -> Array:
    """Exact answer of a first-order lag to a held input, by its time constant in samples."""
    keep = np.exp(-1.0 / samples)
    return lfilter([0.0, 1.0 - keep], [1.0, -keep], u)


def levels(rng: Generator, every: int) -> Array:
    return np.repeat(rng.uniform(-1.0, 1.0, SAMPLES // every + 1), every)[:SAMPLES]


def behind(samples: float, every: int) -> Callable[[Generator], tuple[Array, list[Array]]]:
    def made(rng: Generator) -> tuple[Array, list[Array]]:
        u = levels(rng, every)
        return lag(u, samples), [u]

    return made


def alone(signal: Callable[[Generator], Array]) -> Callable[[Generator], tuple[Array, list[Array]]]:
    return lambda rng: (signal(rng), [])


def tone(samples: float) -> Callable[[Generator], tuple[Array, list[Array]]]:
    return alone(lambda _: np.sin(2.0 * np.pi * COUNT / samples))


def resonance(rng: Generator) -> tuple[Array, list[Array]]:
    u = lfilter(*butter(4, 0.3), rng.standard_normal(SAMPLES + 200))
    answer = lfilter([1.0], [1.0, -1.7, 0.95], u)[200:]
    return answer / answer.std(), [u[200:]]


def room(rng: Generator, time_constant: float) -> tuple[Array, list[Array]]:
    """A room read every 900 s, heated by 20 K now and then, outdoors a day's wave."""
    outside = 5.0 + 8.0 * np.sin(2.0 * np.pi * 900.0 * COUNT / 86400.0)
    heater = np.where(rng.random(SAMPLES) < 0.4, 20.0, 0.0)
    return lag(outside + heater, time_constant / 900.0), [outside, heater]


def drift(step: float) -> Callable[[Generator], tuple[Array, list[Array]]]:
    return alone(lambda rng: step * np.cumsum(rng.standard_normal(SAMPLES)))


@dataclass(frozen=True)
class Case:
    made: Callable[[Generator], tuple[Array, list[Array]]]
    sd: float
    known: bool


CASES = {
    "slow waves": Case(tone(300.0), 0.01, True),
    "a swing of 50 samples": Case(tone(50.0), 0.002, True),
    "a swing of 12 samples": Case(tone(12.0), 0.002, False),
    "a vibration below half the rate": Case(tone(3.3), 0.05, False),
    "a vibration near half the rate": Case(tone(2.2), 0.05, False),
    "a lag of 30 samples behind steps": Case(behind(30.0, 150), 0.01, True),
    "a lag of 5 samples behind steps": Case(behind(5.0, 150), 0.01, True),
    "a lag of 5 samples, the input new at each": Case(behind(5.0, 1), 0.01, False),
    "a lag of 0.3 samples, the input new at each": Case(behind(0.3, 1), 0.01, False),
    "a lag of 3 samples, the input new at every fourth": Case(behind(3.0, 4), 0.01, False),
    "a lag of 200 samples, the input new at each": Case(behind(200.0, 1), 0.03, True),
    "a resonance under a rich input": Case(resonance, 0.005, False),
    "a resonance under a rich input, much noise": Case(resonance, 0.3, True),
    "a room that follows in 20 min": Case(lambda rng: room(rng, 1200.0), 0.03, False),
    "a room that follows in 2 h": Case(lambda rng: room(rng, 7200.0), 0.03, False),
    "a level that drifts less than the noise": Case(drift(0.03), 0.1, True),
    "a level that drifts more than the noise": Case(drift(0.1), 0.01, False),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("seed", range(3))
def test_a_floor_is_known_or_said_to_be_unknown(name: str, seed: int) -> None:
    case, rng = CASES[name], np.random.default_rng(seed)
    signal, inputs = case.made(rng)
    found = noise_floor(signal + case.sd * rng.standard_normal(SAMPLES), 0.01 * COUNT, inputs)
    assert found.at_most > 0.9 * case.sd
    if case.known:
        assert found.sd == pytest.approx(case.sd, rel=0.12)
        assert found.slow == 0.0
    else:
        assert found.sd is None
        assert (found.white, found.slow) == (0.0, 0.0)


def test_an_unknown_floor_has_no_entry_and_is_said() -> None:
    rng = np.random.default_rng(5)
    heated, inputs = room(rng, 1200.0)
    readings = {
        "T": heated + 0.03 * rng.standard_normal(SAMPLES),
        "slow": lag(heated, 3000.0) + 0.03 * rng.standard_normal(SAMPLES),
    }
    recording = Recording("room", 900.0 * COUNT, dict(zip(("T_amb", "Q"), inputs, strict=True)), readings)
    assert noise_floors([recording], ["T", "slow"]) == {("room", "slow"): pytest.approx(0.03, rel=0.1)}
    said = {output.name: output.text for output in recording.summary().outputs}
    assert "unknown" in said["T"]
    assert "0.03" in said["slow"]

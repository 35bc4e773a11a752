"""What sensors add to the true signals: noise, correlation, quantisation, ripple, gaps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.random import Generator

from aero_bayes.arrays import FloatArray


@dataclass(frozen=True)
class SensorNoise:
    """Noise of one output, in its SI unit.

    ``white`` is the standard deviation of white noise, ``slow`` that of an Ornstein-Uhlenbeck process of correlation
    time ``slow_time`` (s), ``ripple`` amplitudes at one, two, ... periods a turn of the rotor, in proportion to its
    speed and given at 376 rad/s (that of the public step recording), ``missing`` the share of readings that get lost,
    ``counts`` those of an encoder a revolution (0 for none).
    """

    white: float = 0.0
    slow: float = 0.0
    slow_time: float = 0.1
    ripple: tuple[float, ...] = ()
    missing: float = 0.0
    counts: int = 0

    def sample(
        self, rng: Generator, time: FloatArray, angle: FloatArray | float = 0.0, speed: FloatArray | float = 0.0
    ) -> FloatArray:
        """Draw noise at ``time``, shape (n,), for a rotor at ``angle`` rad turning at ``speed`` rad/s."""
        noise = self.white * rng.standard_normal(time.size)
        noise += self.slow * ornstein_uhlenbeck(rng, time, self.slow_time)
        for order, amplitude in enumerate(self.ripple, start=1):
            phase = rng.uniform(0.0, 2.0 * np.pi)
            noise += amplitude * np.abs(speed) / 376.0 * np.sin(order * angle + phase)
        return noise


def readings(
    rng: Generator, time: FloatArray, clean: Mapping[str, FloatArray], noise: Mapping[str, SensorNoise],
    angle: FloatArray | float = 0.0, speed: FloatArray | float = 0.0,
) -> dict[str, FloatArray]:  # fmt: skip
    """Read outputs, each with random numbers of its own and without error where it has no noise."""
    found = {}
    *streams, gaps = rng.spawn(len(clean) + 1)
    for stream, (name, values) in zip(streams, clean.items(), strict=True):
        sensor = noise.get(name, SensorNoise())
        measured = values + sensor.sample(stream, time, angle, speed)
        if sensor.counts:
            measured = quantise(measured, sensor.counts)
        if sensor.missing:
            measured = np.where(gaps.random(measured.size) < sensor.missing, np.nan, measured)
        found[name] = measured
    return found


def white(level: float = 1.0) -> dict[str, SensorNoise]:
    """Make the AERO's sensors with white noise only: ``level`` times 5 mA, 1 rad/s and 2 mrad."""
    return {"i_m": SensorNoise(5e-3 * level), "omega_m": SensorNoise(1.0 * level), "theta": SensorNoise(2e-3 * level)}


def real(level: float = 1.0) -> dict[str, SensorNoise]:
    """Make the AERO's sensors with the noise of a real one, as read off the public step recording, times ``level``.

    Current: 2 mA white, ripple of 10 mA at two periods a turn; speed: 1.8 rad/s, ripple of 0.55 rad/s at one and 0.25
    at two; pitch: 2,048 counts a revolution. Some correlated noise (draught, the tachometer's filter) goes with each.
    """
    return {
        "i_m": SensorNoise(2e-3 * level, 1.0e-3 * level, 0.05, (0.3e-3 * level, 10e-3 * level)),
        "omega_m": SensorNoise(1.8 * level, 0.4 * level, 0.05, (0.55 * level, 0.25 * level)),
        "theta": SensorNoise(0.2e-3 * level, 0.5e-3 * level, 0.2, counts=2048),
    }


def ornstein_uhlenbeck(rng: Generator, time: FloatArray, correlation_time: float) -> FloatArray:
    """Draw a stationary process of unit variance and correlation exp(-|dt| / correlation_time), shape (n,)."""
    decay = np.exp(-np.diff(time, prepend=time[0]) / correlation_time)
    kicks = rng.standard_normal(time.size) * np.sqrt(1.0 - decay**2)
    kicks[0] = rng.standard_normal()
    steps = zip(decay.tolist(), kicks.tolist(), strict=True)
    values = accumulate(steps, lambda value, step: step[0] * value + step[1], initial=0.0)
    return np.array(list(values)[1:])


def quantise(values: FloatArray, counts: int) -> FloatArray:
    """Round angles in rad as an encoder of ``counts`` a revolution does; edges half-way between counts."""
    step = 2.0 * np.pi / counts
    return np.floor(values / step + 0.5) * step

"""What sensors add to the true signals: noise, correlation, quantisation, ripple, gaps."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class SensorNoise:
    """Noise of one output, in its SI unit.

    ``white`` is the standard deviation of white noise, ``slow`` that of an Ornstein-Uhlenbeck process of correlation
    time ``slow_time`` (s), ``ripple`` amplitudes at one, two, ... periods a turn of the rotor, in proportion to its
    speed and given at 376 rad/s (that of the public step recording), ``missing`` the share of readings that get lost.
    """

    white: float = 0.0
    slow: float = 0.0
    slow_time: float = 0.1
    ripple: tuple[float, ...] = ()
    missing: float = 0.0

    def sample(self, rng: Generator, time: FloatArray, angle: FloatArray, speed: FloatArray) -> FloatArray:
        """Draw noise at ``time``, shape (n,), for a rotor at ``angle`` rad turning at ``speed`` rad/s."""
        noise = self.white * rng.standard_normal(time.size)
        slow = ornstein_uhlenbeck(rng, time, self.slow_time)
        noise += self.slow * slow
        for order, amplitude in enumerate(self.ripple, start=1):
            phase = rng.uniform(0.0, 2.0 * np.pi)
            noise += amplitude * np.abs(speed) / 376.0 * np.sin(order * angle + phase)
        return noise


@dataclass(frozen=True)
class Sensors:
    """Noise of the AERO's three outputs, and counts a revolution of the pitch encoder (0: it reads the angle itself).

    Its edges lie half-way between counts, and the count is zero at zero pitch.
    """

    i_m: SensorNoise = SensorNoise()
    omega_m: SensorNoise = SensorNoise()
    theta: SensorNoise = SensorNoise()
    encoder_counts: int = 0
    label: str = field(default="", compare=False)


def clean() -> Sensors:
    """Make sensors without noise."""
    return Sensors(label="clean")


def white(level: float = 1.0) -> Sensors:
    """Make sensors with white noise only: ``level`` times 5 mA, 1 rad/s and 2 mrad."""
    return Sensors(SensorNoise(5e-3 * level), SensorNoise(1.0 * level), SensorNoise(2e-3 * level), label="white")


def real(level: float = 1.0) -> Sensors:
    """Make sensors with the noise of a real AERO, as read off the public step recording, times ``level``.

    Current: 2 mA white, ripple of 10 mA at two periods a turn; speed: 1.8 rad/s, ripple of 0.55 rad/s at one and 0.25
    at two; pitch: 2,048 counts a revolution. Some correlated noise (draught, the tachometer's filter) goes with each.
    """
    return Sensors(
        SensorNoise(2e-3 * level, 1.0e-3 * level, 0.05, (0.3e-3 * level, 10e-3 * level)),
        SensorNoise(1.8 * level, 0.4 * level, 0.05, (0.55 * level, 0.25 * level)),
        SensorNoise(0.2e-3 * level, 0.5e-3 * level, 0.2),
        encoder_counts=2048,
        label="real",
    )


def ornstein_uhlenbeck(rng: Generator, time: FloatArray, correlation_time: float) -> FloatArray:
    """Draw a stationary process of unit variance and correlation exp(-|dt| / correlation_time), shape (n,)."""
    decay = np.exp(-np.diff(time, prepend=time[0]) / correlation_time)
    kicks = rng.standard_normal(time.size) * np.sqrt(1.0 - decay**2)
    kicks[0] = rng.standard_normal()
    out = np.empty(time.size)
    value = 0.0
    for k, (keep, kick) in enumerate(zip(decay.tolist(), kicks.tolist(), strict=True)):
        value = keep * value + kick
        out[k] = value
    return out


def quantise(values: FloatArray, counts: int) -> FloatArray:
    """Round angles in rad as an encoder of ``counts`` a revolution does; edges half-way between counts."""
    step = 2.0 * np.pi / counts
    return np.floor(values / step + 0.5) * step

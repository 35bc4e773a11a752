"""Families of input signals, each drawn from a point of the unit cube, all within plus and minus one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray

#: Steps a staircase takes, and sines a sum has.
STEPS, SINES = 8, 10
#: How often a signal that is not made of jumps is updated, in Hz.
UPDATE_HZ = 20.0


@dataclass(frozen=True)
class SignalFamily:
    """Signals of one kind: ``signal`` maps a point (``size``,) of the unit cube and times (n,) in s to values (n,).

    ``jumps`` says that they are made of jumps, which a simulation takes in fewer steps."""

    name: str
    size: int
    signal: Callable[[FloatArray, FloatArray], FloatArray]
    jumps: bool = True


def _staircase_signal(u: FloatArray, time: FloatArray) -> FloatArray:
    """Hold each of eight levels for a share of the time."""
    levels, shares = 2.0 * u[:STEPS] - 1.0, 0.15 + u[STEPS:]
    ends = np.cumsum(shares) / shares.sum() * (time[-1] - time[0])
    index = np.searchsorted(ends, time - time[0], side="right")
    return np.asarray(levels[np.minimum(index, STEPS - 1)])


def _binary_signal(u: FloatArray, time: FloatArray) -> FloatArray:
    """Return a pseudo-random binary signal: height, offset, clock, and which one."""
    clock = _between(u[2], 0.05, 4.0)
    tick = ((time - time[0]) / clock + 1e-9).astype(np.int64)
    bits = np.random.default_rng(int(1e6 * u[3])).integers(0, 2, int(tick[-1]) + 1)
    return np.clip(_swing(u, 2.0 * bits[tick] - 1.0), -1.0, 1.0)


def _square_signal(u: FloatArray, time: FloatArray) -> FloatArray:
    """Return a square wave: height, offset, period."""
    period = _between(u[2], 0.2, 20.0)
    return np.clip(_swing(u, np.where(np.mod(time - time[0], period) < 0.5 * period, 1.0, -1.0)), -1.0, 1.0)


def _release_signal(u: FloatArray, time: FloatArray) -> FloatArray:
    """Return one level, then zero: the body swings freely to rest."""
    held = (0.1 + 0.8 * u[1]) * (time[-1] - time[0])
    return np.where(time - time[0] < held, 2.0 * u[0] - 1.0, 0.0)


def _multi_sine_signal(u: FloatArray, time: FloatArray) -> FloatArray:
    """Sum ten sines with random phases: height, offset, lowest and highest frequency, and which phases."""
    low = _between(u[2], 0.05, 0.5)
    frequency = np.geomspace(low, low * _between(u[3], 2.0, 30.0), SINES)
    phase = np.random.default_rng(int(1e6 * u[4])).uniform(0.0, 2.0 * np.pi, SINES)
    wave = np.sin(np.outer(_updates(time), 2.0 * np.pi * frequency) + phase).sum(axis=1)
    return np.clip(_swing(u, wave / max(float(np.abs(wave).max()), 1e-9)), -1.0, 1.0)


def _chirp_signal(u: FloatArray, time: FloatArray) -> FloatArray:
    """Return a sine of rising frequency: height, offset, first and last frequency."""
    low, high = _between(u[2], 0.02, 0.5), _between(u[3], 0.3, 5.0)
    t = _updates(time)
    phase = 2.0 * np.pi * (low * t + 0.5 * (high - low) * t**2 / max(float(t[-1]), 1e-9))
    return np.clip(_swing(u, np.sin(phase)), -1.0, 1.0)


def _swing(u: FloatArray, wave: FloatArray) -> FloatArray:
    return np.asarray(u[0] * wave + (2.0 * u[1] - 1.0))


def _between(u: float, low: float, high: float) -> float:
    return float(low * (high / low) ** u)


def _updates(time: FloatArray) -> FloatArray:
    """Return the time since the start, rounded down to the last update."""
    return np.asarray(np.floor((time - time[0]) * UPDATE_HZ + 1e-9) / UPDATE_HZ)


FAMILIES = (
    SignalFamily("steps", 2 * STEPS, _staircase_signal),
    SignalFamily("binary", 4, _binary_signal),
    SignalFamily("square wave", 3, _square_signal),
    SignalFamily("step and release", 2, _release_signal),
    SignalFamily("multi-sine", 5, _multi_sine_signal, jumps=False),
    SignalFamily("chirp", 4, _chirp_signal, jumps=False),
)

"""Voltage signals (V over time in s) for experiments, sampled and held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from aero_bayes.arrays import FloatArray


@dataclass(frozen=True)
class Levels:
    """A staircase: ``levels[k]`` from ``starts[k]`` on, zero before. Steps, pulses and PRBS are all of this kind."""

    starts: tuple[float, ...]
    levels: tuple[float, ...]

    def volts(self, time: FloatArray) -> FloatArray:
        index = np.searchsorted(np.array(self.starts) - 1e-9, time, side="right")
        values: FloatArray = np.concatenate(([0.0], self.levels))[index]
        return values


@dataclass(frozen=True)
class MultiSine:
    """A sum of sines: amplitudes in V, frequencies in Hz, phases in rad."""

    amplitudes: tuple[float, ...]
    frequencies: tuple[float, ...]
    phases: tuple[float, ...]

    def volts(self, time: FloatArray) -> FloatArray:
        waves = np.outer(time, 2.0 * np.pi * np.array(self.frequencies)) + np.array(self.phases)
        values: FloatArray = np.sin(waves) @ np.array(self.amplitudes)
        return values


@dataclass(frozen=True)
class Chirp:
    """A sine whose frequency rises linearly from ``low`` to ``high`` Hz over ``duration`` s, then starts again."""

    amplitude: float
    low: float
    high: float
    duration: float

    def volts(self, time: FloatArray) -> FloatArray:
        t = np.mod(time, self.duration)
        return self.amplitude * np.sin(
            2.0 * np.pi * (self.low * t + 0.5 * (self.high - self.low) / self.duration * t * t)
        )


InputDesign = Levels | MultiSine | Chirp


def paper_step() -> Levels:
    """Design the paper's experiment: 24 V for 20 s, then 0 V for 20 s."""
    return Levels((0.0, 20.0), (24.0, 0.0))


def pulse(height: float, start: float, width: float) -> Levels:
    """Design one pulse of ``height`` V from ``start`` s, ``width`` s long."""
    return Levels((start, start + width), (height, 0.0))


def equal_steps(levels: Sequence[float], dwell: float, start: float = 1.0) -> Levels:
    """Design steps to ``levels`` in V one after the other, ``dwell`` s each, from ``start`` s on."""
    return Levels(tuple(start + dwell * k for k in range(len(levels))), tuple(float(level) for level in levels))


def random_levels(
    rng: Generator, height: float, duration: float, dwell: tuple[float, float] = (0.5, 4.0), start: float = 1.0
) -> Levels:
    """Draw levels uniform within +-``height`` V, each held for a time drawn from ``dwell``; zero for the last sixth."""
    starts, levels, t = [], [], start
    while t < duration * 5.0 / 6.0:
        starts.append(round(t, 2))
        levels.append(round(float(rng.uniform(-height, height)), 2))
        t += float(rng.uniform(*dwell))
    return Levels((*starts, round(duration * 5.0 / 6.0, 2)), (*levels, 0.0))


def prbs(rng: Generator, height: float, duration: float, clock: float = 0.5, start: float = 1.0) -> Levels:
    """Draw a pseudo-random binary signal of +-``height`` V that may change every ``clock`` s."""
    count = int((duration - start) / clock)
    bits = rng.integers(0, 2, count)
    return Levels(
        tuple(round(start + clock * k, 6) for k in range(count)), tuple(float(height * (2 * b - 1)) for b in bits)
    )


def random_multi_sine(
    rng: Generator, height: float, low: float = 0.05, high: float = 2.0, count: int = 12
) -> MultiSine:
    """Draw ``count`` sines between ``low`` and ``high`` Hz with random phases whose sum stays within ``height`` V."""
    frequencies = np.geomspace(low, high, count)
    phases = rng.uniform(0.0, 2.0 * np.pi, count)
    shape = frequencies**-0.25
    t = np.arange(0.0, 4.0 / low, 0.05 / high)
    peak = float(np.abs(np.sin(np.outer(t, 2.0 * np.pi * frequencies) + phases) @ shape).max())
    return MultiSine(tuple(shape * height / peak), tuple(frequencies), tuple(phases))

"""Input signals as one run applies them, and their values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from aero_bayes.arrays import FloatArray
from aero_bayes.simulation.interface import (
    DelayTarget,
    Experiment,
    InputSignal,
    InputTarget,
    ProblemTarget,
)


def signals_of_run(
    experiment: Experiment, row: Sequence[ProblemTarget | None], values: FloatArray
) -> tuple[InputSignal, ...]:
    """Apply one parameter vector's delays and additions to grid values to the input signals of an experiment."""
    signals = []
    for signal in experiment.inputs:
        level, delay = signal.values.astype(float).copy(), 0.0
        for value, target in zip(values, row, strict=True):
            if isinstance(target, InputTarget) and target.input == signal.name:
                level[target.index] += value
            if isinstance(target, DelayTarget) and target.input in (None, signal.name):
                delay += float(value)
        signals.append(replace(signal, time=signal.time + delay, values=level))
    return tuple(signals)


def signal_values(signal: InputSignal, time: ArrayLike) -> FloatArray:
    """Compute an input at times of any shape."""
    at = np.asarray(time, dtype=float)
    if signal.interpolation == "linear":
        return np.asarray(np.interp(at, signal.time, signal.values))
    cell = np.searchsorted(signal.time, at + 1e-12 * np.maximum(1.0, np.abs(at)), side="right") - 1
    return np.asarray(signal.values[np.maximum(cell, 0)])


def value_at(signal: InputSignal, t: float, segment: float) -> float:
    """Value at t within the segment that starts at `segment` (which decides on the side of a jump)."""
    if signal.interpolation == "linear":
        return float(np.interp(t, signal.time, signal.values))
    cell = int(np.searchsorted(signal.time, segment + 1e-12 * max(1.0, abs(segment)), side="right")) - 1
    return float(signal.values[max(cell, 0)])


def linear_signals(signals: tuple[InputSignal, ...]) -> tuple[InputSignal, ...]:
    """Return those that are interpolated linearly."""
    return tuple(signal for signal in signals if signal.interpolation == "linear")

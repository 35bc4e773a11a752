"""What an actuator makes of a command: pieces of constant, ramp and exponential, each exact.

A command holds from its sample to the next. Every law of an input turns it into pieces
``base + slope s + decay exp(-rate s)``, s being the time since the piece began.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import exp

import numpy as np

from aero_bayes.arrays import FloatArray


@dataclass(frozen=True)
class PiecewiseSignal:
    """An input over time: where pieces begin (s), their coefficients, and the exponential's rate (1/s; 0 for none).

    Before its first break it has the first piece's starting value.
    """

    breaks: FloatArray
    base: FloatArray
    slope: FloatArray
    decay: FloatArray
    rate: float = 0.0

    @property
    def held(self) -> bool:
        """Whether every piece is constant."""
        return not self.rate and not self.slope.any()

    def piece(self, at: float) -> Callable[[float], float]:
        """Return the signal as a function of time (s) from ``at`` to the next break."""
        k, rate = int(np.searchsorted(self.breaks, at, "right")) - 1, self.rate
        if k < 0:
            before = float(self.base[0] + self.decay[0])
            return lambda t: before
        start, base, slope, decay = (float(of[k]) for of in (self.breaks, self.base, self.slope, self.decay))
        if not rate:
            return lambda t: base + slope * (t - start)
        return lambda t: base + slope * (t - start) + decay * exp(-rate * (t - start))


def held_command(time: FloatArray, values: FloatArray) -> PiecewiseSignal:
    """Hold each value from its sample to the next; equal neighbours make one piece."""
    first = np.concatenate(([True], values[1:] != values[:-1]))
    zero = np.zeros(int(first.sum()))
    return PiecewiseSignal(time[first], values[first], zero, zero)


def delayed_command(time: FloatArray, values: FloatArray, delay: float) -> PiecewiseSignal:
    """Delay the command by ``delay`` s; before it arrives, its first value holds."""
    return held_command(time + delay, values)


def lagged_command(time: FloatArray, values: FloatArray, constant: float) -> PiecewiseSignal:
    """Apply a first-order lag of time constant ``constant`` s, settled at the first value."""
    first = np.concatenate(([True], values[1:] != values[:-1]))
    at, level = time[first], values[first]
    out = [0.0]
    for factor, fall in zip(np.exp(-np.diff(at) / constant).tolist(), (-np.diff(level)).tolist(), strict=True):
        out.append(out[-1] * factor + fall)
    return PiecewiseSignal(at, level, np.zeros(at.size), np.array(out), 1.0 / constant)


def rate_limited_command(time: FloatArray, values: FloatArray, fastest: float) -> PiecewiseSignal:
    """Follow the command by no more than ``fastest`` a second."""
    at, step = float(values[0]), float(time[-1] - time[-2])
    pieces: list[tuple[float, float, float]] = [(float(time[0]), at, 0.0)]
    ends = [*time[1:].tolist(), float(time[-1]) + step]
    for t, end, target in zip(time.tolist(), ends, values.tolist(), strict=True):
        gap = target - at
        if not gap:
            continue
        speed = fastest if gap > 0.0 else -fastest
        pieces.append((t, at, speed))
        at = target if gap / speed < end - t else at + speed * (end - t)
        if at == target:
            pieces.append((t + gap / speed, at, 0.0))
    breaks, base, slope = np.array(pieces).T
    return PiecewiseSignal(breaks, base, slope, np.zeros(len(pieces)))


def command_with_play(time: FloatArray, values: FloatArray, half_width: float, share: float) -> PiecewiseSignal:
    """Apply hysteresis: a share of the command goes through a play (backlash operator) of ``half_width``."""
    out, inner = [], float(values[0])
    for value in values.tolist():
        inner = min(max(inner, value - half_width), value + half_width)
        out.append((1.0 - share) * value + share * inner)
    return held_command(time, np.array(out))


def faded_command(time: FloatArray, values: FloatArray, constant: float, loss: float, size: float) -> PiecewiseSignal:
    """Weaken the command by ``loss`` where its square, averaged over ``constant`` s, is that of ``size``."""
    out, heat = [], 0.0
    steps = np.exp(-np.diff(time, append=2.0 * time[-1] - time[-2]) / constant).tolist()
    for value, kept in zip((values / size).tolist(), steps, strict=True):
        out.append(size * value * max(1.0 - loss * heat, 0.0))
        heat = kept * heat + (1.0 - kept) * value * value
    return held_command(time, np.array(out))

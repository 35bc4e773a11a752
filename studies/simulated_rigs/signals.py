"""What an actuator makes of a command, which holds from its sample to the next."""

from __future__ import annotations

import numpy as np

from aero_bayes.arrays import FloatArray

#: Times (s) from which values hold, and these; before, the first holds, too.
Signal = tuple[FloatArray, FloatArray]


def held_command(time: FloatArray, values: FloatArray) -> Signal:
    """Hold each value from its sample to the next; equal neighbours make one piece."""
    first = np.concatenate(([True], values[1:] != values[:-1]))
    return time[first], values[first]


def delayed_command(time: FloatArray, values: FloatArray, delay: float) -> Signal:
    """Delay the command by ``delay`` s; before it arrives, its first value holds."""
    return held_command(time + delay, values)


def limited_rate(time: FloatArray, values: FloatArray, fastest: float) -> Signal:
    """Return the slope (1/s) of what follows the command by no more than ``fastest`` a second."""
    at, step = float(values[0]), float(time[-1] - time[-2])
    pieces = [(float(time[0]), 0.0)]
    ends = [*time[1:].tolist(), float(time[-1]) + step]
    for t, end, target in zip(time.tolist(), ends, values.tolist(), strict=True):
        gap = target - at
        if not gap:
            continue
        speed = fastest if gap > 0.0 else -fastest
        pieces.append((t, speed))
        at = target if gap / speed < end - t else at + speed * (end - t)
        if at == target:
            pieces.append((t + gap / speed, 0.0))
    breaks, slope = np.array(pieces).T
    return breaks, slope


def command_with_play(time: FloatArray, values: FloatArray, half_width: float, share: float) -> Signal:
    """Apply hysteresis: a share of the command goes through a play (backlash operator) of ``half_width``."""
    out, inner = [], float(values[0])
    for value in values.tolist():
        inner = min(max(inner, value - half_width), value + half_width)
        out.append((1.0 - share) * value + share * inner)
    return held_command(time, np.array(out))


def faded_command(time: FloatArray, values: FloatArray, constant: float, loss: float, size: float) -> Signal:
    """Weaken the command by ``loss`` where its square, averaged over ``constant`` s, is that of ``size``."""
    out, heat = [], 0.0
    steps = np.exp(-np.diff(time, append=2.0 * time[-1] - time[-2]) / constant).tolist()
    for value, kept in zip((values / size).tolist(), steps, strict=True):
        out.append(size * value * max(1.0 - loss * heat, 0.0))
        heat = kept * heat + (1.0 - kept) * value * value
    return held_command(time, np.array(out))

"""Readings made ready for a test of small effects: what is known to be the sensor's doing is taken out first.

Three things in a real recording are neither physics nor stationary noise: ripple that is locked to the rotor's angle,
an encoder that repeats one count while the body hardly moves, and ripple whose alias at the sample rate lies so low
that it looks like physics. The first is demodulated and subtracted, readings of the other two become gaps.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

FloatArray = NDArray[np.float64]

#: Least distance in Hz of a ripple's alias from zero at which it can be told from physics.
LOWEST_ALIAS = 1.5
#: Length in s of the window over which a ripple's amplitude and phase are taken as constant.
WINDOW = 1.5
#: A ripple counts when it holds this many times the power found at orders where there is none.
DISTINCT = 3.0


@dataclass(frozen=True)
class Ripple:
    """Ripple found on one output: the order (periods a turn) and its amplitude."""

    order: int
    amplitude: float


def quantum(values: FloatArray) -> float:
    """Step between neighbouring readings if they lie on a grid (an encoder's count), else 0.

    At least nine in ten of the differences of distinct readings must be whole multiples of the smallest common one.
    """
    levels = np.unique(values[np.isfinite(values)])
    if levels.size < 3:
        return 0.0
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * max(float(np.ptp(levels)), 1e-300)]
    if steps.size < 2:
        return 0.0
    step = float(np.median(steps[steps < 1.5 * np.quantile(steps, 0.1)]))
    multiples = (levels - levels[0]) / step
    off = np.abs(multiples - np.round(multiples))
    # A fine grid fits anything: it must also be sparse against the number of readings.
    dense = levels.size > 0.3 * np.isfinite(values).sum()
    return step if not dense and float(np.mean(off < 0.1)) > 0.9 else 0.0


def thin_standstill(
    time: FloatArray, values: FloatArray, longest: float = 0.5, keep: int = 3, spacing: float = 2.5
) -> NDArray[np.bool_]:
    """Which readings to keep so that a reading which stands still does not count over and over.

    Of a stretch of equal readings longer than ``longest`` s one every ``spacing`` s is kept, at least ``keep``, evenly
    spread.
    """
    use = np.isfinite(values)
    index = np.flatnonzero(use)
    if index.size == 0:
        return use
    seen = values[index]
    edges = np.concatenate(([0], np.flatnonzero(np.diff(seen) != 0.0) + 1, [seen.size]))
    for start, stop in pairwise(edges):
        lasted = float(time[index[stop - 1]] - time[index[start]])
        if lasted > longest:
            number = max(keep, round(lasted / spacing))
            kept = np.round(np.linspace(start, stop - 1, number)).astype(int)
            use[index[start:stop]] = False
            use[index[kept]] = True
    return use


def demodulate(residual: FloatArray, angle: FloatArray, order: float, interval: float) -> FloatArray:
    """The part of ``residual`` (n,) that is locked to ``order`` periods a turn of ``angle`` (rad), shape (n,)."""
    width = max(round(WINDOW / interval) | 1, 3)
    window = np.hanning(width + 2)[1:-1]
    carrier = np.exp(1j * order * angle)
    inside = fftconvolve(np.ones(residual.size), window, mode="same")
    amplitude = fftconvolve(residual * np.conj(carrier), window, mode="same") / np.maximum(inside, 1e-12)
    return np.asarray(2.0 * (amplitude * carrier).real)


def alias(speed: FloatArray, order: int, interval: float) -> FloatArray:
    """Frequency in Hz at which ripple of a rotor at ``speed`` (rad/s) appears in samples, shape (n,)."""
    rate = 1.0 / interval
    frequency = np.mod(order * np.abs(speed) / (2.0 * np.pi), rate)
    return np.minimum(frequency, rate - frequency)


def remove_ripple(
    time: FloatArray, residual: FloatArray, speed: FloatArray, orders: tuple[int, ...] = (1, 2)
) -> tuple[FloatArray, NDArray[np.bool_], tuple[Ripple, ...]]:
    """Ripple of one output.

    Parameters
    ----------
    time, residual, speed : ndarray, shape (n,)
        Even sample times in s, a fit's residual, and the fitted speed of the rotor in rad/s.

    Returns
    -------
    ndarray, shape (n,)
        What to subtract from the readings.
    ndarray of bool, shape (n,)
        Readings to drop, where a ripple that is there would look like slow physics.
    tuple of Ripple
    """
    n = time.size
    nothing = np.zeros(n), np.zeros(n, dtype=bool), ()
    if n < 200 or float(np.max(np.abs(speed))) < 1.0:
        return nothing
    interval = float(np.median(np.diff(time)))
    angle = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))))
    # Only what varies faster than the physics of a steady stretch can be ripple.
    width = max(round(0.5 / interval) | 1, 3)
    smooth = fftconvolve(residual, np.hanning(width + 2)[1:-1], mode="same")
    smooth /= fftconvolve(np.ones(n), np.hanning(width + 2)[1:-1], mode="same")
    fast = residual - smooth
    turning = np.abs(speed) > 0.1 * np.max(np.abs(speed))
    subtract, drop, found = np.zeros(n), np.zeros(n, dtype=bool), []
    for order in orders:
        clear = turning & (alias(speed, order, interval) > LOWEST_ALIAS)
        if clear.sum() < 100:
            continue
        locked = demodulate(fast, angle, order, interval)
        empty = [
            float(np.mean(demodulate(fast, angle, other, interval)[clear] ** 2))
            for other in (order * 0.83 + 0.017, order * 1.19 + 0.013)
        ]
        if float(np.mean(locked[clear] ** 2)) < DISTINCT * max(min(empty), 1e-300):
            continue
        amplitude = float(np.sqrt(2.0 * np.mean(locked[clear] ** 2)))
        subtract += np.where(clear, locked, 0.0)
        fast = fast - np.where(clear, locked, 0.0)
        if amplitude > 0.5 * float(np.std(fast[turning])):
            drop |= turning & ~clear
        found.append(Ripple(order, amplitude))
    return subtract, drop, tuple(found)

"""Ripple that is locked to the angle of a rotor, by regression on the integral of the recorded speed."""

from __future__ import annotations

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.differences import input_jumps
from aero_bayes.data.recording import Recording

#: Length in s of the segments within which the integrated angle keeps its phase.
SEGMENT_LENGTH = 0.5
#: Least median of an order's power over the segments, as a share of its mean: a ripple is in all of them, a vibration
#: that a jump sets off is strong in a few.
MIN_MEDIAN_SHARE = 0.25
#: Least speed of a rotor whose ripple is examined, in rad/s.
MIN_ROTOR_SPEED = 20.0


def _rotor_speed(recording: Recording) -> FloatArray | None:
    """Return the fastest of the outputs that are speeds in rad/s; None where none was recorded."""
    speeds = [y for name, y in recording.outputs.items() if recording.units.get(name) == "rad/s"]
    seen = [y for y in speeds if np.isfinite(y).any()]
    return max(seen, key=lambda y: float(np.nanmax(np.abs(y))), default=None)


def _rotor_angle(recording: Recording, speed: FloatArray) -> FloatArray:
    """Return the rotor's angle in rad from its recorded speed (trapezoidal rule)."""
    seen = np.isfinite(speed)
    filled = np.interp(recording.time, recording.time[seen], speed[seen])
    steps = 0.5 * (filled[1:] + filled[:-1]) * np.diff(recording.time)
    return np.concatenate(([0.0], np.cumsum(steps)))


def ripple_amplitudes(recording: Recording, output: str, orders: tuple[int, ...] = (1, 2)) -> dict[int, float]:
    """Compute the amplitude of the ripple of an output by order (periods a turn), in the unit of the output.

    It is averaged over segments in which the rotor turns and no input jumped shortly before. Orders that are not above
    the noise are left out, and so are orders that alias to a very low frequency."""
    speed = _rotor_speed(recording)
    if speed is None or recording.rate_hz <= 0.0:
        return {}
    values, time, angle = recording.outputs[output], recording.time, _rotor_angle(recording, speed)
    size = max(int(SEGMENT_LENGTH * recording.rate_hz), 24)
    jumps = input_jumps(time, list(recording.inputs.values()))
    powers: dict[int, list[tuple[float, float]]] = {order: [] for order in orders}
    for first in range(0, recording.rows - size + 1, size):
        part = slice(first, first + size)
        if jumps.size and ((jumps > time[part][0] - 0.2) & (jumps <= time[part][-1])).any():
            continue
        y, w = values[part], speed[part]
        ok = np.isfinite(y) & np.isfinite(w)
        if ok.sum() < 0.8 * size or np.abs(w[ok]).mean() < MIN_ROTOR_SPEED:
            continue
        _regress(y[ok], time[part][ok], angle[part][ok], orders, powers)
    found: dict[int, float] = {}
    for order, pairs in powers.items():
        if len(pairs) < 4:
            continue
        power, noise = np.mean(np.array(pairs), axis=0)
        lasting = float(np.median([p for p, _ in pairs])) > MIN_MEDIAN_SHARE * power
        if lasting and power > noise * (1.0 + 6.0 / np.sqrt(len(pairs))):
            found[order] = float(np.sqrt(power - noise))
    return found


def _regress(
    y: FloatArray,
    time: FloatArray,
    angle: FloatArray,
    orders: tuple[int, ...],
    powers: dict[int, list[tuple[float, float]]],
) -> None:
    """Add the squared amplitude of each order in one segment, and its expectation for noise alone."""
    t = (time - time[0]) / (time[-1] - time[0]) - 0.5
    columns = [np.ones_like(t), t, t**2, t**3]
    for order in orders:
        columns += [np.cos(order * angle), np.sin(order * angle)]
    design = np.column_stack(columns)
    gram = design.T @ design
    if np.linalg.cond(gram) > 1e6 or y.size <= design.shape[1] + 4:
        return
    inverse = np.linalg.inv(gram)
    solution = inverse @ (design.T @ y)
    residual = y - design @ solution
    variance = float(residual @ residual) / (y.size - design.shape[1])
    for k, order in enumerate(orders):
        a, b = 4 + 2 * k, 5 + 2 * k
        power = float(solution[a] ** 2 + solution[b] ** 2)
        powers[order].append((power, variance * float(inverse[a, a] + inverse[b, b])))

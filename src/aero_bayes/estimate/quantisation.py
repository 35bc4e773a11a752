"""Quantisation of outputs, as a fit shows it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.data.noise import quantisation_step
from aero_bayes.estimate.noise import OutputNoise
from aero_bayes.estimate.noise_estimation import estimate_noise


def quantum(values: FloatArray) -> float:
    """Step of quantised readings, such as an encoder's count; 0 for continuous ones."""
    return quantisation_step(values) or 0.0


def thin_constant_readings(
    time: FloatArray, values: FloatArray, longest: float = 0.5, keep: int = 3, spacing: float = 2.5
) -> NDArray[np.bool_]:
    """Return which readings to keep where a reading is constant for long, because equal readings
    are not independent."""
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


def rounding_error(time: FloatArray, fitted: FloatArray, step: float, zero: float = 0.0) -> OutputNoise:
    """Estimate the rounding error of a signal (n,), as noise: the least noise that an encoder has.

    The error of a signal that crosses many steps between samples is white, with standard deviation ``step / sqrt(12)``.
    That of a slow signal is correlated for as long as the signal takes for a step."""
    error = zero + step * np.round((fitted - zero) / step) - fitted
    return estimate_noise([time], [error], "auto")


Json = dict[str, Any]

#: Share of the residual's variance below which quantisation is not reported.
MIN_VARIANCE_SHARE = 1e-3


def describe_sensors(
    outputs: Sequence[str], recordings: Sequence[tuple[FloatArray, FloatArray, FloatArray]]
) -> dict[str, Json]:
    """Describe quantisation by output, as it goes into result.json; times, readings and fit of each recording."""
    found = {
        output: next((c for t, y, f in recordings if (c := _counts(t, y[:, k], f[:, k]))), None)
        for k, output in enumerate(outputs)
    }
    return {output: {"encoder": counts} for output, counts in found.items() if counts is not None}


def _counts(time: FloatArray, readings: FloatArray, fitted: FloatArray) -> Json | None:
    """Return the step of quantised readings, and the share of the residual's variance that is rounding; else None."""
    step = quantum(readings)
    variance = float(np.nanmean((readings - fitted) ** 2))
    if step == 0.0 or step**2 / 12.0 < MIN_VARIANCE_SHARE * variance:
        return None
    zero = float(readings[np.flatnonzero(np.isfinite(readings))[0]]) % step
    error = rounding_error(time, fitted, step, zero)
    return {"step": step, "share": min(1.0, error.sd**2 / max(variance, 1e-300))}

"""Whitening of residuals: innovations of a scalar Kalman filter, in units of their standard deviations.

Under white plus Ornstein-Uhlenbeck noise, the Kalman filter factorises the covariance ``C`` of a residual: the whitened
residual is ``L^-1 r`` with ``C = L L'``. The cost is O(n). The filter itself is compiled (``ab_whiten`` in
``simulation/native/noise.c``).
"""

from __future__ import annotations

import ctypes
import math
from functools import cache
from typing import Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.sensors.noise import OutputNoise, SampleTimes
from aero_bayes.simulation import engine_path

LOG_2PI = float(np.log(2.0 * np.pi))


@cache
def _compiled_filter() -> Any:
    whiten = ctypes.CDLL(str(engine_path())).ab_whiten
    array, count = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS"), ctypes.c_int64
    whiten.argtypes = [array, ctypes.c_double, count, array, count, array, count, array, array]
    whiten.restype = None
    return whiten


def whiten_rows(
    rows: FloatArray, time: FloatArray, noise: FloatArray, interval: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Compute innovations of rows over their standard deviations."""
    out = np.array(rows, dtype=np.float64, order="C")
    kinds = np.ascontiguousarray(np.atleast_2d(noise), dtype=np.float64)
    weight = np.empty((len(kinds), out.shape[1]))
    stamps = np.ascontiguousarray(time, dtype=np.float64)
    _compiled_filter()(stamps, interval, out.shape[1], kinds, len(kinds), out, len(out), np.zeros(len(out)), weight)
    return out, weight


def whiten(rows: FloatArray, sampling: SampleTimes, noise: OutputNoise) -> tuple[FloatArray, float]:
    """Whiten rows, and give the log-determinant of the noise covariance."""
    rows = sampling.equalised(rows)
    unequal = 0.0 if sampling.spread is None else 2.0 * float(np.sum(np.log(sampling.spread)))
    if noise.kind == "white":
        return rows / noise.sd_white, 2.0 * rows.shape[1] * math.log(noise.sd_white) + unequal
    white, weight = whiten_rows(
        rows, sampling.time, np.array(noise.as_row()), sampling.interval if sampling.even else 0.0
    )
    return white, unequal - 2.0 * float(np.sum(np.log(weight)))


def innovations(time: FloatArray, residual: FloatArray, noise: OutputNoise) -> FloatArray:
    """Compute one-step prediction errors over their standard deviations: white if the noise model is right."""
    sampling = SampleTimes.of(time, residual)
    out = np.full(residual.shape, np.nan)
    out[sampling.index] = whiten(residual[np.newaxis, sampling.index], sampling, noise)[0][0]
    return out


def log_density(time: FloatArray, residual: FloatArray, noise: OutputNoise) -> float:
    """Compute the Gaussian log-density of a residual."""
    sampling = SampleTimes.of(time, residual)
    return log_density_at(residual[sampling.index], sampling, noise)


def log_density_at(residual: FloatArray, sampling: SampleTimes, noise: OutputNoise) -> float:
    """Compute the Gaussian log-density of a residual (n,) at the readings of ``sampling``."""
    white, log_det = whiten(residual[np.newaxis], sampling, noise)
    return -0.5 * (float(white[0] @ white[0]) + log_det + residual.size * LOG_2PI)


def reading_log_density(time: FloatArray, residual: FloatArray, noise: FloatArray) -> FloatArray:
    """Compute the log-density of every reading given the earlier ones, for many residuals at once."""
    out = np.zeros(residual.shape)
    seen = np.flatnonzero(np.isfinite(residual).any(axis=0))
    white, weight = whiten_rows(residual[:, seen], time[seen], noise)
    out[:, seen] = np.log(weight) - 0.5 * (white**2 + LOG_2PI)
    return out

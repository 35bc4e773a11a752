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
    """Compute innovations of rows over their standard deviations.

    Parameters
    ----------
    rows : ndarray, shape (k, n)
        Without gaps: a time without a reading is left out.
    time : ndarray, shape (n,)
        Increasing times in s.
    noise : ndarray, shape (3,) or (k, 3)
        ``sd_white``, ``sd_ou`` and ``tau`` of all rows, or of each.
    interval : float
        Time step in s where all steps are equal, which is faster; 0 where they are not.

    Returns
    -------
    ndarray, shape (k, n)
    ndarray, shape (1, n) or (k, n)
        One over the standard deviation of each innovation.

    Raises
    ------
    CannotFinishError
        If the engine is not compiled.
    """
    out = np.array(rows, dtype=np.float64, order="C")
    kinds = np.ascontiguousarray(np.atleast_2d(noise), dtype=np.float64)
    weight = np.empty((len(kinds), out.shape[1]))
    stamps = np.ascontiguousarray(time, dtype=np.float64)
    _compiled_filter()(stamps, interval, out.shape[1], kinds, len(kinds), out, len(out), np.zeros(len(out)), weight)
    return out, weight


def whiten(rows: FloatArray, sampling: SampleTimes, noise: OutputNoise) -> tuple[FloatArray, float]:
    """Whiten rows, and give the log-determinant of the noise covariance.

    Parameters
    ----------
    rows : ndarray, shape (k, n)
        Residuals, or sensitivities, at the readings of ``sampling``.
    sampling : SampleTimes
    noise : OutputNoise

    Returns
    -------
    ndarray, shape (k, n)
        ``rows @ inv(L).T`` with ``C = L L'``. Inner products of these rows are those of the given rows under
        the inverse covariance.
    float
        log det C.
    """
    rows = sampling.equalised(rows)
    unequal = 0.0 if sampling.spread is None else 2.0 * float(np.sum(np.log(sampling.spread)))
    if noise.kind == "white":
        return rows / noise.sd_white, 2.0 * rows.shape[1] * math.log(noise.sd_white) + unequal
    white, weight = whiten_rows(
        rows, sampling.time, np.array(noise.as_row()), sampling.interval if sampling.even else 0.0
    )
    return white, unequal - 2.0 * float(np.sum(np.log(weight)))


def innovations(time: FloatArray, residual: FloatArray, noise: OutputNoise) -> FloatArray:
    """Compute one-step prediction errors over their standard deviations: white if the noise model is right.

    Parameters
    ----------
    time, residual : ndarray, shape (n,)
        Times in s; NaN where there is no reading.
    noise : OutputNoise

    Returns
    -------
    ndarray, shape (n,)
        NaN where the residual is NaN.
    """
    sampling = SampleTimes.of(time, residual)
    out = np.full(residual.shape, np.nan)
    out[sampling.index] = whiten(residual[np.newaxis, sampling.index], sampling, noise)[0][0]
    return out


def log_density(time: FloatArray, residual: FloatArray, noise: OutputNoise) -> float:
    """Compute the Gaussian log-density of a residual.

    Parameters
    ----------
    time : ndarray, shape (n,)
        In s.
    residual : ndarray, shape (n,)
        NaN for gaps.
    noise : OutputNoise

    Returns
    -------
    float
    """
    sampling = SampleTimes.of(time, residual)
    return log_density_at(residual[sampling.index], sampling, noise)


def log_density_at(residual: FloatArray, sampling: SampleTimes, noise: OutputNoise) -> float:
    """Compute the Gaussian log-density of a residual (n,) at the readings of ``sampling``.

    Parameters
    ----------
    residual : ndarray, shape (n,)
    sampling : SampleTimes
        Of its readings.
    noise : OutputNoise

    Returns
    -------
    float
    """
    white, log_det = whiten(residual[np.newaxis], sampling, noise)
    return -0.5 * (float(white[0] @ white[0]) + log_det + residual.size * LOG_2PI)


def reading_log_density(time: FloatArray, residual: FloatArray, noise: FloatArray) -> FloatArray:
    """Compute the log-density of every reading given the earlier ones, for many residuals at once.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Increasing times in s.
    residual : ndarray, shape (k, n)
        NaN where there is no reading, in all rows alike.
    noise : ndarray, shape (k, 3)
        As :func:`whiten_rows` takes it.

    Returns
    -------
    ndarray, shape (k, n)
        Zero where there is no reading.
    """
    out = np.zeros(residual.shape)
    seen = np.flatnonzero(np.isfinite(residual).any(axis=0))
    white, weight = whiten_rows(residual[:, seen], time[seen], noise)
    out[:, seen] = np.log(weight) - 0.5 * (white**2 + LOG_2PI)
    return out

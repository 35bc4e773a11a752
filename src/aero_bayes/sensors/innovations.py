"""Readings in units of their noise: a scalar Kalman filter, compiled."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aero_bayes.simulation import engine_path

FloatArray = NDArray[np.float64]
LOG_2PI = float(np.log(2.0 * np.pi))


@cache
def _compiled() -> Any:
    whiten = ctypes.CDLL(str(engine_path())).ab_whiten
    array, count = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS"), ctypes.c_int64
    whiten.argtypes = [array, ctypes.c_double, count, array, count, array, count, array, array]
    whiten.restype = None
    return whiten


def whiten_rows(
    rows: FloatArray, time: FloatArray, noise: FloatArray, interval: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Innovations of rows over their standard deviation, under white plus Ornstein-Uhlenbeck noise.

    Parameters
    ----------
    rows : ndarray, shape (k, n)
        Without gaps: a time without a reading is left out.
    time : ndarray, shape (n,)
        Increasing times in s.
    noise : ndarray, shape (3,) or (k, 3)
        Standard deviation of the white part, that of the process, and its correlation time in s; of all rows, or of
        each.
    interval : float
        Step in s where times are even, which is faster; zero where they are not.

    Returns
    -------
    ndarray, shape (k, n)
    ndarray, shape (1, n) or (k, n)
        One over the standard deviation of each innovation.

    Raises
    ------
    CannotFinishError
        Where the engine is not compiled.
    """
    out = np.array(rows, dtype=np.float64, order="C")
    kinds = np.ascontiguousarray(np.atleast_2d(noise), dtype=np.float64)
    weight = np.empty((len(kinds), out.shape[1]))
    stamps = np.ascontiguousarray(time, dtype=np.float64)
    _compiled()(stamps, interval, out.shape[1], kinds, len(kinds), out, len(out), np.zeros(len(out)), weight)
    return out, weight


def reading_log_density(time: FloatArray, residual: FloatArray, noise: FloatArray) -> FloatArray:
    """Log-density of every reading given the earlier ones, for many residuals at once.

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

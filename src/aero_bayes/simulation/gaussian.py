"""Likelihood of residuals under white plus Ornstein-Uhlenbeck noise, from the banded precision of the process.

The reference for the engine's innovations filter, by an independent method: with Q the tridiagonal precision of the
Ornstein-Uhlenbeck process at the sample times (Rue, 2001, J. R. Stat. Soc. B 63, 325) and s2 the variance of the white
noise, K = Q^-1 + s2 I, so K^-1 = Q (I + s2 Q)^-1 and det K = det(I + s2 Q) / det Q.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from aero_bayes.arrays import FloatArray

#: Standard deviations of a normal density on either side of its mean that hold 90 %.
NORMAL_HALF_WIDTH = 1.6448536269514722


def ou_precision(time: FloatArray, sd: float, tau: float) -> tuple[FloatArray, FloatArray, float]:
    """Diagonal, off-diagonal and log-determinant of the precision of an Ornstein-Uhlenbeck process."""
    phi = np.exp(-np.diff(time) / tau)
    fresh = -np.expm1(-2.0 * np.diff(time) / tau)
    diagonal = np.ones(time.size)
    diagonal[:-1] += phi**2 / fresh
    diagonal[1:] += phi**2 / fresh
    log_det = -time.size * 2.0 * np.log(sd) - float(np.sum(np.log(fresh)))
    return diagonal / sd**2, -phi / fresh / sd**2, log_det


def apply_inverse_covariance(time: FloatArray, noise: FloatArray, columns: FloatArray) -> tuple[FloatArray, float]:
    """K^-1 times each column, and log det K."""
    white, sd, tau = (float(v) for v in noise)
    if sd == 0.0 or tau <= 0.0:
        variance = white**2 + sd**2
        return columns / variance, time.size * float(np.log(variance))
    diagonal, off, log_det = ou_precision(time, sd, tau)
    band = np.zeros((2, time.size))
    band[0] = 1.0 + white**2 * diagonal
    band[1, :-1] = white**2 * off
    factor = cholesky_banded(band, lower=True)
    solved = cho_solve_banded((factor, True), columns)
    weighed = diagonal[:, None] * solved
    weighed[:-1] += off[:, None] * solved[1:]
    weighed[1:] += off[:, None] * solved[:-1]
    return weighed, 2.0 * float(np.sum(np.log(factor[0]))) - log_det


def gauss_newton_products(
    time: FloatArray, measured: FloatArray, output: FloatArray, sensitivity: FloatArray, noise: FloatArray
) -> tuple[float, FloatArray, FloatArray, float]:
    """Cost, gradient, Gauss-Newton matrix and log-likelihood of one experiment."""
    q = sensitivity.shape[2]
    cost, log_likelihood, gradient, hessian = 0.0, 0.0, np.zeros(q), np.zeros((q, q))
    for index in range(measured.shape[1]):
        seen = ~np.isnan(measured[:, index])
        if not seen.any():
            continue
        residual = output[seen, index] - measured[seen, index]
        slopes = sensitivity[seen, index]
        weighed, log_det = apply_inverse_covariance(time[seen], noise[index], np.column_stack([residual, slopes]))
        cost += 0.5 * float(residual @ weighed[:, 0])
        gradient += slopes.T @ weighed[:, 0]
        hessian += slopes.T @ weighed[:, 1:]
        log_likelihood -= 0.5 * (log_det + residual.size * float(np.log(2.0 * np.pi)))
    return cost, gradient, hessian, log_likelihood - cost

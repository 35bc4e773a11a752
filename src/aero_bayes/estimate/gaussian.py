"""The Gaussian approximation of a posterior: its covariance by one rule for all users, and its volume."""

from __future__ import annotations

import math

import numpy as np

from aero_bayes.arrays import FloatArray

#: Least eigenvalue of a Hessian that is scaled to a unit diagonal, as a share of the largest: below, it is rounding.
MIN_EIGENVALUE = 1e-12


def parameter_covariance(hessian: FloatArray, prior_sd: FloatArray) -> FloatArray:
    """Invert a Hessian (f, f) that contains the priors; a direction flatter than its prior gets the width of the prior.

    ``prior_sd`` (f,) are standard deviations of the priors in the same coordinates."""
    scaled = hessian * prior_sd[:, None] * prior_sd[None, :]
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    inverse = (vectors / np.maximum(values, 1.0)) @ vectors.T
    return np.asarray(inverse * prior_sd[:, None] * prior_sd[None, :])


def log_precision(hessian: FloatArray, width: FloatArray) -> float:
    """Compute the log-determinant of the precision of a Gaussian posterior in a box of a given width (f,).

    The Hessian (f, f) is scaled to a unit diagonal first, so that its small eigenvalues are directions that the data do
    not determine, whatever the units of the coordinates."""
    if not len(hessian):
        return 0.0
    unit, values, vectors = _scaled(hessian)
    # The posterior is nowhere wider than the box: in a direction that the data do not determine it has the box's width.
    limited = (vectors * values) @ vectors.T + np.diag(2.0 * math.pi * (unit / width) ** 2)
    return float(np.linalg.slogdet(limited)[1]) - 2.0 * float(np.log(unit).sum())


def unlimited_sd(hessian: FloatArray) -> FloatArray:
    """Compute standard deviations (f,) of a Gaussian by its Hessian alone: huge where nothing determines it."""
    unit, values, vectors = _scaled(hessian)
    return np.asarray(unit * np.sqrt(np.sum(vectors**2 / values, axis=1)))


def _scaled(hessian: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Scale a Hessian to a unit diagonal: the units (f,), its eigenvalues there, never zero, and its eigenvectors."""
    own = np.diag(hessian)
    unit = 1.0 / np.sqrt(np.where(own > 0.0, own, 1.0))
    values, vectors = np.linalg.eigh(hessian * np.outer(unit, unit))
    return unit, np.maximum(values, MIN_EIGENVALUE * max(float(values[-1]), 1.0)), vectors

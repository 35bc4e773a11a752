"""The response of a filter to a term with a small coefficient, against the same filter run with the term."""

from __future__ import annotations

import numpy as np
import pytest

from aero_bayes.search.formula_gains import prediction_slopes
from aero_bayes.simulation.interface import FilteredStates

pytestmark = pytest.mark.fast

A = np.array([[-0.5, 1.0], [0.2, -0.8]])
STEP, SAMPLES = 0.01, 300
READ, Q, R = np.array([[1.0, 0.0]]), np.diag([1e-3, 4e-3]), 0.02


def filtered(measured: np.ndarray, force: np.ndarray) -> FilteredStates:
    """A Kalman filter of two states, one of them read, with a force on the other along straight lines in between."""
    step = np.linalg.inv(np.eye(2) - STEP / 2 * A) @ (np.eye(2) + STEP / 2 * A)
    mean, covariance, push = np.zeros(2), np.eye(2), np.array([0.0, 1.0])
    rows = []
    for k in range(SAMPLES):
        if k:
            mean = step @ mean + STEP / 2 * (step @ push * force[k - 1] + push * force[k])
            covariance = step @ covariance @ step.T + Q * STEP
        variance = float(READ[0] @ covariance @ READ[0]) + R
        rows.append((mean, covariance, step, READ, np.array([READ[0] @ mean]), np.array([variance])))
        if np.isfinite(measured[k, 0]):
            gain = covariance @ READ[0] / variance
            mean = mean + gain * (measured[k, 0] - READ[0] @ mean)
            covariance = covariance - np.outer(gain, gain) * variance
    return FilteredStates(*(np.array([row[i] for row in rows]) for i in range(6)))


def test_slopes_of_predictions_are_those_of_a_filter_with_the_term() -> None:
    rng = np.random.default_rng(4)
    time = np.arange(SAMPLES) * STEP
    measured = np.where(rng.random((SAMPLES, 1)) < 0.6, rng.normal(0.0, 1.0, (SAMPLES, 1)), np.nan)
    terms = np.column_stack([np.sin(3.0 * time), time**2, np.ones(SAMPLES)])
    plain = filtered(measured, np.zeros(SAMPLES))
    found = prediction_slopes(plain, time, measured, 1, terms)
    read = np.isfinite(measured[:, 0])
    for k in range(3):
        with_term = filtered(measured, terms[:, k])
        change = (with_term.predicted - plain.predicted)[read, 0]
        assert np.max(np.abs(change)) > 1e-3
        np.testing.assert_allclose(found[read, 0, k], change, rtol=1e-9, atol=1e-12)

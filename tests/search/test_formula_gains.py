"""The response of a filter to a term with a small coefficient, against the same filter run with the term."""

from __future__ import annotations

import numpy as np
import pytest

from aero_bayes.search.formula_gains import SampledTerms, prediction_slopes
from aero_bayes.simulation.interface import FilteredStates

pytestmark = pytest.mark.fast

A = np.array([[-0.5, 1.0, 0.0], [0.2, -0.8, 1.0], [0.0, 0.0, 0.0]])
STEP, SAMPLES, SIGNAL = 0.01, 300, 2
Q, R = np.diag([1e-3, 4e-3, 0.0]), 0.02


def filtered(measured: np.ndarray, force: np.ndarray, read: np.ndarray) -> FilteredStates:
    """A Kalman filter of two states and an unknown signal without uncertainty, which is a given force."""
    step = np.linalg.inv(np.eye(3) - STEP / 2 * A) @ (np.eye(3) + STEP / 2 * A)
    mean, covariance = np.zeros(3), np.diag([1.0, 1.0, 0.0])
    rows = []
    for k in range(SAMPLES):
        if k:
            mean[SIGNAL] = 0.5 * (force[k - 1] + force[k])
            mean = step @ mean
            covariance = step @ covariance @ step.T + Q * STEP
        mean[SIGNAL] = force[k]
        variance = float(read @ covariance @ read) + R
        rows.append((mean.copy(), covariance, step, read[None], np.array([read @ mean]), np.array([variance])))
        if np.isfinite(measured[k, 0]):
            gain = covariance @ read / variance
            mean = mean + gain * (measured[k, 0] - read @ mean)
            covariance = covariance - np.outer(gain, gain) * variance
    return FilteredStates(*(np.array([row[i] for row in rows]) for i in range(6)))


@pytest.mark.parametrize("read", [[1.0, 0.0, 0.0], [1.0, 0.0, 1.0]], ids=["in a rate", "in a reading, too"])
def test_slopes_of_predictions_are_those_of_a_filter_with_the_term(read: list[float]) -> None:
    h = np.array(read)
    rng = np.random.default_rng(4)
    time = np.arange(SAMPLES) * STEP
    measured = np.where(rng.random((SAMPLES, 1)) < 0.6, rng.normal(0.0, 1.0, (SAMPLES, 1)), np.nan)
    terms = np.column_stack([np.sin(3.0 * time), time**2, np.ones(SAMPLES)])
    plain = filtered(measured, np.zeros(SAMPLES), h)
    found = prediction_slopes(plain, measured, SIGNAL, SampledTerms(terms, terms, terms))
    there = np.isfinite(measured[:, 0])
    for k in range(3):
        with_term = filtered(measured, terms[:, k], h)
        change = (with_term.predicted - plain.predicted)[there, 0]
        assert np.max(np.abs(change)) > 1e-3
        np.testing.assert_allclose(found[there, 0, k], change, rtol=1e-9, atol=1e-12)

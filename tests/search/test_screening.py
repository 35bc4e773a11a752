"""What a term promises beside a fit, and the size that would be seen: exact for linear models (least squares)."""

from __future__ import annotations

import numpy as np
import pytest
from test_folds import PRIOR_SD, TIME, free, rows, study

from aero_bayes.loop.folds import Folds
from aero_bayes.loop.screen import Screen

pytestmark = pytest.mark.fast


def screened(size):
    """The first model without a wave, fitted to readings that have one, and the wave screened beside it."""
    x = rows(TIME)
    y = x @ [1.0, 2.0, size] + 0.1 * np.random.default_rng(3).normal(size=TIME.size)
    fitted = study([TIME], [y[:, None]], lambda t, k: rows(t), [free(n) for n in "abc"], 2)[-1]
    return x, y, Screen(fitted, fitted.model, "wave", Folds.of(fitted)).run()


def ridge(x, y):
    """Squared residual of a ridge regression under the same prior."""
    p = np.linalg.solve(x.T @ x + 0.1**2 * np.eye(x.shape[1]) / PRIOR_SD**2, x.T @ y)
    return y - x @ p


@pytest.mark.parametrize("size", [0.05, 1.0])
def test_a_promise_is_the_fall_of_the_error_by_least_squares(size):
    x, y, found = screened(size)
    before, after = (np.sum(ridge(part, y) ** 2) for part in (x[:, :2], x))
    assert found.gain == pytest.approx(0.5 * np.log(before / after), rel=1e-3)


def test_the_smallest_size_raises_what_is_left_by_a_third():
    """Readings of that size, the first model fitted to them, leave four thirds of what the noise alone leaves."""
    x, y, found = screened(0.0)
    more = ridge(x[:, :2], y + found.smallest * x[:, 2]), ridge(x[:, :2], y - found.smallest * x[:, 2])
    alone = ridge(x[:, :2], y)
    assert np.mean([np.sum(r**2) for r in more]) == pytest.approx(np.sum(alone**2) / 0.75**2, rel=1e-3)
    assert (found.port, found.parameter) == ("one", ("c", "1"))

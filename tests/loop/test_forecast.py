"""How long a search will take is said before it begins, where it is long."""

from __future__ import annotations

import pytest

from aero_bayes.loop.forecast import forecast_duration

pytestmark = pytest.mark.fast


@pytest.mark.parametrize(
    ("run", "workers", "limit", "said"),
    [
        (0.001, 1, 20.0, ""),
        (0.06, 1, 20.0, "8 min (40 candidates, 60 ms"),
        (0.06, 2, 20.0, " 4 min"),
        (0.06, 1, 5.0, " 5 min"),
        (6.0, 1, 20.0, " 20 min"),
    ],
)
def test_a_long_search_says_how_long(run: float, workers: int, limit: float, said: str):
    told = forecast_duration(run, 40, workers, limit)
    assert bool(told) == bool(said)
    assert said in told
    assert all(key in told for key in ("ports", "laws", "exclude", f"max_minutes = {limit:g}") if told)

"""How long a search will take is said before it begins, where it is long."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from aero_bayes.loop import forecast


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
def test_a_long_search_says_how_long(
    run: float, workers: int, limit: float, said: str, monkeypatch: pytest.MonkeyPatch
):
    clock, told = [0.0], []

    def evaluate(*_: object) -> None:
        clock[0] += run

    monkeypatch.setattr(forecast.time, "perf_counter", lambda: clock[0])
    first = SimpleNamespace(
        model=SimpleNamespace(objective=SimpleNamespace(evaluate=evaluate)),
        optimum=SimpleNamespace(coordinates=None, free=()),
    )
    context = SimpleNamespace(
        settings=SimpleNamespace(max_minutes=limit), pool=SimpleNamespace(size=workers),
        progress=lambda what, share: told.append(what),
    )  # fmt: skip
    forecast.announce_duration(context, first, 40)  # type: ignore[arg-type]
    assert bool(told) == bool(said)
    for line in told:
        assert said in line
        assert f"max_minutes = {limit:g}" in line
        assert all(key in line for key in ("ports", "laws", "exclude"))

"""Timings in pairs: two calls run one after the other in every round, so that both see the same machine."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# Recordings are simulated by the studies' packages.
sys.path.append(str(Path(__file__).resolve().parents[1] / "studies"))


@dataclass(frozen=True)
class Pair:
    """A row of the report: how often the second call goes into the first.

    The ratio, ``key`` in ``bench.json``, is that of the times of one of the ``units`` of work that each call does;
    ``error`` is the largest one of the second over the range.
    """

    key: str
    name: str
    first: Callable[[], Any]
    second: Callable[[], Any]
    units: tuple[int, int] = (1, 1)
    error: float | None = None


@dataclass(frozen=True)
class Row:
    """A pair that was timed: seconds a unit (medians), and the ratio's median and quartiles over the rounds."""

    key: str
    name: str
    first_s: float | None = None
    second_s: float | None = None
    ratio: float | None = None
    low: float | None = None
    high: float | None = None
    error: float | None = None
    note: str = ""

    def line(self) -> str:
        """Write the row for the terminal."""
        if self.ratio is None:
            return f"{self.key:<34} {'not measured':>12}  {self.name}: {self.note}"
        spread = "" if self.low is None else f"[{self.low:.4g}, {self.high:.4g}]"
        return f"{self.key:<34} {self.ratio:>12.4g}  {spread:<20} {self.name}{': ' if self.note else ''}{self.note}"


def time_pair(pair: Pair, rounds: int) -> Row:
    """Time both calls round by round after one call of each to warm up."""
    seconds: tuple[list[float], list[float]] = ([], [])
    for round_ in range(rounds + 1):
        for call, units, found in zip((pair.first, pair.second), pair.units, seconds, strict=True):
            began = time.perf_counter()
            call()
            if round_:
                found.append((time.perf_counter() - began) / units)
    ratios = [a / b for a, b in zip(*seconds, strict=True)]
    low, middle, high = statistics.quantiles(ratios, n=4) if rounds > 1 else ratios * 3
    first, second = (statistics.median(found) for found in seconds)
    return Row(pair.key, pair.name, first, second, middle, low, high, pair.error)

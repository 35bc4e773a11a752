"""What was found wrong with the readings of a recording, and what was done about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

FindingKind = Literal[
    "sentinel", "outliers", "stuck", "clipped", "gap", "clock", "wrapped", "rounded", "quality", "unit", "sign", "swap"
]

#: Times or rows of a finding that are told one by one.
MOST_TOLD = 6


@dataclass(frozen=True)
class DataFinding:
    """A fault of the readings."""

    kind: FindingKind
    recording: str
    signal: str
    what: str
    where: str
    done: str
    mended: bool

    @property
    def sentence(self) -> str:
        """All of it as text."""
        where = f" ({self.where})" if self.where else ""
        return f"{self.what.removesuffix('.')}{where}. {self.done}"


def told_numbers(numbers: Sequence[float], unit: str = "") -> str:
    """Write numbers in a sentence, the first few of many."""
    shown = ", ".join(f"{number:.7g}" for number in numbers[:MOST_TOLD])
    more = len(numbers) - MOST_TOLD
    return f"{shown}{f' {unit}' if unit else ''}{f' and {more} more' if more > 0 else ''}"


def runs_of(rows: Sequence[int]) -> str:
    """Write row numbers in a sentence, successive ones as a range: ``3, 7 to 9``."""
    parts: list[str] = []
    ranges: list[tuple[int, int]] = []
    for row in rows:
        if ranges and row == ranges[-1][1] + 1:
            ranges[-1] = ranges[-1][0], row
        else:
            ranges.append((row, row))
    parts = [f"{first}" if first == last else f"{first} to {last}" for first, last in ranges[:MOST_TOLD]]
    more = len(ranges) - MOST_TOLD
    return ", ".join(parts) + (f" and {more} more" if more > 0 else "")

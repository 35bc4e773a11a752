"""Compare fits with different values of parameters that no search can move, by the log-posterior."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from aero_bayes.estimate.identifiability import Status
from aero_bayes.estimate.listed_values import ListedValue, value_text, values_text
from aero_bayes.estimate.parameter_estimates import Estimate

Json = dict[str, object]


@dataclass(frozen=True)
class ValueTrial:
    """A fit with some values of the listed parameters."""

    values: Mapping[str, ListedValue]
    numbers: Mapping[str, float] = field(default_factory=dict)
    modifiers: Mapping[str, str] = field(default_factory=dict)
    share: float = 0.0
    worse_by: float = math.inf
    failed: str = ""

    def to_dict(self) -> Json:
        """Return the entry of result.json."""
        return {"values": dict(self.values), "share": self.share, "worse_by": self.worse_by, "failed": self.failed}


def chosen_estimates(trials: Sequence[ValueTrial]) -> dict[str, Estimate]:
    """Return the listed parameters as entries of the table of parameters."""
    table = {}
    for name, value in trials[0].values.items() if trials else ():
        tried = ", ".join(dict.fromkeys(value_text(t.values[name]) for t in trials))
        number = trials[0].numbers[name]
        table[name] = Estimate(
            name, number, None, None, None, None, "", Status.FIXED, note=f"{value_text(value)}: likeliest of {tried}"
        )
    return table


def trials_sentence(trials: Sequence[ValueTrial]) -> str:
    """Say which of the listed values is reported, and how much worse the others are; empty where none are listed."""
    if not trials:
        return ""
    others = [
        f"{values_text(t.values)} failed" if t.failed else f"{values_text(t.values)} ({_percent(t.share)} likely, "
        f"log-posterior lower by {t.worse_by:.3g})"
        for t in trials[1:]
    ]  # fmt: skip
    beside = f"; others: {', '.join(others)}" if others else ""
    best = f"{values_text(trials[0].values)} is reported ({_percent(trials[0].share)} likely)"
    return f"Of the listed values {best}{beside}."


def _percent(share: float) -> str:
    if share < 1e-3:
        return "less than 0.1 %"
    return "more than 99.9 %" if share > 0.999 else f"{100.0 * share:.3g} %"

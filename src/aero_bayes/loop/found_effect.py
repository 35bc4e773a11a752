"""An effect that the loop added to the model: its parameters, its evidence and its curve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from aero_bayes.arrays import FloatArray


@dataclass(frozen=True)
class NewParameter:
    """A parameter of the model that came out: value, standard deviation and central 90 % interval in SI units."""

    name: str
    value: float
    sd: float
    q05: float
    q95: float
    unit: str
    description: str

    def __float__(self) -> float:
        return self.value

    def to_dict(self) -> dict[str, object]:
        return {
            "value": self.value,
            "sd": self.sd,
            "q05": self.q05,
            "q50": self.value,
            "q95": self.q95,
            "unit": self.unit,
        }


@dataclass(frozen=True, eq=False)
class LearnedCurve:
    """What a port gives over a signal: ``x``, ``value`` and its standard deviation ``sd``, shape (n,) each."""

    x: FloatArray
    value: FloatArray
    sd: FloatArray
    x_unit: str
    unit: str

    def to_dict(self) -> dict[str, object]:
        numbers = {name: getattr(self, name).tolist() for name in ("x", "value", "sd")}
        return {**numbers, "x_unit": self.x_unit, "unit": self.unit}


@dataclass(frozen=True)
class FoundEffect:
    """An effect that earned its place.

    ``share`` is the error on left-out readings with it over that without it, in the output ``share_of`` where it falls
    most, and ``share_sd`` its standard error."""

    id: str
    port: str
    kind: Literal["catalogue", "free_form"]
    parameters: tuple[NewParameter, ...]
    share: float
    share_sd: float
    share_of: str
    wins: float | None
    summary: str
    widths: Mapping[str, float] = field(default_factory=dict)
    width_influence: float | None = None
    over: str = ""
    looks_like: str = ""
    curve: LearnedCurve | None = None

    def to_dict(self, modelica: str) -> dict[str, object]:
        found: dict[str, object] = {
            "id": self.id,
            "port": self.port,
            "kind": self.kind,
            "parameters": {p.name: p.to_dict() for p in self.parameters},
            "share": self.share,
            "share_sd": self.share_sd,
            "share_of": self.share_of,
            "wins": self.wins,
            "modelica": modelica,
            "summary": self.summary,
            "widths": dict(self.widths),
            "width_influence_sd": self.width_influence,
        }
        if self.over:
            found["over"] = self.over
            found["looks_like"] = self.looks_like
        if self.curve is not None:
            found["curve"] = self.curve.to_dict()
        return found

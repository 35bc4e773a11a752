"""An effect that the loop added to the model: its parameters, what is claimed of it, and its curve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from aero_bayes.arrays import FloatArray
from aero_bayes.loop.decide import ClaimKind


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
        numbers = {name: getattr(self, name) for name in ("value", "sd", "q05", "q95", "unit")}
        return {**numbers, "q50": self.value}


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
class Alternative:
    """What does as well in the place of an effect: ``error_ratio`` is the left-out error with it over that with the
    effect."""

    id: str
    port: str
    error_ratio: float


@dataclass(frozen=True)
class FoundEffect:
    """An effect that was added, and what is claimed of it.

    ``share`` is the error on left-out readings with it over that without it, in the output ``share_of`` where it falls
    most, and ``share_sd`` its standard error. ``claim`` is None for one that the configuration requires."""

    id: str
    port: str
    kind: Literal["catalogue", "free_form"]
    parameters: tuple[NewParameter, ...]
    share: float
    share_sd: float
    share_of: str
    claim: ClaimKind | None
    alternatives: tuple[Alternative, ...]
    summary: str
    widths: Mapping[str, float] = field(default_factory=dict)
    over: str = ""
    looks_like: str = ""
    curve: LearnedCurve | None = None

    def to_dict(self, modelica: str) -> dict[str, object]:
        """Return the entry of result.json; ``modelica`` is the file that holds it."""
        found: dict[str, object] = {**vars(self), "modelica": modelica, "widths": dict(self.widths)}
        found["parameters"] = {p.name: p.to_dict() for p in self.parameters}
        found["alternatives"] = [vars(one) for one in self.alternatives]
        found["curve"] = None if self.curve is None else self.curve.to_dict()
        return found

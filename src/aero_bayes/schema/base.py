"""What all parts of a result share: frozen models, and values with their spread."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict

Status = Literal["identified", "weak", "unidentified", "fixed", "at_bound"]
Level = Literal["good", "warning", "bad"]
Number = float | None


class Part(BaseModel):
    """A table of the result. Keys that are not named here are kept (see :func:`aero_bayes.schema.undeclared`)."""

    model_config = ConfigDict(frozen=True, extra="allow", populate_by_name=True, allow_inf_nan=False)


class Quantiles(Part):
    """A value with its standard deviation and quantiles; no spread where the data give none."""

    value: Number = None
    sd: Number = None
    q05: Number = None
    q50: Number = None
    q95: Number = None
    unit: str = ""
    description: str = ""


class ParameterResult(Quantiles):
    """A parameter: its estimate, where it was searched, and what the data say of it."""

    status: Status | None = None
    prior: str = ""
    start: Number = None
    lower: Number = None
    upper: Number = None
    note: str = ""
    recording: str = ""


class Verdict(Part):
    """The run in one sentence, and how to take it."""

    level: Level
    text: str

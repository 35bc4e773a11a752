"""Base classes of a result: frozen models, and values with their spread."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict

Status = Literal["identified", "weak", "unidentified", "fixed", "at_bound"]
Level = Literal["good", "warning", "bad"]
JsonNumber = float | None


class JsonTable(BaseModel):
    """A table of the result. Keys that are not named here are kept (see :func:`aero_bayes.schema.undeclared`)."""

    model_config = ConfigDict(frozen=True, extra="allow", populate_by_name=True, allow_inf_nan=False)


class QuantilesJson(JsonTable):
    """A value with its standard deviation and quantiles; no spread where the data give none."""

    value: JsonNumber = None
    sd: JsonNumber = None
    q05: JsonNumber = None
    q50: JsonNumber = None
    q95: JsonNumber = None
    unit: str = ""
    description: str = ""


class ParameterJson(QuantilesJson):
    """A parameter: its estimate, search range, prior and status."""

    status: Status | None = None
    prior: str = ""
    start: JsonNumber = None
    lower: JsonNumber = None
    upper: JsonNumber = None
    note: str = ""
    recording: str = ""


class VerdictJson(JsonTable):
    """Summary of the run in a sentence, with a level."""

    level: Level
    text: str

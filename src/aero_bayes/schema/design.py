"""The next experiment in a result."""

from __future__ import annotations

from typing import Literal

from aero_bayes.schema.base import JsonNumber, JsonTable, ParameterJson


class DesignedParameterJson(JsonTable):
    """A parameter's standard deviation now, and expected after the experiment."""

    value: JsonNumber
    unit: str = ""
    sd_before: JsonNumber
    sd_after: JsonNumber = None
    sd_repeated: JsonNumber = None
    gain: JsonNumber = None
    target: bool = False


class DesignLimitsJson(JsonTable):
    """Limits of the rig."""

    amplifier: JsonNumber = None
    travel: dict[str, JsonNumber] = {}


class RivalJson(JsonTable):
    """One of two effects to tell apart, as fitted to the present recordings."""

    id: str
    model: str = ""
    parameters: dict[str, ParameterJson] = {}


class DesignJson(JsonTable):
    """The proposed experiment."""

    kind: Literal["narrow", "separate"] = "narrow"
    input: str
    unit: str = ""
    family: str = ""
    families: dict[str, JsonNumber] = {}
    duration: float
    rate_hz: JsonNumber = None
    gain: JsonNumber = None
    parameters: dict[str, DesignedParameterJson] = {}
    travel: dict[str, JsonNumber] = {}
    limits: DesignLimitsJson = DesignLimitsJson()
    table: dict[str, list[JsonNumber]] = {}
    seed: int | None = None
    file: str = ""
    effects: list[str] = []
    log_posterior_now: list[JsonNumber] = []
    models: list[RivalJson] = []
    log_evidence: JsonNumber = None
    first_true: JsonNumber = None
    second_true: JsonNumber = None

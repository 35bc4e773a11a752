"""The next experiment in a result."""

from __future__ import annotations

from typing import Literal

from aero_bayes.schema.base import Number, ParameterResult, Part


class DesignedParameter(Part):
    """A parameter's standard deviation now, expected after the experiment, and in simulated repetitions."""

    value: Number
    unit: str = ""
    sd_before: Number
    sd_after: Number = None
    sd_repeated: Number = None
    sd_achieved: Number = None
    gain: Number = None
    target: bool = False


class DesignLimits(Part):
    """What the rig allows."""

    amplifier: Number = None
    travel: dict[str, Number] = {}


class DesignCheck(Part):
    """Simulated repetitions of the proposal."""

    repeats: int = 0
    failures: int = 0
    agrees: bool | None = None
    expected: dict[str, Number] = {}
    realised: dict[str, Number] = {}
    first_true: Number = None
    second_true: Number = None
    achieved: Number = None
    told_apart: Number = None
    decisive: Number = None


class RivalResult(Part):
    """One of two effects to tell apart, as fitted to the recordings at hand."""

    id: str
    model: str = ""
    parameters: dict[str, ParameterResult] = {}


class DesignResult(Part):
    """The proposed experiment."""

    kind: Literal["narrow", "separate"] = "narrow"
    input: str
    unit: str = ""
    family: str = ""
    families: dict[str, Number] = {}
    duration: float
    rate_hz: Number = None
    gain: Number = None
    parameters: dict[str, DesignedParameter] = {}
    travel: dict[str, Number] = {}
    limits: DesignLimits = DesignLimits()
    table: dict[str, list[Number]] = {}
    seed: int | None = None
    file: str = ""
    check: DesignCheck = DesignCheck()
    effects: list[str] = []
    common: list[str] = []
    log_posterior_now: list[Number] = []
    models: list[RivalResult] = []
    log_evidence: Number = None
    first_true: Number = None
    second_true: Number = None

"""The section of ``result.json`` on the loop."""

from __future__ import annotations

from typing import Literal

from aero_bayes.report.schema_estimate import DiagnosisJson, JsonNumber, JsonTable, ParameterJson, ResidualJson


class CurveJson(JsonTable):
    """A learned curve: output of the port as a function of a signal, and its standard deviation."""

    x: list[float]
    value: list[float]
    sd: list[float]
    x_unit: str = ""
    unit: str = ""


class AlternativeJson(JsonTable):
    """What does as well in the place of an effect: the left-out error with it over that with the effect."""

    id: str
    port: str = ""
    error_ratio: JsonNumber = None


class LimitJson(JsonTable):
    """The smallest size of a law at a port that would have been named: a value of its first parameter."""

    law: str
    port: str
    parameter: str
    smallest: JsonNumber
    unit: str = ""


class EffectJson(JsonTable):
    """An effect; ``id`` is ``law@port``, ``value@parameter`` or an id of a library.

    ``share`` is the error on left-out readings with it over that without it, in the output ``share_of``; ``claim`` what
    is known of it; ``looks_like`` the law that comes near a curve."""

    id: str
    port: str
    kind: Literal["catalogue", "free_form"]
    parameters: dict[str, ParameterJson] = {}
    share: JsonNumber = None
    share_sd: JsonNumber = None
    share_of: str = ""
    claim: Literal["law", "place", "one of"] | None = None
    alternatives: list[AlternativeJson] = []
    modelica: str = ""
    summary: str = ""
    widths: dict[str, JsonNumber] = {}
    over: str = ""
    looks_like: str = ""
    curve: CurveJson | None = None


class CandidateJson(JsonTable):
    """A candidate of a round: error on left-out readings with it over that without it."""

    id: str
    port: str
    share: JsonNumber = None
    share_sd: JsonNumber = None
    refitted: bool = True


class StepJson(JsonTable):
    """A step: one term beside those of the steps before, and its rivals."""

    round: int
    candidates: list[CandidateJson] = []
    chosen: str | None = None
    equivalent: list[str] = []
    why: str = ""


class ShiftJson(JsonTable):
    """How far a base parameter moved."""

    before: JsonNumber
    before_sd: JsonNumber
    after: JsonNumber
    after_sd: JsonNumber
    in_sd: JsonNumber


RmsByRole = dict[str, dict[str, JsonNumber]]


class RecordingErrorJson(JsonTable):
    """RMS error of an output in one recording, or in the part of it that begins at ``begin`` (s), before and after.

    ``noise`` is that of the recording, or of the fit where ``noise_known`` is false; ``verdict`` is of the model that
    came out."""

    recording: str
    role: Literal["train", "test"]
    output: str
    before: JsonNumber = None
    after: JsonNumber
    noise: JsonNumber
    noise_known: bool
    ratio: JsonNumber = None
    p_value: JsonNumber = None
    verdict: Literal["noise", "structured", "too large"]
    begin: JsonNumber = None


class LoopJson(JsonTable):
    """The closed loop; ``before``, ``after`` and their like are by role (train, test) and output.

    ``blocks`` of readings were left out in turn; ``refused`` are models that unseen recordings refused."""

    outcome: Literal["adequate", "extended", "unexplained"]
    sentence: str = ""
    base: str = ""
    model: str = ""
    effects: list[EffectJson] = []
    equivalent: list[list[str]] = []
    limits: list[LimitJson] = []
    errors: list[RecordingErrorJson] = []
    diagnosis_before: list[DiagnosisJson] = []
    refused: list[list[str]] = []
    before: RmsByRole = {}
    after: RmsByRole = {}
    before_sd: RmsByRole = {}
    after_sd: RmsByRole = {}
    noise_floor: dict[str, JsonNumber] = {}
    steps: list[StepJson] = []
    shifts: dict[str, ShiftJson] = {}
    whiteness: dict[str, dict[str, dict[str, ResidualJson]]] = {}
    blocks: int = 0
    separate: list[str] = []
    story: list[str] = []
    diff: str = ""
    modelica_source: str = ""
    notes: list[str] = []
    simulations: int = 0
    failures: int = 0
    seconds: dict[str, float] = {}

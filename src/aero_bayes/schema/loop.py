"""The closed loop in a result: effects, rounds, errors before and after."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator

from aero_bayes.schema.base import JsonNumber, JsonTable, ParameterJson
from aero_bayes.schema.estimate import DiagnosisJson, ResidualJson


class CurveJson(JsonTable):
    """A learned curve: output of the port as a function of a signal, and its standard deviation."""

    x: list[float]
    value: list[float]
    sd: list[float]
    x_unit: str = ""
    unit: str = ""


def _named(given: object) -> object:
    """Return an alternative that has nothing but its id."""
    return {"id": given} if isinstance(given, str) else given


class AlternativeJson(JsonTable):
    """What does about as well in the place of an effect: error on left-out readings over that with the effect."""

    id: str
    port: str = ""
    error_ratio: JsonNumber = None


class EffectJson(JsonTable):
    """An effect; ``id`` is ``law@port`` or an id of a library.

    ``share`` is the error on left-out readings with it over that without it, in the output ``share_of``; ``wins`` the
    share of resampled blocks in which its structure is the best; ``looks_like`` the law that comes near a curve."""

    id: str
    port: str
    kind: Literal["catalogue", "free_form"]
    parameters: dict[str, ParameterJson] = {}
    share: JsonNumber = None
    share_sd: JsonNumber = None
    share_of: str = ""
    wins: JsonNumber = None
    modelica: str = ""
    summary: str = ""
    widths: dict[str, JsonNumber] = {}
    width_influence_sd: JsonNumber = None
    over: str = ""
    looks_like: str = ""
    curve: CurveJson | None = None
    claim: Literal["law", "place", "one of"] | None = None
    alternatives: list[Annotated[AlternativeJson, BeforeValidator(_named)]] = []


class CandidateJson(JsonTable):
    """A candidate of a round: error on left-out readings with it over that without it."""

    id: str
    port: str
    share: JsonNumber = None
    share_sd: JsonNumber = None
    wins: JsonNumber = None
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


class LimitJson(JsonTable):
    """The smallest size at which a law would have been named from these recordings."""

    law: str
    port: str
    parameter: str = ""
    smallest: JsonNumber = None
    unit: str = ""


class LoopJson(JsonTable):
    """The closed loop; ``before``, ``after`` and their like are by role (train, test) and output.

    ``smaller`` are effects that help and are not material; ``blocks`` of readings were left out in turn."""

    outcome: Literal["adequate", "extended", "unexplained"]
    sentence: str = ""
    base: str = ""
    model: str = ""
    effects: list[EffectJson] = []
    smaller: list[EffectJson] = []
    equivalent: list[list[str]] = []
    limits: list[LimitJson] = []
    errors: list[RecordingErrorJson] = []
    diagnosis_before: list[DiagnosisJson] = []
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

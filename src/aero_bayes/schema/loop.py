"""The closed loop in a result: effects, rounds, errors before and after."""

from __future__ import annotations

from typing import Literal

from aero_bayes.schema.base import JsonNumber, JsonTable, ParameterJson
from aero_bayes.schema.estimate import ResidualJson


class CurveJson(JsonTable):
    """A learned curve: output of the port as a function of a signal, and its standard deviation."""

    x: list[float]
    value: list[float]
    sd: list[float]
    x_unit: str = ""
    unit: str = ""


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

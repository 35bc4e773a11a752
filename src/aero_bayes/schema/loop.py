"""The closed loop in a result: effects, rounds, errors before and after."""

from __future__ import annotations

from typing import Literal

from aero_bayes.schema.base import Number, ParameterResult, Part, Quantiles
from aero_bayes.schema.estimate import ResidualResult


class Evidence(Part):
    """Log-evidence that the model loses without the effect, and the least that counts."""

    log_evidence_gain: Number = None
    needed: Number = None


class CurveResult(Part):
    """A learned curve: what the port gives over a signal, and its standard deviation."""

    x: list[float]
    value: list[float]
    sd: list[float]
    x_unit: str = ""
    unit: str = ""


class EffectResult(Part):
    """An effect that was added; ``id`` is ``law@port`` or an id of a library."""

    id: str
    port: str
    kind: Literal["catalogue", "free_form"]
    parameters: dict[str, ParameterResult] = {}
    evidence: Evidence = Evidence()
    odds: Number = None
    modelica: str = ""
    summary: str = ""
    widths: dict[str, Number] = {}
    width_influence_sd: Number = None
    over: str = ""
    curve: CurveResult | None = None


class CandidateResult(Part):
    """A candidate of a round: gain in log-evidence over the model without it, odds against doing without."""

    id: str
    port: str
    delta_evidence: Number = None
    odds: Number = None
    refitted: bool = True


class StepResult(Part):
    """A round of the search; ``threshold`` is the least gain that counts, ``odds`` those of nothing and the untried."""

    round: int
    candidates: list[CandidateResult] = []
    threshold: Number = None
    chosen: str | None = None
    equivalent: list[str] = []
    odds: dict[str, Number] = {}
    why: str = ""


class ShiftResult(Part):
    """How far a base parameter moved."""

    before: Number
    before_sd: Number
    after: Number
    after_sd: Number
    in_sd: Number


class StructureOdds(Part):
    """One of the structures that the data do not tell apart: its terms, and its probability among them."""

    terms: list[str]
    odds: Number


class AveragedParameter(Part):
    """A parameter of the first model under the chosen structure, and under the mixture of all."""

    chosen: Quantiles
    mixture: Quantiles


class AveragedStructures(Part):
    """The structures that the data do not tell apart, the chosen one first; parameters that all of them have."""

    structures: list[StructureOdds]
    parameters: dict[str, AveragedParameter] = {}


Errors = dict[str, dict[str, Number]]


class LoopPart(Part):
    """The closed loop; ``before``, ``after`` and their like are by role (train, test) and output.

    ``readings`` and ``effective_samples``, by output, are what the log-evidence rests on.
    """

    outcome: Literal["adequate", "extended", "unexplained"]
    sentence: str = ""
    base: str = ""
    model: str = ""
    effects: list[EffectResult] = []
    equivalent: list[list[str]] = []
    before: Errors = {}
    after: Errors = {}
    before_sd: Errors = {}
    after_sd: Errors = {}
    noise_floor: dict[str, Number] = {}
    steps: list[StepResult] = []
    shifts: dict[str, ShiftResult] = {}
    whiteness: dict[str, dict[str, dict[str, ResidualResult]]] = {}
    averaged: AveragedStructures | None = None
    readings: dict[str, int] = {}
    effective_samples: dict[str, Number] = {}
    separate: list[str] = []
    story: list[str] = []
    diff: str = ""
    modelica_source: str = ""
    notes: list[str] = []
    simulations: int = 0
    failures: int = 0
    seconds: dict[str, float] = {}

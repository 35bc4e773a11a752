"""What ``result.json`` holds, as typed classes: every command fills one :class:`RunResult`, every page reads one.

A key that a command did not write keeps its default, so that a reader never asks whether it is there. Numbers are in SI
units; ``None`` stands for what is not known or not finite. Keys that no class names are kept and can be listed with
:func:`undeclared`; the tests allow none in what the program writes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue

SCHEMA = 1

Status = Literal["identified", "weak", "unidentified", "fixed", "at_bound"]
Level = Literal["good", "warning", "bad"]
Number = float | None


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow", populate_by_name=True, allow_inf_nan=False)


class Quantiles(_Part):
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


class Verdict(_Part):
    """The run in one sentence, and how to take it."""

    level: Level
    text: str


class DataFile(_Part):
    """A recording's file."""

    file: str
    sha256: str
    rows: int
    rate_hz: float


class RecordingResult(_Part):
    """A recording as it was used; ``noise_floor`` and ``rms`` by output."""

    name: str
    role: Literal["train", "test"]
    rows: int
    rate_hz: float
    duration_s: float
    inputs: list[str]
    outputs: list[str]
    noise_floor: dict[str, Number] = {}
    rms: dict[str, Number] = {}


class Signal(_Part):
    """Unit and meaning of an input, output, state or port."""

    unit: str = ""
    description: str = ""


class Shape(_Part):
    """A drawing primitive of an icon, in coordinates from -100 to 100; y points up."""

    kind: Literal["line", "polygon", "rectangle", "ellipse"]
    points: list[tuple[float, float]]
    filled: bool = False


class Component(_Part):
    """A part of the model, its place in the diagram (two opposite corners) and its icon.

    ``terminal`` says whether it is an input, an output or a connector of the model; ``marked`` that an effect was added
    there.
    """

    name: str
    type: str
    description: str = ""
    extent: tuple[float, float, float, float]
    rotation: float = 0.0
    shapes: list[Shape] = []
    terminal: Literal["", "input", "output", "connector"] = ""
    marked: bool = False


class Connection(_Part):
    """A line between two components; ``signal`` where only a value is handed on. No points: drawn straight."""

    first: str
    second: str
    points: list[tuple[float, float]] = []
    signal: bool = False


class Diagram(_Part):
    """The model's structure; ``drawn`` says that its authors placed the parts, else they were laid out here."""

    title: str = ""
    drawn: bool = False
    components: list[Component] = []
    connections: list[Connection] = []


class ModelResult(_Part):
    """The model that was fitted."""

    name: str = ""
    fmu_sha256: str = ""
    exporter: str = ""
    engine: str = ""


class SwarmResult(_Part):
    """The particle swarm: best cost after each iteration."""

    evaluations: int
    history: list[Number]
    failures: int = 0
    reason: str = ""


class LocalResult(_Part):
    """The bounded local search."""

    iterations: int
    reason: str


class StageResult(_Part):
    """A stage of the local search."""

    parameters: list[str]
    outputs: list[str]
    cost: Number
    values: dict[str, Number]
    rms: dict[str, Number]


class FitResult(_Part):
    """The best fit; ``rms`` by role and output."""

    cost_eq6: Number = None
    rms: dict[str, dict[str, Number]] = {}
    log_likelihood: Number = None
    log_posterior: Number = None
    bic: Number = None
    stages: list[StageResult] = []
    pso: SwarmResult | None = None
    local: LocalResult | None = None


class NoiseResult(_Part):
    """Noise of an output: white plus correlated over ``tau_s``."""

    sd: Number
    rho: Number
    sd_white: Number = None
    sd_ou: Number = None
    tau_s: Number = None


class ResidualResult(_Part):
    """What the model leaves of an output in one recording."""

    rms: Number
    noise_floor: Number = None
    ratio: Number = None
    white: bool
    p_value: Number = None
    verdict: Literal["adequate", "structured"]
    autocorrelation_max: Number = None
    tests: dict[str, Number] = {}
    correlations: dict[str, Number] = {}
    worst_time: list[Number] = []
    worst_share: Number = None


class Profile(_Part):
    """How far the log-posterior falls when a parameter is held at ``values``."""

    unit: str = ""
    values: list[Number]
    drop: list[Number]
    prior_drop: list[Number] = []
    interval: list[Number]
    bounded: JsonValue = None


class Combination(_Part):
    """A combination of parameters that the data determine."""

    text: str
    members: list[str]
    sd_relative: Number = None


class Identifiability(_Part):
    """What the data say of the parameters together."""

    combinations: list[Combination] = []
    unidentified: list[str] = []
    text: list[str] = []
    profiles: dict[str, Profile] = {}
    profile_drop_90: Number = None
    not_profiled: list[str] = []


class Convergence(_Part):
    """A parameter's chains."""

    r_hat: Number
    ess_bulk: Number
    ess_tail: Number
    tau: Number


class McmcResult(_Part):
    """The sampler."""

    ensembles: int
    draws: int
    walkers: int | None = None
    tau: Number
    r_hat_max: Number
    ess_bulk_min: Number
    ess_tail_min: Number
    seconds: float
    converged: bool = True
    reason: str = ""
    acceptance: Number = None
    evaluations: int | None = None
    per_parameter: dict[str, Convergence] = {}


class RippleOrder(_Part):
    """Ripple at a multiple of the rotor's turn."""

    amplitude: Number
    law: str
    log_evidence: Number


class RippleResult(_Part):
    """Ripple in an output of one recording."""

    orders: dict[str, RippleOrder] = {}
    noise_sd: Number
    noise_sd_with_ripple: Number


class EncoderResult(_Part):
    """Counts of an encoder and what rounding to them adds."""

    step: float
    share: float
    error_sd: Number = None
    error_lasts_s: Number = None
    sd_before_rounding: Number = None
    gain: Number = None
    exact: bool = False


class SensorResult(_Part):
    """What a sensor adds to the physics; ``ripple`` by recording."""

    ripple: dict[str, RippleResult] = {}
    ripple_subtracted: bool = False
    encoder: EncoderResult | None = None


class LeftOutResult(_Part):
    """A recording predicted from the others."""

    rms: dict[str, Number]
    rms_fitted: dict[str, Number]
    elpd: Number


class StretchesResult(_Part):
    """Expected log-density of stretches that were left out."""

    method: str = ""
    elpd: Number
    se: Number
    parameters: Number = None
    stretches: int
    pareto_k_max: Number = None
    reliable: bool
    refits: int = 0


class PredictionResult(_Part):
    """What the parameters are worth on data that they have not seen."""

    recordings: dict[str, LeftOutResult] = {}
    stretches: dict[str, StretchesResult] = {}
    note: str = ""


class Evidence(_Part):
    """Log-evidence that the model loses without the effect, and the least that counts."""

    log_evidence_gain: Number = None
    needed: Number = None


class EffectResult(_Part):
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


class CandidateResult(_Part):
    """A candidate of a round: gain in log-evidence over the model without it, odds against doing without."""

    id: str
    port: str
    delta_evidence: Number = None
    odds: Number = None
    refitted: bool = True


class StepResult(_Part):
    """A round of the search; ``threshold`` is the least gain that counts."""

    round: int
    port_scores: dict[str, Number] = {}
    candidates: list[CandidateResult] = []
    threshold: Number = None
    chosen: str | None = None
    equivalent: list[str] = []
    why: str = ""


class MomentResult(_Part):
    """A disturbance that belongs to a moment and not to a state."""

    port: str
    start: float
    stop: float
    size: Number


class ShiftResult(_Part):
    """How far a base parameter moved."""

    before: Number
    before_sd: Number
    after: Number
    after_sd: Number
    in_sd: Number


Errors = dict[str, dict[str, Number]]


class LoopPart(_Part):
    """The closed loop; ``before``, ``after`` and their like are by role (train, test) and output."""

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
    port_scores: dict[str, Number] = {}
    ports: dict[str, Signal] = {}
    tied_ports: list[str] = []
    moment: MomentResult | None = None
    separate: list[str] = []
    story: list[str] = []
    diff: str = ""
    modelica_source: str = ""
    notes: list[str] = []
    simulations: int = 0
    failures: int = 0
    seconds: dict[str, float] = {}
    parameters_before: dict[str, ParameterResult] = {}


class ReplayRow(_Part):
    """A model of the paper's Table 1."""

    model: str
    variant: str = ""
    parameters: dict[str, Number] = {}
    fitness: Number = None
    paper_fitness: Number = None
    note: str = ""
    rms: dict[str, Number] = {}


class ReplayResult(_Part):
    """The paper, replayed."""

    rows: list[ReplayRow] = []
    notes: list[str] = []
    details: dict[str, JsonValue] = {}
    samples: int = 0
    failures: dict[str, int] = {}
    seed: int | None = None
    seconds: float | None = None
    simulated: bool = True


class DesignedParameter(_Part):
    """A parameter's standard deviation now, expected after the experiment, and in simulated repetitions."""

    value: Number
    unit: str = ""
    sd_before: Number
    sd_after: Number = None
    sd_repeated: Number = None
    sd_achieved: Number = None
    gain: Number = None
    target: bool = False


class DesignLimits(_Part):
    """What the rig allows."""

    amplifier: Number = None
    travel: dict[str, Number] = {}


class DesignCheck(_Part):
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


class RivalResult(_Part):
    """One of two effects to tell apart, as fitted to the recordings at hand."""

    id: str
    model: str = ""
    parameters: dict[str, ParameterResult] = {}


class DesignResult(_Part):
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


class RunResult(_Part):
    """``result.json``; ``signals`` and ``words`` say what signals and the ids of effects stand for."""

    version: Literal[1] = Field(default=1, alias="schema")
    command: str = ""
    seed: int | None = None
    versions: dict[str, str] = {}
    data: list[DataFile] = []
    simulated: bool = False
    units: dict[str, str] = {}
    signals: dict[str, Signal] = {}
    words: dict[str, str] = {}
    settings: dict[str, JsonValue] = {}
    model: ModelResult = ModelResult()
    diagrams: list[Diagram] = []
    recordings: list[RecordingResult] = []
    parameters: dict[str, ParameterResult] = {}
    noise: dict[str, NoiseResult] = {}
    sensors: dict[str, SensorResult] = {}
    fit: FitResult = FitResult()
    identifiability: Identifiability = Identifiability()
    residual: dict[str, dict[str, ResidualResult]] = {}
    prediction: PredictionResult = PredictionResult()
    mcmc: McmcResult | None = None
    loop: LoopPart | None = None
    replay: ReplayResult | None = None
    design: DesignResult | None = None
    failures: dict[str, int] = {}
    warnings: list[str] = []
    verdict: Verdict | None = None
    seconds: Number = None

    def unit(self, signal: str) -> str:
        """Unit of an input, output, state or port; empty where the run does not say."""
        described = self.signals.get(signal) or (self.loop.ports.get(signal) if self.loop else None)
        return self.units.get(signal) or (described.unit if described else "")

    def description(self, signal: str) -> str:
        """What a signal is, in the model's words."""
        return self.signals[signal].description if signal in self.signals else ""

    def role(self, recording: str) -> str:
        """``train`` or ``test``; empty for a recording that the run does not know."""
        return next((row.role for row in self.recordings if row.name == recording), "")

    def noise_floor(self, recording: str, output: str) -> float | None:
        """Noise of an output as estimated from the recording alone."""
        found = self.residual.get(recording, {}).get(output)
        if found is not None and found.noise_floor is not None:
            return found.noise_floor
        return next((row.noise_floor.get(output) for row in self.recordings if row.name == recording), None)

    def effect_words(self) -> dict[str, str]:
        """What the effects that the run speaks of are, by id."""
        added = self.loop.effects if self.loop is not None else []
        return self.words | {effect.id: effect.summary for effect in added if effect.summary}


def undeclared(part: BaseModel, path: str = "") -> Iterator[str]:
    """Dotted paths of the keys below a part that no class names."""
    yield from (f"{path}{key}" for key in part.model_extra or {})
    for name in type(part).model_fields:
        yield from _undeclared_within(getattr(part, name), f"{path}{name}")


def _undeclared_within(value: object, path: str) -> Iterator[str]:
    if isinstance(value, BaseModel):
        yield from undeclared(value, f"{path}.")
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _undeclared_within(item, f"{path}.{key}")
    elif isinstance(value, list):
        for item in value:
            yield from _undeclared_within(item, path)

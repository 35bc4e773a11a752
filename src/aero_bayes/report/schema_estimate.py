"""The sections of ``result.json`` on the model, its parameters, noise, checks and diagnosis."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, JsonValue

from aero_bayes.data.split import Role
from aero_bayes.estimate.convergence import Convergence
from aero_bayes.estimate.global_search import StageReport
from aero_bayes.estimate.identifiability import Combination
from aero_bayes.estimate.modes import Mode
from aero_bayes.estimate.other_tools import ValueTrial
from aero_bayes.estimate.sampled_modes import ModeDraws
from aero_bayes.plain import Number

Level = Literal["good", "warning", "bad"]
JsonNumber = float | None


class JsonTable(BaseModel):
    """A table of the result. Keys that are not named here are kept."""

    model_config = ConfigDict(frozen=True, extra="allow", populate_by_name=True, allow_inf_nan=False)


class VerdictJson(JsonTable):
    """Summary of the run in a sentence, with a level."""

    level: Level
    text: str


class DataFileJson(JsonTable):
    """A recording's file."""

    file: str
    sha256: str
    rows: int
    rate_hz: float


class RecordingJson(JsonTable):
    """A recording as it was used; ``noise_floor`` and ``rms`` by output."""

    name: str
    role: Role
    rows: int
    rate_hz: float
    duration_s: float
    inputs: list[str]
    outputs: list[str]
    noise_floor: dict[str, JsonNumber] = {}
    rms: dict[str, JsonNumber] = {}


class SwarmJson(JsonTable):
    """The particle swarm: best cost after each iteration."""

    evaluations: int
    history: list[JsonNumber]
    failures: int = 0
    reason: str = ""


class LocalJson(JsonTable):
    """The bounded local search."""

    iterations: int
    reason: str


class FitJson(JsonTable):
    """The best fit; ``rms`` by role and output, ``interpolation`` of each input between its samples.

    ``start_levels`` are the log-posteriors at which local fits from several starts ended, on fewer samples.
    ``values`` are the listed values of parameters that were each fitted, likeliest first."""

    cost_eq6: JsonNumber = None
    rms: dict[str, dict[str, JsonNumber]] = {}
    interpolation: dict[str, Literal["hold", "linear"]] = {}
    log_likelihood: JsonNumber = None
    log_posterior: JsonNumber = None
    bic: JsonNumber = None
    stages: list[StageReport] = []
    pso: SwarmJson | None = None
    modes: list[Mode] = []
    values: list[ValueTrial] = []
    local: LocalJson | None = None
    start_levels: list[JsonNumber] = []


class NoiseJson(JsonTable):
    """Noise of an output: white plus correlated over ``tau_s``.

    ``kind`` says how it differs from reading to reading: ``relative`` has the standard deviation
    ``base + per_unit |y|``, ``student`` the scale ``base`` and ``freedom`` degrees of freedom. ``by_recording`` has the
    standard deviation in each recording, where they differ."""

    sd: JsonNumber
    rho: JsonNumber
    sd_white: JsonNumber = None
    sd_ou: JsonNumber = None
    tau_s: JsonNumber = None
    kind: str = "constant"
    base: JsonNumber = None
    per_unit: JsonNumber = None
    freedom: JsonNumber = None
    by_recording: dict[str, JsonNumber] = {}


class ResidualJson(JsonTable):
    """Residual of an output in one recording."""

    rms: Number
    noise_floor: JsonNumber = None
    ratio: JsonNumber = None
    white: bool
    p_value: JsonNumber = None
    verdict: Literal["adequate", "structured"]
    exact: bool = False
    tests: dict[str, JsonNumber] = {}
    correlations: dict[str, JsonNumber] = {}
    worst_time: list[JsonNumber] = []
    worst_share: JsonNumber = None


class ProfileJson(JsonTable):
    """Profile of the log-posterior: its decrease with a parameter fixed at ``values``."""

    unit: str = ""
    values: list[JsonNumber]
    drop: list[JsonNumber]
    prior_drop: list[JsonNumber] = []
    interval: list[JsonNumber]
    bounded: JsonValue = None


class IdentifiabilityJson(JsonTable):
    """Identifiability of the parameters."""

    combinations: list[Combination] = []
    unidentified: list[str] = []
    flat: list[str] = []
    text: list[str] = []
    profiles: dict[str, ProfileJson] = {}
    profile_drop_90: JsonNumber = None
    not_profiled: list[str] = []


class McmcJson(JsonTable):
    """The sampler."""

    ensembles: int
    draws: int
    walkers: int | None = None
    tau: JsonNumber
    r_hat_max: JsonNumber
    ess_bulk_min: JsonNumber
    ess_tail_min: JsonNumber
    seconds: float
    converged: bool = True
    reason: str = ""
    acceptance: JsonNumber = None
    evaluations: int | None = None
    modes: list[ModeDraws] = []
    per_parameter: dict[str, Convergence] = {}


class EncoderJson(JsonTable):
    """Counts of an encoder and what rounding to them adds."""

    step: float
    share: float


class SensorJson(JsonTable):
    """Errors of a sensor."""

    encoder: EncoderJson | None = None


class LeftOutJson(JsonTable):
    """A recording predicted from the others."""

    rms: dict[str, JsonNumber]
    rms_fitted: dict[str, JsonNumber]


class PredictionJson(JsonTable):
    """Cross-validation of the fit over recordings."""

    recordings: dict[str, LeftOutJson] = {}
    note: str = ""


class SignalJson(JsonTable):
    """Unit and meaning of an input, output, state or port."""

    unit: str = ""
    description: str = ""


class ShapeJson(JsonTable):
    """A drawing primitive of an icon, in coordinates from -100 to 100; y points up."""

    kind: Literal["line", "polygon", "rectangle", "ellipse"]
    points: list[tuple[float, float]]
    filled: bool = False


class ComponentJson(JsonTable):
    """A part of the model, its place in the diagram (two opposite corners) and its icon.

    ``terminal`` says whether it is an input, an output or a connector of the model; ``marked`` that an effect was added
    there."""

    name: str
    type: str
    description: str = ""
    extent: tuple[float, float, float, float]
    rotation: float = 0.0
    shapes: list[ShapeJson] = []
    terminal: Literal["", "input", "output", "connector"] = ""
    marked: bool = False


class ConnectionJson(JsonTable):
    """A line between two components; ``signal`` where only a value is handed on. No points: drawn straight."""

    first: str
    second: str
    points: list[tuple[float, float]] = []
    signal: bool = False


class DiagramJson(JsonTable):
    """The model's structure, as its authors placed the parts, with the place of an effect."""

    title: str = ""
    components: list[ComponentJson] = []
    connections: list[ConnectionJson] = []


class ModelJson(JsonTable):
    """The model that was fitted."""

    name: str = ""
    fmu_sha256: str = ""
    exporter: str = ""
    engine: str = ""

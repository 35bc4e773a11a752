"""What fit and posterior leave in a result: recordings, fit, noise, residual, sampler, sensors, prediction."""

from __future__ import annotations

from typing import Literal

from pydantic import JsonValue

from aero_bayes.schema.base import Number, Part


class DataFile(Part):
    """A recording's file."""

    file: str
    sha256: str
    rows: int
    rate_hz: float


class RecordingResult(Part):
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


class SwarmResult(Part):
    """The particle swarm: best cost after each iteration."""

    evaluations: int
    history: list[Number]
    failures: int = 0
    reason: str = ""


class LocalResult(Part):
    """The bounded local search."""

    iterations: int
    reason: str


class StageResult(Part):
    """A stage of the local search."""

    parameters: list[str]
    outputs: list[str]
    cost: Number
    values: dict[str, Number]
    rms: dict[str, Number]


class FitResult(Part):
    """The best fit; ``rms`` by role and output, ``interpolation`` what each input did between its samples."""

    cost_eq6: Number = None
    rms: dict[str, dict[str, Number]] = {}
    interpolation: dict[str, Literal["hold", "linear"]] = {}
    log_likelihood: Number = None
    log_posterior: Number = None
    bic: Number = None
    stages: list[StageResult] = []
    pso: SwarmResult | None = None
    local: LocalResult | None = None


class NoiseResult(Part):
    """Noise of an output: white plus correlated over ``tau_s``."""

    sd: Number
    rho: Number
    sd_white: Number = None
    sd_ou: Number = None
    tau_s: Number = None


class ResidualResult(Part):
    """What the model leaves of an output in one recording."""

    rms: Number
    noise_floor: Number = None
    ratio: Number = None
    white: bool
    p_value: Number = None
    verdict: Literal["adequate", "structured"]
    tests: dict[str, Number] = {}
    correlations: dict[str, Number] = {}
    worst_time: list[Number] = []
    worst_share: Number = None


class Profile(Part):
    """How far the log-posterior falls when a parameter is held at ``values``."""

    unit: str = ""
    values: list[Number]
    drop: list[Number]
    prior_drop: list[Number] = []
    interval: list[Number]
    bounded: JsonValue = None


class Combination(Part):
    """A combination of parameters that the data determine."""

    text: str
    members: list[str]
    sd_relative: Number = None


class Identifiability(Part):
    """What the data say of the parameters together."""

    combinations: list[Combination] = []
    unidentified: list[str] = []
    flat: list[str] = []
    text: list[str] = []
    profiles: dict[str, Profile] = {}
    profile_drop_90: Number = None
    not_profiled: list[str] = []


class Convergence(Part):
    """A parameter's chains."""

    r_hat: Number
    ess_bulk: Number
    ess_tail: Number
    tau: Number


class McmcResult(Part):
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


class RippleOrder(Part):
    """Ripple at a multiple of the rotor's turn."""

    amplitude: Number
    law: str
    log_evidence: Number


class RippleResult(Part):
    """Ripple in an output of one recording."""

    orders: dict[str, RippleOrder] = {}
    noise_sd: Number
    noise_sd_with_ripple: Number


class EncoderResult(Part):
    """Counts of an encoder and what rounding to them adds."""

    step: float
    share: float
    error_sd: Number = None
    error_lasts_s: Number = None
    sd_before_rounding: Number = None
    gain: Number = None
    exact: bool = False


class SensorResult(Part):
    """What a sensor adds to the physics; ``ripple`` by recording."""

    ripple: dict[str, RippleResult] = {}
    ripple_subtracted: bool = False
    encoder: EncoderResult | None = None


class LeftOutResult(Part):
    """A recording predicted from the others."""

    rms: dict[str, Number]
    rms_fitted: dict[str, Number]
    elpd: Number


class StretchesResult(Part):
    """Expected log-density of stretches that were left out."""

    method: str = ""
    elpd: Number
    se: Number
    parameters: Number = None
    stretches: int
    pareto_k_max: Number = None
    reliable: bool
    refits: int = 0


class PredictionResult(Part):
    """What the parameters are worth on data that they have not seen."""

    recordings: dict[str, LeftOutResult] = {}
    stretches: dict[str, StretchesResult] = {}
    note: str = ""

"""``result.json`` as a whole, and its sections on the loop, a designed experiment and a fleet."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, JsonValue

from aero_bayes.data.split import Role
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.identifiability import Estimate
from aero_bayes.estimate.information import Limits
from aero_bayes.estimate.predict_recordings import Shift
from aero_bayes.estimate.propose import ExpectedParameter
from aero_bayes.estimate.residual_tests import RecordingError
from aero_bayes.loop.extend import Alternative, Limit
from aero_bayes.loop.result import Step
from aero_bayes.plain import ByName
from aero_bayes.report.schema_estimate import (
    DataFileJson,
    DiagramJson,
    FitJson,
    IdentifiabilityJson,
    JsonNumber,
    JsonTable,
    McmcJson,
    ModelJson,
    NoiseJson,
    PredictionJson,
    RecordingJson,
    ResidualJson,
    SensorJson,
    SignalJson,
    VerdictJson,
)


class CurveJson(JsonTable):
    """A learned curve: output of the port as a function of a signal, and its standard deviation."""

    x: list[float]
    value: list[float]
    sd: list[float]
    x_unit: str = ""
    unit: str = ""


class EffectJson(JsonTable):
    """An effect; ``id`` is ``law@port``, ``value@parameter``, ``start@state`` or an id of a library.

    ``share`` is the error on left-out readings with it over that without it, in the output ``share_of``; ``claim`` what
    is known of it; ``looks_like`` the law that comes near a curve."""

    id: str
    port: str
    kind: Literal["catalogue", "free_form"]
    parameters: ByName[Estimate] = {}
    share: JsonNumber = None
    share_sd: JsonNumber = None
    share_of: str = ""
    claim: Literal["law", "place", "mechanism", "one of"] | None = None
    alternatives: list[Alternative] = []
    modelica: str = ""
    summary: str = ""
    over: str = ""
    looks_like: str = ""
    curve: CurveJson | None = None
    tried_all: bool = True


RmsByRole = dict[str, dict[str, JsonNumber]]


class PartJson(JsonTable):
    """Readings of a recording in one role, from ``begin`` (s) on and before ``end``."""

    recording: str
    role: Role
    begin: JsonNumber = None
    end: JsonNumber = None


class LoopJson(JsonTable):
    """The closed loop; ``before``, ``after`` and their like are by role (train, validation, test) and output.

    ``blocks`` of readings give standard errors; ``refused`` are models that explain training readings better and
    predict validation readings worse."""

    outcome: Literal["adequate", "extended", "unexplained"]
    sentence: str = ""
    base: str = ""
    model: str = ""
    effects: list[EffectJson] = []
    equivalent: list[list[str]] = []
    limits: list[Limit] = []
    parts: list[PartJson] = []
    errors: list[RecordingError] = []
    diagnosis_before: list[DiagnosisRow] = []
    refused: list[list[str]] = []
    before: RmsByRole = {}
    after: RmsByRole = {}
    before_sd: RmsByRole = {}
    after_sd: RmsByRole = {}
    noise_floor: dict[str, JsonNumber] = {}
    steps: list[Step] = []
    shifts: ByName[Shift] = {}
    whiteness: dict[str, dict[str, dict[str, ResidualJson]]] = {}
    blocks: int = 0
    story: list[str] = []
    diff: str = ""
    modelica_source: str = ""
    notes: list[str] = []
    simulations: int = 0
    failures: int = 0
    seconds: dict[str, float] = {}


class DesignJson(JsonTable):
    """The proposed experiment."""

    input: str
    unit: str = ""
    duration: float
    rate_hz: JsonNumber = None
    gain: JsonNumber = None
    parameters: ByName[ExpectedParameter] = {}
    travel: dict[str, JsonNumber] = {}
    limits: Limits
    table: dict[str, list[JsonNumber]] = {}
    seed: int | None = None
    file: str = ""


class RangeJson(JsonTable):
    """Median and central 90 % of a posterior."""

    q05: JsonNumber = None
    q50: JsonNumber = None
    q95: JsonNumber = None


class FleetParameterJson(JsonTable):
    """A parameter over the fleet, in its unit; ``spread`` is of its logarithm where ``log``.

    ``mean`` is the fleet's typical value, ``next`` the prediction for a rig not seen yet."""

    unit: str = ""
    log: bool = False
    rigs: int = 0
    mean: RangeJson = RangeJson()
    spread: RangeJson = RangeJson()
    next: RangeJson = RangeJson()


class FleetEffectJson(JsonTable):
    """An effect over the fleet: rigs whose loop named it, and the share of such rigs where a loop came to an end.

    A rig whose data cannot tell it from other effects counts for a part of the share."""

    id: str
    summary: str = ""
    named: int = 0
    share: RangeJson = RangeJson()


class RigReasonJson(JsonTable):
    """A rig and why it is mentioned; ``p_value``: how unlikely one so far from the others is."""

    rig: str
    reasons: list[str] = []
    p_value: JsonNumber = None


class FleetJson(JsonTable):
    """``fleet.json``; lists of rigs are cut at a hundred, counts are whole, all rigs are in ``rigs.sqlite``."""

    version: Literal[1] = Field(default=1, alias="schema")
    command: str = "fleet"
    work: str = ""
    seed: int = 1
    simulated: bool = False
    versions: dict[str, str] = {}
    rigs: int = 0
    failed: int = 0
    outcomes: dict[str, int] = {}
    parameters: dict[str, FleetParameterJson] = {}
    effects: list[FleetEffectJson] = []
    standing_out: int = 0
    stand_out: list[RigReasonJson] = []
    failures: list[RigReasonJson] = []
    seconds: float = 0.0
    workers: int = 0
    table_sha256: str = ""
    verdict: VerdictJson | None = None


SCHEMA = 1


class RunJson(JsonTable):
    """``result.json``; ``signals`` and ``words`` describe the signals and the effects by id."""

    version: Literal[1] = Field(default=1, alias="schema")
    command: str = ""
    seed: int | None = None
    versions: dict[str, str] = {}
    data: list[DataFileJson] = []
    simulated: bool = False
    units: dict[str, str] = {}
    signals: dict[str, SignalJson] = {}
    words: dict[str, str] = {}
    settings: dict[str, JsonValue] = {}
    model: ModelJson = ModelJson()
    diagrams: list[DiagramJson] = []
    recordings: list[RecordingJson] = []
    parameters: ByName[Estimate] = {}
    noise: dict[str, NoiseJson] = {}
    process_noise: ByName[Estimate] = {}
    sensors: dict[str, SensorJson] = {}
    fit: FitJson = FitJson()
    identifiability: IdentifiabilityJson = IdentifiabilityJson()
    residual: dict[str, dict[str, ResidualJson]] = {}
    diagnosis: list[DiagnosisRow] = []
    prediction: PredictionJson = PredictionJson()
    mcmc: McmcJson | None = None
    loop: LoopJson | None = None
    design: DesignJson | None = None
    failures: dict[str, int] = {}
    warnings: list[str] = []
    verdict: VerdictJson | None = None
    seconds: JsonNumber = None

    def unit(self, signal: str) -> str:
        """Return the unit of an input, output or state; empty if unknown."""
        described = self.signals.get(signal)
        return self.units.get(signal) or (described.unit if described else "")

    def description(self, signal: str) -> str:
        """Return the description of a signal in the model."""
        return self.signals[signal].description if signal in self.signals else ""

    @property
    def checks(self) -> list[DiagnosisRow]:
        """The causes that were looked at; a loop's search that ended early is found in that of the search."""
        if self.loop is None or not self.loop.notes:
            return self.diagnosis
        early = DiagnosisRow(cause="search", found=True, what=" ".join(self.loop.notes))
        return [early if row.cause == "search" and not row.found else row for row in self.diagnosis]

    def role(self, recording: str) -> Role | Literal[""]:
        """Return ``train``, ``validation`` or ``test``; empty for a recording that the run does not know."""
        return next((row.role for row in self.recordings if row.name == recording), "")

    def noise_floor(self, recording: str, output: str) -> float | None:
        """Return the noise of an output as estimated from the recording alone."""
        found = self.residual.get(recording, {}).get(output)
        if found is not None and found.noise_floor is not None:
            return found.noise_floor
        return next((row.noise_floor.get(output) for row in self.recordings if row.name == recording), None)

    def effect_words(self) -> dict[str, str]:
        """Return descriptions of all effects in the run, by id."""
        added = self.loop.effects if self.loop is not None else []
        return self.words | {effect.id: effect.summary for effect in added if effect.summary}

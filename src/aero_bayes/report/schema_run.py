"""``result.json`` as a whole, its sections that no result declares itself, and ``fleet.json``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, JsonValue

from aero_bayes.data.split import Role
from aero_bayes.estimate.crossvalidation import LeftOutPrediction
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.identifiability import Combination, Estimate
from aero_bayes.estimate.log_posterior import LikelihoodProfile
from aero_bayes.estimate.noise_estimation import Sensor
from aero_bayes.estimate.posterior import McmcJson
from aero_bayes.estimate.propose import DesignJson
from aero_bayes.estimate.residual_tests import ResidualReport
from aero_bayes.estimate.result import FitJson
from aero_bayes.loop.result import LoopJson
from aero_bayes.plain import ByName, JsonNumber, JsonTable

Level = Literal["good", "warning", "bad"]


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


class IdentifiabilityJson(JsonTable):
    """Identifiability of the parameters."""

    combinations: list[Combination] = []
    unidentified: list[str] = []
    flat: list[str] = []
    text: list[str] = []
    profiles: ByName[LikelihoodProfile] = {}
    profile_drop_90: JsonNumber = None
    not_profiled: list[str] = []


class PredictionJson(JsonTable):
    """Cross-validation of the fit over recordings."""

    recordings: dict[str, LeftOutPrediction] = {}
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
    """``fleet.json``; lists of rigs are cut at a hundred, counts are whole, all rigs are in ``rigs.jsonl``."""

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
    sensors: dict[str, Sensor] = {}
    fit: FitJson = FitJson()
    identifiability: IdentifiabilityJson = IdentifiabilityJson()
    residual: dict[str, dict[str, ResidualReport]] = {}
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

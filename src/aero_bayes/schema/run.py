"""``result.json`` as a whole."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

from pydantic import BaseModel, Field, JsonValue

from aero_bayes.schema.base import JsonNumber, JsonTable, ParameterJson, VerdictJson
from aero_bayes.schema.design import DesignJson
from aero_bayes.schema.estimate import (
    DataFileJson,
    DiagnosisJson,
    FitJson,
    IdentifiabilityJson,
    McmcJson,
    NoiseJson,
    PredictionJson,
    RecordingJson,
    ResidualJson,
    SensorJson,
)
from aero_bayes.schema.loop import LoopJson
from aero_bayes.schema.model import DiagramJson, ModelJson, SignalJson
from aero_bayes.schema.study import StudyJson

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
    parameters: dict[str, ParameterJson] = {}
    noise: dict[str, NoiseJson] = {}
    process_noise: dict[str, ParameterJson] = {}
    sensors: dict[str, SensorJson] = {}
    fit: FitJson = FitJson()
    identifiability: IdentifiabilityJson = IdentifiabilityJson()
    residual: dict[str, dict[str, ResidualJson]] = {}
    diagnosis: list[DiagnosisJson] = []
    prediction: PredictionJson = PredictionJson()
    mcmc: McmcJson | None = None
    loop: LoopJson | None = None
    study: StudyJson | None = None
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

    def role(self, recording: str) -> str:
        """Return ``train`` or ``test``; empty for a recording that the run does not know."""
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


def undeclared(part: BaseModel, path: str = "") -> Iterator[str]:
    """Yield dotted paths of the keys below a part that no class names."""
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

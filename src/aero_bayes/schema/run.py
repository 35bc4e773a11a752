"""``result.json`` as a whole."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

from pydantic import BaseModel, Field, JsonValue

from aero_bayes.schema.base import Number, ParameterResult, Part, Verdict
from aero_bayes.schema.design import DesignResult
from aero_bayes.schema.estimate import (
    DataFile,
    FitResult,
    Identifiability,
    McmcResult,
    NoiseResult,
    PredictionResult,
    RecordingResult,
    ResidualResult,
    SensorResult,
)
from aero_bayes.schema.loop import LoopPart
from aero_bayes.schema.model import Diagram, ModelResult, Signal
from aero_bayes.schema.study import StudyResult

SCHEMA = 1


class RunResult(Part):
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
    process_noise: dict[str, ParameterResult] = {}
    sensors: dict[str, SensorResult] = {}
    fit: FitResult = FitResult()
    identifiability: Identifiability = Identifiability()
    residual: dict[str, dict[str, ResidualResult]] = {}
    prediction: PredictionResult = PredictionResult()
    mcmc: McmcResult | None = None
    loop: LoopPart | None = None
    study: StudyResult | None = None
    design: DesignResult | None = None
    failures: dict[str, int] = {}
    warnings: list[str] = []
    verdict: Verdict | None = None
    seconds: Number = None

    def unit(self, signal: str) -> str:
        """Unit of an input, output or state; empty where the run does not say."""
        described = self.signals.get(signal)
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

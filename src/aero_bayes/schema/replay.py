"""The paper, replayed, in a result."""

from __future__ import annotations

from pydantic import JsonValue

from aero_bayes.schema.base import JsonNumber, JsonTable


class ReplayRowJson(JsonTable):
    """A model of the paper's Table 1."""

    model: str
    variant: str = ""
    parameters: dict[str, JsonNumber] = {}
    fitness: JsonNumber = None
    paper_fitness: JsonNumber = None
    note: str = ""
    rms: dict[str, JsonNumber] = {}


class ReplayJson(JsonTable):
    """The paper, replayed."""

    rows: list[ReplayRowJson] = []
    notes: list[str] = []
    details: dict[str, JsonValue] = {}
    samples: int = 0
    failures: dict[str, int] = {}
    seed: int | None = None
    seconds: float | None = None
    simulated: bool = True

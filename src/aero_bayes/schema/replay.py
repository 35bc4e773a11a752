"""The paper, replayed, in a result."""

from __future__ import annotations

from pydantic import JsonValue

from aero_bayes.schema.base import Number, Part


class ReplayRow(Part):
    """A model of the paper's Table 1."""

    model: str
    variant: str = ""
    parameters: dict[str, Number] = {}
    fitness: Number = None
    paper_fitness: Number = None
    note: str = ""
    rms: dict[str, Number] = {}


class ReplayResult(Part):
    """The paper, replayed."""

    rows: list[ReplayRow] = []
    notes: list[str] = []
    details: dict[str, JsonValue] = {}
    samples: int = 0
    failures: dict[str, int] = {}
    seed: int | None = None
    seconds: float | None = None
    simulated: bool = True

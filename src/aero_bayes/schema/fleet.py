"""Typed classes of ``fleet.json``: parameters, effects and outliers."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from aero_bayes.schema.base import JsonNumber, JsonTable, VerdictJson


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

"""The page of a fleet: parameters, effects, outliers, and a table of the rigs with links to their pages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from aero_bayes.files import write_whole
from aero_bayes.report.page import fill
from aero_bayes.report.schema_run import FleetJson, RangeJson, RigReasonJson, RunJson
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import (
    NO_VALUE,
    count,
    duration,
    named_effect,
    pretty_unit,
    rounded_value,
    sentence,
    significant,
    symbol,
)
from aero_bayes.simulation.interface import NORMAL_HALF_WIDTH

_OUTCOMES = {"adequate": "the model is adequate", "extended": "an effect was added",
             "unexplained": "an effect is missing, and no candidate explains it"}  # fmt: skip


def write_fleet_page(directory: Path, result: FleetJson, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Write ``DIR/report.html``: one file, of a few hundred bytes a rig and parameter."""
    words = {effect.id: effect.summary for effect in result.effects if effect.summary}
    facts = [
        ("work", result.work), ("seed", str(result.seed)), ("worker processes", count(result.workers)),
        ("computing time of all rigs", duration(result.seconds)), ("table", result.table_sha256[:16]),
        *((f"version of {k}", v) for k, v in result.versions.items()),
    ]  # fmt: skip
    context = {
        "result": result, "title": f"Fleet of {count(result.rigs)} rigs", "facts": facts,
        "outcomes": [(_OUTCOMES.get(k, k), count(n)) for k, n in sorted(result.outcomes.items())],
        "parameters": _parameter_table(result), "effects": _effect_table(result, words),
        "stand_out": _reasons(result.stand_out, words), "failures": _reasons(result.failures, words, linked=False),
        "more": {"stand_out": result.standing_out - len(result.stand_out),
                 "failures": result.failed - len(result.failures)},
        "rigs": _rig_table(result, rows, words),
    }  # fmt: skip
    page = fill("fleet.html.jinja", context, [RunJson(words=words)], ())
    return write_whole(directory / "report.html", page)


def _parameter_table(result: FleetJson) -> Markup | None:
    """Write the typical value, the spread and the next rig's value, each with its 90 % interval."""
    rows = []
    for name, entry in result.parameters.items():
        mean, following = (_range(r, entry.unit) for r in (entry.mean, entry.next))
        spread = _range(entry.spread, "%", 100.0) if entry.log else _range(entry.spread, entry.unit)
        rows.append((symbol(name), mean, spread, following, pretty_unit(entry.unit), count(entry.rigs)))
    heads = (
        "parameter", Column("typical value", "right"), Column("spread, one standard deviation", "right"),
        Column("the next rig", "right"), "unit", Column("rigs used", "right"),
    )  # fmt: skip
    return html_table(heads, rows, "Distribution over the rigs, with 90 % intervals") if rows else None


def _effect_table(result: FleetJson, words: Mapping[str, str]) -> Markup | None:
    heads = (
        "effect", Column("rigs whose loop found it", "right"), Column("share of all rigs, 90 % interval", "right"),
    )  # fmt: skip
    rows = [(named_effect(e.id, words), count(e.named), _range(e.share, "%", 100.0)) for e in result.effects]
    return html_table(heads, rows, "Effects") if rows else None


def _rig_table(result: FleetJson, rows: Sequence[Mapping[str, Any]], words: Mapping[str, str]) -> Markup | None:
    """Write a line for each rig that was fitted, outliers marked: residual, effects, and value of each parameter."""
    loop = bool(result.outcomes)
    units = {name: pretty_unit(entry.unit) for name, entry in result.parameters.items()}
    heads: list[Column | str] = ["rig", Column("residual / noise floor", "right"), *(["effects"] if loop else [])]
    heads += [Column(Markup("{} {}").format(symbol(name), unit), "right") for name, unit in units.items()]
    odd = {entry.rig for entry in result.stand_out}
    lines = []
    for row in rows:
        named = Markup("<br>").join(named_effect(effect["id"], words) for effect in row["effects"])
        values = (_own_value(row["parameters"].get(name)) for name in units)
        lines.append((_link(row["key"]), significant(row["over_floor"]), *([named] if loop else []), *values))
    marked = [k for k, row in enumerate(rows) if row["key"] in odd]
    return html_table(heads, lines, "Rigs: values from their own data, 90 % intervals", marked) if lines else None


def _own_value(entry: Mapping[str, Any] | None) -> Markup | str:
    """Write a rig's value with its 90 % interval, and below it what all rigs together say of it."""
    if entry is None or "centre" not in entry:
        return NO_VALUE if entry is None else significant(entry["value"])
    ends = [entry["centre"] + side * NORMAL_HALF_WIDTH * entry["width"] for side in (-1.0, 0.0, 1.0)]
    low, middle, high = map(math.exp, ends) if entry["log"] else ends
    shown = _range(RangeJson(q05=low, q50=middle, q95=high), entry["unit"])
    given = entry.get("given_all")
    return shown if given is None else shown + Markup("<small>all rigs: {}</small>").format(significant(given))


def _range(values: RangeJson, unit: str, factor: float = 1.0) -> Markup | str:
    if values.q50 is None or values.q05 is None or values.q95 is None:
        return NO_VALUE
    shown = rounded_value(factor * values.q50, factor * values.q05, factor * values.q95, unit)
    power = shown.unit.partition(" ")[0] if shown.unit.startswith("×") else ""
    sign = " %" if unit == "%" else ""
    return Markup("{}{}{}<small>{} … {}</small>").format(shown.value, sign, power, shown.low, shown.high)


def _reasons(rigs: Sequence[RigReasonJson], words: Mapping[str, str], *, linked: bool = True) -> Markup | None:
    rows = [
        (_link(entry.rig) if linked else entry.rig, Markup("<br>").join(sentence(r, words) for r in entry.reasons))
        for entry in rigs
    ]
    return html_table(("rig", "why"), rows) if rows else None


def _link(rig: str) -> Markup:
    return Markup('<a href="rigs/{0}/report.html">{0}</a>').format(rig)

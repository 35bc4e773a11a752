"""The page of a fleet: one table of the rigs with links to their pages, above them what they have in common."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from aero_bayes.files import write_whole
from aero_bayes.report.page import Parts, fill, with_parts
from aero_bayes.report.schema_run import FleetJson, RangeJson, RunJson
from aero_bayes.report.tables import html_table
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
from aero_bayes.report.words import LEVELS
from aero_bayes.simulation.interface import NORMAL_HALF_WIDTH

_OUTCOMES = {"adequate": "the model is adequate", "extended": "an effect was added",
             "unexplained": "an effect is missing, and no candidate explains it"}  # fmt: skip


def write_fleet_page(directory: Path, result: FleetJson, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Write ``DIR/report.html``: one file, of a few hundred bytes a rig and parameter."""
    words = {effect.id: effect.summary for effect in result.effects if effect.summary}
    loop = {_OUTCOMES.get(k, k): count(n) for k, n in sorted(result.outcomes.items())}
    for e in result.effects:
        share = Markup("{} rigs; share of all, 90 % interval: {}").format(count(e.named), _range(e.share, "%", 100.0))
        loop[named_effect(e.id, words)] = share
    facts = {
        "work": result.work, "seed": str(result.seed), "worker processes": count(result.workers),
        "computing time of all rigs": duration(result.seconds), "table": result.table_sha256[:16],
        **{f"version of {k}": v for k, v in result.versions.items()},
    }  # fmt: skip
    weak = "A rig in which the effect is too weak to be found does not count."
    verdict = result.verdict
    context = {
        "title": f"Fleet of {count(result.rigs)} rigs", "kicker": "aero-bayes · fleet", "simulated": result.simulated,
        "verdicts": [(verdict.level, LEVELS[verdict.level], verdict.text)] if verdict else (),
        "sections": with_parts(
            Parts("Rigs", [_rigs(result, rows, words)], "rigs"),
            Parts("Effects that the model lacks", [loop, weak] if loop else [], "effects"),
            Parts("Work and provenance", [facts], "work"),
        ),
    }  # fmt: skip
    page = fill(context, [RunJson(words=words)])
    return write_whole(directory / "report.html", page)


def _rigs(result: FleetJson, rows: Sequence[Mapping[str, Any]], words: Mapping[str, str]) -> Markup:
    """Write what the rigs have in common, and a line for each: residual, effects, parameters, and what is odd of it."""
    parameters = result.parameters.items()
    heads = ["rig", "residual / noise floor", "effects"]
    heads += [Markup("{} {}").format(symbol(name), pretty_unit(p.unit)) for name, p in parameters]
    spreads = (_range(p.spread, "%", 100.0) if p.log else _range(p.spread, p.unit) for _, p in parameters)
    lines: list[tuple[object, ...]] = [
        ("typical value", "", "", *(_range(p.mean, p.unit) for _, p in parameters), ""),
        ("spread, one standard deviation", "", "", *spreads, ""),
        ("the next rig", "", "", *(_range(p.next, p.unit) for _, p in parameters), ""),
        ("rigs used", "", "", *(count(p.rigs) for _, p in parameters), ""),
    ]
    marked = []
    for row in rows:
        if "error" in row:
            lines.append((row["key"], *[NO_VALUE] * (len(parameters) + 2), sentence(row["error"], words)))
            continue
        if "reasons" in row:
            marked.append(len(lines))
        link = Markup('<a href="rigs/{0}/report.html">{0}</a>').format(row["key"])
        effects, odd = (Markup("<br>").join(parts) for parts in (
            [named_effect(effect["id"], words) for effect in row["effects"]],
            [sentence(reason, words) for reason in row.get("reasons", ())],
        ))  # fmt: skip
        values = (_own_value(row["parameters"].get(name)) for name, _ in parameters)
        lines.append((link, significant(row["over_floor"]), effects, *values, odd))
    caption = "Rigs: values from their own data, 90 % intervals; outliers first, then those that could not be fitted"
    return html_table([*heads, "why an outlier, or not fitted"], lines, caption, marked)


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
    shown = rounded_value(factor * values.q50, factor * values.q05, factor * values.q95, unit).apart
    sign = " %" if unit == "%" else ""
    return Markup("{}{}<small>{} … {}</small>").format(shown.value, sign, shown.low, shown.high)

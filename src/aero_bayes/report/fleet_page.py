"""The page of a fleet: parameters, effects and outliers, with links to the page of each rig."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from aero_bayes.files import whole_file
from aero_bayes.report.drawing import FloatArray
from aero_bayes.report.figure import NARROW_WIDTH, WIDE_WIDTH, Plate
from aero_bayes.report.fleet_figures import MAX_LINKED_RIGS, Ranked, ranked_drawing, rig_page
from aero_bayes.report.page import fill
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import (
    NO_VALUE,
    count,
    duration,
    greek_name,
    named_effect,
    pretty_unit,
    rounded_value,
    sentence,
    significant,
    symbol,
    tidy,
)
from aero_bayes.schema import FleetJson, FleetParameterJson, RangeJson, RigReasonJson, RunJson
from aero_bayes.simulation.gaussian import NORMAL_HALF_WIDTH

#: Width of a parameter's figure in CSS pixels, and rigs or effects that a list on the page names.
HALF_WIDTH, MAX_LISTED = 480.0, 40
_OUTCOMES = {"adequate": "the model is adequate", "extended": "an effect was added",
             "unexplained": "an effect is missing, and no candidate explains it"}  # fmt: skip


@dataclass(frozen=True, eq=False)
class ParameterColumn:
    """A parameter of every rig: value and width (n,) of its own data, value in the light of the fleet, the curve.

    Widths are standard deviations of the value, or of its logarithm where ``shared.log``; ``curve`` is the fleet's
    distribution function as (values, shares below).
    """

    values: FloatArray
    widths: FloatArray
    shrunk: FloatArray
    curve: tuple[FloatArray, FloatArray] | None
    shared: FleetParameterJson


@dataclass(frozen=True, eq=False)
class FleetColumns:
    """A number a rig for everything that is drawn, in the order of ``names``."""

    names: Sequence[str]
    parameters: Mapping[str, ParameterColumn]
    over_floor: FloatArray
    flagged: NDArray[np.bool_]


def write_fleet_page(directory: Path, result: FleetJson, columns: FleetColumns) -> Path:
    """Draw ``DIR/report.html``: one file, of a few hundred bytes a rig at most."""
    figures, few = list(_figures(columns)), len(columns.names) <= MAX_LINKED_RIGS
    words = {effect.id: effect.summary for effect in result.effects if effect.summary}
    context = {
        "result": result, "few": few, "names": columns.names if few else [], "rig_page": rig_page,
        "title": f"Fleet of {count(result.rigs)} rigs",
        "parameters": [_plate(figure, HALF_WIDTH) for figure in figures if figure.key != "over_floor"],
        "residual": next((_plate(figure, WIDE_WIDTH) for figure in figures if figure.key == "over_floor"), None),
        "table": _parameter_table(result.parameters), "effects": _effect_table(result, words),
        "stand_out": _reasons(result.stand_out, words), "failures": _reasons(result.failures, words, linked=False),
        "more": {"stand_out": max(0, result.standing_out - MAX_LISTED), "failures": max(0, result.failed - MAX_LISTED)},
        "facts": _facts(result),
        "rigs": Markup(json.dumps(list(columns.names), separators=(",", ":")).replace("<", "\\u003c")),
    }  # fmt: skip
    series = {figure.key: figure.values for figure in figures}
    page = fill("fleet.html.jinja", context, series, [RunJson(words=words)], ("data", "fleet"))
    with whole_file(directory / "report.html") as temporary:
        temporary.write_text(page, encoding="utf-8")
    return directory / "report.html"


def _figures(columns: FleetColumns) -> Iterator[Ranked]:
    for name, one in columns.parameters.items():
        if not np.isfinite(one.values).any():
            continue
        title, unit, log = greek_name(name), pretty_unit(one.shared.unit), one.shared.log
        half = NORMAL_HALF_WIDTH * one.widths
        low, high = (one.values * np.exp(s * half) if log else one.values + s * half for s in (-1.0, 1.0))
        yield Ranked(
            f"p/{name}", title, f"{title} ({unit})" if unit else title, columns.names, one.values, columns.flagged,
            low, high, one.shrunk, one.curve, log,
        )  # fmt: skip
    ratio = np.where(columns.over_floor > 0.0, columns.over_floor, np.nan)
    if np.isfinite(ratio).any():
        label = "largest residual, in noise floors"
        title = "residual of each rig, sorted"
        yield Ranked("over_floor", title, label, columns.names, ratio, columns.flagged, log=True, level=1.0)


def _plate(shown: Ranked, width: float) -> Plate:
    rigs = int(np.isfinite(shown.values).sum())
    low, middle, high = (significant(float(q)) for q in np.nanquantile(shown.values, [0.05, 0.5, 0.95]))
    alt = f"{shown.title}: {rigs} rigs, half of them below {middle}, 90 % from {low} to {high} ({shown.x_label})."
    narrow = ranked_drawing(shown, NARROW_WIDTH, alt) if width > HALF_WIDTH else None
    wide = ranked_drawing(shown, width, alt)
    return Plate(wide, narrow, alt, Markup(""), keys=frozenset([shown.key]), css="fleet")


def _parameter_table(parameters: Mapping[str, FleetParameterJson]) -> Markup | None:
    """Write the typical value, the spread and the next rig's value, each with its 90 % interval."""
    rows = []
    for name, entry in parameters.items():
        mean, following = (_interval(r, entry.unit) for r in (entry.mean, entry.next))
        spread = _interval(entry.spread, "%", 100.0) if entry.log else _interval(entry.spread, entry.unit)
        rows.append((symbol(name), mean, spread, following, pretty_unit(entry.unit), count(entry.rigs)))
    heads = (
        "parameter", Column("typical value", "right"), Column("spread, one standard deviation", "right"),
        Column("the next rig", "right"), "unit", Column("rigs used", "right"),
    )  # fmt: skip
    return html_table(heads, rows, "Distribution over the rigs, with 90 % intervals") if rows else None


def _interval(values: RangeJson, unit: str, factor: float = 1.0) -> Markup | str:
    if values.q50 is None or values.q05 is None or values.q95 is None:
        return NO_VALUE
    shown = rounded_value(factor * values.q50, factor * values.q05, factor * values.q95, unit)
    power = shown.unit.partition(" ")[0] if shown.unit.startswith("×") else ""
    sign = " %" if unit == "%" else ""
    return Markup("{}{}{}<small>{} … {}</small>").format(shown.value, sign, power, shown.low, shown.high)


def _effect_table(result: FleetJson, words: Mapping[str, str]) -> Markup | None:
    heads = (
        "effect", Column("rigs whose loop found it", "right"), Column("share of all rigs, 90 % interval", "right"),
        Column("found where present, %", "right"),
    )  # fmt: skip
    rows = []
    for e in result.effects[:MAX_LISTED]:
        noticed = tidy(100.0 * e.noticed, 2) if e.noticed else None
        rows.append((named_effect(e.id, words), count(e.named), _interval(e.share, "%", 100.0), noticed))
    return html_table(heads, rows, "Effects") if rows else None


def _reasons(rigs: Sequence[RigReasonJson], words: Mapping[str, str], *, linked: bool = True) -> Markup | None:
    rows = []
    for entry in rigs[:MAX_LISTED]:
        name = Markup('<a href="{}">{}</a>').format(rig_page(entry.rig), entry.rig) if linked else entry.rig
        rows.append((name, Markup("<br>").join(sentence(reason, words) for reason in entry.reasons)))
    return html_table(("rig", "why"), rows) if rows else None


def _facts(result: FleetJson) -> dict[str, list[tuple[str, str]]]:
    cost = result.cost
    work = [
        ("work", result.work), ("seed", str(result.seed)), ("worker processes", count(cost.workers)),
        ("computing time of all rigs", duration(cost.seconds)),
        ("processor time of the workers", duration(cost.cpu_seconds)),
        ("rigs started more than once", count(cost.tries)), ("table", result.table_sha256[:16]),
        *((f"version of {k}", v) for k, v in result.versions.items()),
    ]  # fmt: skip
    return {"outcomes": [(_OUTCOMES.get(k, k), count(n)) for k, n in sorted(result.outcomes.items())], "work": work}

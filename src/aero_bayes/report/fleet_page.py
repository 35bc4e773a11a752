"""The page of a fleet: parameters, effects and outliers, with links to the page of each rig."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.files import whole_file
from aero_bayes.report.drawing import Dots, Layer, Line, Panel
from aero_bayes.report.figure import WIDE_WIDTH, Plate, plate
from aero_bayes.report.page import fill
from aero_bayes.report.svg import ACCENT, MEASURED, MUTED, WARM_COLOUR
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
)
from aero_bayes.schema import FleetJson, FleetParameterJson, RangeJson, RigReasonJson, RunJson
from aero_bayes.simulation.gaussian import NORMAL_HALF_WIDTH

#: Width of a parameter's figure in CSS pixels, and rigs or effects that a list on the page names.
HALF_WIDTH, MAX_LISTED = 480.0, 40
#: Rigs up to which each is named and drawn with its interval, and points that are drawn of more.
MAX_NAMED_RIGS, MAX_DRAWN_POINTS = 200, 700
_OUTCOMES = {"adequate": "the model is adequate", "extended": "an effect was added",
             "unexplained": "an effect is missing, and no candidate explains it"}  # fmt: skip


@dataclass(frozen=True, eq=False)
class ParameterColumn:
    """A parameter of every rig: value and width (n,) of its own data, value in the light of the fleet, the curve.

    Widths are standard deviations of the value, or of its logarithm where ``shared.log``; ``curve`` is the fleet's
    distribution function as (values, shares below)."""

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
    words = {effect.id: effect.summary for effect in result.effects if effect.summary}
    ratio = np.where(columns.over_floor > 0.0, columns.over_floor, np.nan)
    level = Panel("largest residual, in noise floors", _points(ratio, columns), 200.0, levels=(1.0,), log_y=True)
    context = {
        "result": result, "names": columns.names[:MAX_NAMED_RIGS], "rig_page": rig_page,
        "title": f"Fleet of {count(result.rigs)} rigs",
        "parameters": [_parameter_plate(name, one, columns) for name, one in columns.parameters.items()
                       if np.isfinite(one.values).any()],
        "residual": _plate(level, ratio, WIDE_WIDTH) if np.isfinite(ratio).any() else None,
        "table": _parameter_table(result.parameters), "effects": _effect_table(result, words),
        "stand_out": _reasons(result.stand_out, words), "failures": _reasons(result.failures, words, linked=False),
        "more": {"stand_out": max(0, result.standing_out - MAX_LISTED), "failures": max(0, result.failed - MAX_LISTED)},
        "facts": _facts(result),
        "rigs": Markup(json.dumps(list(columns.names), separators=(",", ":")).replace("<", "\\u003c")),
    }  # fmt: skip
    page = fill("fleet.html.jinja", context, {}, [RunJson(words=words)], ("fleet",))
    with whole_file(directory / "report.html") as temporary:
        temporary.write_text(page, encoding="utf-8")
    return directory / "report.html"


def rig_page(name: str) -> str:
    """Return the address of a rig's own page, from the fleet's."""
    return f"rigs/{name}/report.html"


def _parameter_plate(name: str, one: ParameterColumn, columns: FleetColumns) -> Plate:
    """Draw the value of each rig in order, with its interval where there are few, and the fleet's distribution."""
    layers: list[Layer] = []
    if one.curve is not None:
        layers.append(Line(100.0 * one.curve[1], one.curve[0], MUTED, 1.2, dashes=True))
    share, order = _ranks(one.values)
    if len(order) <= MAX_NAMED_RIGS:
        half = NORMAL_HALF_WIDTH * one.widths[order]
        middle = one.values[order]
        ends = [middle * np.exp(s * half) if one.shared.log else middle + s * half for s in (-1.0, 1.0)]
        bars = np.column_stack([*ends, np.full(len(order), np.nan)]).ravel()
        layers += [Line(np.repeat(share, 3), bars, MEASURED, 1.1), Dots(share, one.shrunk[order], MUTED, 3.0, 0.9)]
    unit = pretty_unit(one.shared.unit)
    title = f"{greek_name(name)} ({unit})" if unit else greek_name(name)
    panel = Panel(title, (*layers, *_points(one.values, columns)), 200.0, x_limits=(0.0, 100.0), log_y=one.shared.log)
    return _plate(panel, one.values, HALF_WIDTH)


def _ranks(values: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the known values in order: the share of rigs below each in percent, and the places of the rigs."""
    known = np.flatnonzero(np.isfinite(values))
    order = known[np.argsort(values[known], kind="stable")]
    return 100.0 * (np.arange(len(order)) + 0.5) / max(len(order), 1), order


def _points(values: FloatArray, columns: FleetColumns) -> tuple[Dots, Dots]:
    """Draw each rig at its rank, of many rigs only some; rigs that stand out are all drawn, in another colour."""
    share, order = _ranks(values)
    odd = columns.flagged[order]
    plain = np.flatnonzero(~odd)[:: max(1, len(order) // MAX_DRAWN_POINTS)]
    return (
        Dots(share[plain], values[order[plain]], ACCENT, 5.0 if len(order) <= MAX_NAMED_RIGS else 2.4, 0.9),
        Dots(share[odd], values[order[odd]], WARM_COLOUR, 6.4, 1.0),
    )


def _plate(panel: Panel, values: FloatArray, width: float) -> Plate:
    rigs = int(np.isfinite(values).sum())
    low, middle, high = (significant(float(q)) for q in np.nanquantile(values, [0.05, 0.5, 0.95]))
    alt = f"{panel.title}: {rigs} rigs, half of them below {middle}, 90 % from {low} to {high}."
    return plate([panel], alt, "rigs below, %", width=width)


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
    )  # fmt: skip
    rows = []
    for e in result.effects[:MAX_LISTED]:
        rows.append((named_effect(e.id, words), count(e.named), _interval(e.share, "%", 100.0)))
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

"""The page of a fleet: parameters, effects and outliers, with links to the page of each rig."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from aero_bayes.files import whole_file
from aero_bayes.report.drawing import FloatArray
from aero_bayes.report.figure import NARROW_WIDTH, WIDE_WIDTH, Plate
from aero_bayes.report.fleet_figures import MAX_LINKED_RIGS, Ranked, ranked_drawing, rig_page
from aero_bayes.report.page import fill
from aero_bayes.report.svg import ACCENT, INK, MUTED, RULE, Canvas
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

#: Width of a parameter's figure in CSS pixels, rigs that a list on the page names, and effects that it shows.
HALF_WIDTH, MAX_RIGS_ON_PAGE, MAX_EFFECTS = 480.0, 40, 24
#: Central 90 % of a normal density, in standard deviations to either side.
Z90 = 1.6448536269514722


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
    """A number a rig for everything that is drawn, in the order of ``names``.

    ``present`` (n, k) is the probability of each of the result's effects, NaN where a rig says nothing.
    """

    names: Sequence[str]
    parameters: Mapping[str, ParameterColumn]
    over_floor: FloatArray
    seconds: FloatArray
    present: FloatArray
    flagged: NDArray[np.bool_]


def write_fleet_page(directory: Path, result: FleetJson, columns: FleetColumns) -> Path:
    """Draw ``DIR/report.html``: one file, of a few hundred bytes a rig at most."""
    target = directory / "report.html"
    page = render_fleet(result, columns)
    with whole_file(target) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return target


def render_fleet(result: FleetJson, columns: FleetColumns) -> str:
    """The page's text."""
    figures = list(_figures(columns))
    words = {effect.id: effect.summary for effect in result.effects if effect.summary}
    context = {
        "simulated": result.simulated,
        "title": f"Fleet of {count(result.rigs)} rigs", "verdict": result.verdict, "readings": _readings(result),
        "parameters": [(figure.key, _plate(figure)) for figure in figures if figure.key.startswith("p/")],
        "table": _parameter_table(result.parameters),
        "effects": _effects_plate(result) if result.effects else None, "effect_table": _effect_table(result, words),
        "by_rig": _matrix_plate(result, columns), "outcomes": _outcomes(result),
        "residual": next((_plate(f, WIDE_WIDTH) for f in figures if f.key == "over_floor"), None),
        "time": next((_plate(f, WIDE_WIDTH) for f in figures if f.key == "seconds"), None),
        "stand_out": _reasons(result.stand_out, words),
        "stand_out_more": max(0, result.standing_out - MAX_RIGS_ON_PAGE),
        "failures": _reasons(result.failures, words, linked=False),
        "failures_more": max(0, result.failed - MAX_RIGS_ON_PAGE),
        "links": columns.names if len(columns.names) <= MAX_LINKED_RIGS else [], "rig_page": rig_page,
        "provenance": _provenance(result), "few": len(columns.names) <= MAX_LINKED_RIGS,
        "rigs": Markup(json.dumps(list(columns.names), separators=(",", ":")).replace("<", "\\u003c")),
    }  # fmt: skip
    series = {figure.key: figure.values for figure in figures}
    return fill("fleet.html.jinja", context, series, [RunJson(words=words)], ("data", "fleet"))


def _figures(columns: FleetColumns) -> Iterator[Ranked]:
    for name, one in columns.parameters.items():
        if not np.isfinite(one.values).any():
            continue
        shared, unit = one.shared, pretty_unit(one.shared.unit)
        half = Z90 * one.widths
        ends = (one.values * np.exp(s * half) if shared.log else one.values + s * half for s in (-1.0, 1.0))
        low, high = ends
        label = f"{greek_name(name)} ({unit})" if unit else greek_name(name)
        yield Ranked(
            f"p/{name}", greek_name(name), label, columns.names, one.values, columns.flagged, low, high, one.shrunk,
            one.curve, shared.log,
        )  # fmt: skip
    for key, values, title, label, level in (
        ("over_floor", columns.over_floor, "residual of each rig, sorted",
         "largest residual, in noise floors", 1.0),
        ("seconds", columns.seconds, "computing time of each rig, sorted", "time (s)", None),
    ):  # fmt: skip
        positive = np.where(values > 0.0, values, np.nan)
        if np.isfinite(positive).any():
            yield Ranked(key, title, label, columns.names, positive, columns.flagged, log=True, level=level)


def _plate(shown: Ranked, width: float = HALF_WIDTH) -> Plate:
    rigs = int(np.isfinite(shown.values).sum())
    low, middle, high = (significant(float(q)) for q in np.nanquantile(shown.values, [0.05, 0.5, 0.95]))
    alt = f"{shown.title}: {rigs} rigs, half of them below {middle}, 90 % from {low} to {high} ({shown.x_label})."
    drawn = ranked_drawing(shown, width, alt), ranked_drawing(shown, NARROW_WIDTH, alt) if width > HALF_WIDTH else None
    return Plate(*drawn, alt, Markup(""), keys=frozenset([shown.key]), css="fleet")


def _readings(result: FleetJson) -> list[dict[str, Any]]:
    spreads = sorted(
        (p.spread.q50, name) for name, p in result.parameters.items() if p.log and p.spread.q50 is not None
    )
    found = [{"label": "Rigs", "value": count(result.rigs), "note": _fitted(result), "level": ""}]
    if spreads:
        widest = result.parameters[spreads[-1][1]].spread
        note = Markup("of {}; 90 %: {} to {} %").format(
            symbol(spreads[-1][1]), *(significant(100 * (q or 0.0), 2) for q in (widest.q05, widest.q95))
        )
        value = f"{significant(100 * (widest.q50 or 0.0), 2)} %"
        found.append({"label": "Largest spread", "value": value, "note": note, "level": ""})
    if result.effects:
        share, id_ = result.effects[0].share, result.effects[0].id
        if share.q50 is not None:
            note = Markup("have <code>{}</code>; 90 %: {}").format(id_, _percent(share))
            found.append({"label": "Of all rigs", "value": f"{100 * share.q50:.0f} %", "note": note, "level": ""})
    level = "warning" if result.standing_out else "good"
    found.append({"label": "Outliers", "value": count(result.standing_out), "note": "rigs unlike the others",
                  "level": level})  # fmt: skip
    cost = result.cost
    found.append({"label": "Work", "value": duration(cost.seconds), "level": "",
                  "note": f"on {cost.workers} worker process{'es' if cost.workers != 1 else ''}"})  # fmt: skip
    return found


def _fitted(result: FleetJson) -> str:
    return f"{count(result.failed)} could not be fitted" if result.failed else "all were fitted"


def _percent(share: RangeJson) -> str:
    if share.q05 is None or share.q95 is None:
        return NO_VALUE
    return f"{100 * share.q05:.0f} to {100 * share.q95:.0f} %"


def _parameter_table(parameters: Mapping[str, FleetParameterJson]) -> Markup | None:
    """Typical value, spread and the next rig's value, each with its 90 % interval."""
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


def _interval(found: RangeJson, unit: str, factor: float = 1.0) -> Markup | str:
    if found.q50 is None or found.q05 is None or found.q95 is None:
        return NO_VALUE
    shown = rounded_value(factor * found.q50, factor * found.q05, factor * found.q95, unit)
    power = shown.unit.partition(" ")[0] if shown.unit.startswith("×") else ""
    sign = " %" if unit == "%" else ""
    return Markup("{}{}{}<small>{} … {}</small>").format(shown.value, sign, power, shown.low, shown.high)


def _effects_plate(result: FleetJson) -> Plate:
    """The share of rigs that have each effect, with its 90 % interval."""
    shown = [effect for effect in result.effects if effect.share.q50 is not None][:MAX_EFFECTS]
    alt = "Share of rigs that have " + ", ".join(f"{e.id}: {_percent(e.share)}" for e in shown) + "."
    wide, narrow = (_effects_drawing(result, width, alt) for width in (WIDE_WIDTH, NARROW_WIDTH))
    return Plate(wide, narrow, alt, Markup(""))


def _effects_drawing(result: FleetJson, width: float, alt: str) -> Markup:
    shown = [effect for effect in result.effects if effect.share.q50 is not None][:MAX_EFFECTS]
    line, label = 24.0, (300.0 if width > 600 else 0.0)
    step = line if label else 1.7 * line
    canvas = Canvas(width, step * len(shown) + 34, alt)
    foot = step * len(shown) + 6

    def across(share: float) -> float:
        return label + 8 + (width - label - 24) * share

    for tick in (0.0, 0.25, 0.5, 0.75, 1.0):
        canvas.curve([across(tick)] * 2, [2, foot], RULE, 0.8)
        canvas.text(across(tick), foot + 16, f"{100 * tick:.0f} %", MUTED, 11.5, "middle" if tick or label else "start")
    for row, effect in enumerate(shown):
        y = step * (row + 1) - 0.5 * line
        canvas.text(0, y + 4 if label else y - 11, f"{effect.id}  (found in {effect.named})", INK, 12)
        low, middle, high = (across(q or 0.0) for q in (effect.share.q05, effect.share.q50, effect.share.q95))
        canvas.curve([low, high], [y, y], ACCENT, 4.0)
        canvas.dots(np.array([middle]), np.array([y]), ACCENT, 10.0, 1.0)
        at = across(effect.named / max(1, result.rigs - result.failed))
        canvas.curve([at, at], [y - 6, y + 6], INK, 1.4)
    return canvas.svg()


def _effect_table(result: FleetJson, words: Mapping[str, str]) -> Markup | None:
    rows = [
        (
            named_effect(e.id, words),
            count(e.named),
            _percent(e.share),
            tidy(100.0 * e.noticed, 2) if e.noticed else None,
        )
        for e in result.effects[:MAX_EFFECTS]
    ]
    heads = (
        "effect", Column("rigs whose loop found it", "right"), Column("share of all rigs, 90 % interval", "right"),
        Column("found where present, %", "right"),
    )  # fmt: skip
    return html_table(heads, rows, "Effects") if rows else None


def _matrix_plate(result: FleetJson, columns: FleetColumns) -> Plate | None:
    """Effects by rig: a spot as large as the effect is probable; for few rigs only."""
    count_, shown = len(columns.names), result.effects[:MAX_EFFECTS]
    if not shown or not 0 < count_ <= MAX_LINKED_RIGS or not np.isfinite(columns.present).any():
        return None
    alt = f"How probable each of {len(shown)} effects is in each of {count_} rigs."
    wide, narrow = (_matrix_drawing(columns, [e.id for e in shown], width, alt) for width in (WIDE_WIDTH, NARROW_WIDTH))
    return Plate(
        wide,
        narrow,
        alt,
        Markup("The area of a spot is the probability of the effect. Rigs are in the order of their names."),
    )


def _matrix_drawing(columns: FleetColumns, ids: Sequence[str], width: float, alt: str) -> Markup:
    label = 300.0 if width > 600 else 0.0
    room = (width - label - 16) / len(columns.names)
    size, step = min(20.0, room), (min(24.0, max(12.0, room)) if label else 38.0)
    canvas = Canvas(width, step * len(ids) + 8, alt)
    for row, id_ in enumerate(ids):
        y = step * (row + 1) - (0.5 * step if label else 8.0)
        canvas.text(0, y + 4 if label else y - 12, id_, INK, 12)
        for k, (name, share) in enumerate(zip(columns.names, columns.present[:, row].tolist(), strict=True)):
            x = label + 8 + (k + 0.5) * min(room, 26.0)
            canvas.dots(np.array([x]), np.array([y]), RULE, 0.75 * size, 1.0)
            if share > 0.02:
                canvas.dots(np.array([x]), np.array([y]), ACCENT, 0.75 * size * share**0.5, 1.0)
            canvas.link(rig_page(name), f"{name}: {100 * share:.0f} %", x, y, size)
    return canvas.svg()


def _outcomes(result: FleetJson) -> list[tuple[str, str]]:
    words = {
        "adequate": "the model is adequate", "extended": "an effect was added",
        "unexplained": "an effect is missing, and no candidate explains it",
    }  # fmt: skip
    return [(words.get(key, key), count(number)) for key, number in sorted(result.outcomes.items())]


def _reasons(rigs: Sequence[RigReasonJson], words: Mapping[str, str], *, linked: bool = True) -> Markup | None:
    rows = []
    for entry in rigs[:MAX_RIGS_ON_PAGE]:
        name = Markup('<a href="{}">{}</a>').format(rig_page(entry.rig), entry.rig) if linked else entry.rig
        rows.append((name, Markup("<br>").join(sentence(reason, words) for reason in entry.reasons)))
    return html_table(("rig", "why"), rows) if rows else None


def _provenance(result: FleetJson) -> list[tuple[str, str]]:
    cost = result.cost
    return [
        ("work", result.work), ("seed", str(result.seed)), ("computing time of all rigs", duration(cost.seconds)),
        ("processor time of the workers", duration(cost.cpu_seconds)),
        ("rigs started more than once", count(cost.tries)), ("table", result.table_sha256[:16]),
        *((f"version of {k}", v) for k, v in result.versions.items()),
    ]  # fmt: skip

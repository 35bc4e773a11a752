"""The proposed experiment: its signal, what is expected of it, and whether that comes true in simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from aero_bayes.report.drawing import Layer, Panel, Plate, band, draw, line
from aero_bayes.report.effect_names import named_effect
from aero_bayes.report.run_directory import FloatArray, RunDirectory, mapping, number, texts
from aero_bayes.report.series_figures import NARROW, WIDE, columns_for, largest, named, unit_of
from aero_bayes.report.svg import INK, SERIES
from aero_bayes.report.tables import Column, bar, html_table, parameter_quantity
from aero_bayes.report.text import (
    NOTHING,
    count,
    duration,
    minus,
    pretty_unit,
    scaled_unit,
    signal_title,
    significant,
    symbol,
    tidy,
)


@dataclass(frozen=True)
class Experiment:
    """What the page shows of a proposal."""

    lead: Markup
    file: str
    signal: Plate | None
    gains: Markup | None
    models: Markup | None
    check: Markup
    families: Markup | None
    limits: Markup | None


def experiment(run: RunDirectory) -> Experiment | None:
    """The proposal of a run of ``aero-bayes design``; None for other runs."""
    plan = mapping(run.result, "design")
    if not plan:
        return None
    separate = plan.get("kind") == "separate"
    return Experiment(
        _lead(plan), str(plan.get("file", "")), _signal(run, plan), None if separate else _gains(plan),
        _models(plan) if separate else None, _separation_check(plan) if separate else _gain_check(plan),
        _families(plan), _limits(run, plan),
    )  # fmt: skip


def _lead(plan: Mapping[str, Any]) -> Markup:
    length = f"{duration(number(plan.get('duration')))}, {plan.get('family', '')}"
    if plan.get("kind") == "separate":
        first, second = [*texts(plan, "effects"), "", ""][:2]
        words = Markup("The input that would best tell {} from {}: {}.").format(
            named_effect(first), named_effect(second), length
        )
        if common := texts(plan, "common"):
            both = Markup(", ").join(named_effect(id_) for id_ in common)
            words += Markup(" Both models also have {}.").format(both)
        return words
    aimed = [name for name, entry in mapping(plan, "parameters").items() if mapping(entry).get("target")]
    names = Markup(", ").join(symbol(name) for name in aimed)
    return Markup("The input that would tell most about {}: {}.").format(names, length)


def _signal(run: RunDirectory, plan: Mapping[str, Any]) -> Plate | None:
    time = run.series.get("plan/time")
    driven = str(plan.get("input", ""))
    values = run.series.get(f"plan/input/{driven}")
    if time is None or values is None or len(time) < 2:
        return None
    models = list(dict.fromkeys(k.split("/")[2] for k in run.series if k.startswith("plan/middle/")))
    outputs = list(dict.fromkeys(k.split("/")[3] for k in run.series if k.startswith("plan/middle/")))
    unit = str(plan.get("unit") or unit_of(run, driven))

    def panels(width: float) -> list[Panel]:
        columns = columns_for(width)
        held = line(np.repeat(time, 2)[1:], np.repeat(values, 2)[:-1], INK, columns, 1.3)
        drawn = [Panel(signal_title(driven, pretty_unit(unit)), (held,), height=70, ticks=3)]
        return drawn + [_output(run, plan, time, name, models, columns) for name in outputs]

    alt = f"Proposed {driven} over {duration(float(time[-1] - time[0]))} and the expected {named(outputs)}."
    legend = tuple(
        (SERIES[k % len(SERIES)], "expected, with its 90 % band" if model == "expected" else f"if {model} is true")
        for k, model in enumerate(models)
    )
    caption = Markup("Outputs without sensor noise. Dashed: limits of travel.") if mapping(plan, "limits", "travel") \
        else Markup("Outputs without sensor noise.")  # fmt: skip
    return Plate(
        draw(panels(WIDE), WIDE, alt, "time (s)"), draw(panels(NARROW), NARROW, alt, "time (s)"), alt, caption, legend
    )


def _output(
    run: RunDirectory, plan: Mapping[str, Any], time: FloatArray, name: str, models: list[str], columns: int
) -> Panel:
    """An output as every model expects it; with its limit where the signal comes near."""
    curves = {m: [run.series[f"plan/{part}/{m}/{name}"] for part in ("lower", "middle", "upper")] for m in models}
    most = largest(*(curve for triple in curves.values() for curve in triple))
    limit = number(mapping(plan, "limits", "travel").get(name))
    levels = (-limit, limit) if limit is not None and most > 0.4 * limit else ()
    factor, unit = scaled_unit(max(most, *levels) if levels else most, unit_of(run, name))
    layers: list[Layer] = []
    for k, triple in enumerate(curves.values()):
        colour = SERIES[k % len(SERIES)]
        low, middle, high = (curve * factor for curve in triple)
        layers += [band(time, low, high, colour, columns), line(time, middle, colour, columns, 1.2)]
    shown = tuple(factor * level for level in levels)
    edge = 1.06 * max(factor * most, *shown) if shown else None
    return Panel(
        signal_title(name, unit), tuple(layers), 130, levels=shown, y_limits=None if edge is None else (-edge, edge)
    )


def _gains(plan: Mapping[str, Any]) -> Markup | None:
    rows: list[tuple[object, ...]] = []
    marked: list[int] = []
    entries = {name: mapping(entry) for name, entry in mapping(plan, "parameters").items()}
    most = max((number(entry.get("gain")) or 0.0 for entry in entries.values()), default=1.0)
    for name, entry in sorted(entries.items(), key=lambda item: not item[1].get("target")):
        value, now = number(entry.get("value")), number(entry.get("sd_before"))
        gain, achieved = number(entry.get("gain")), number(entry.get("sd_achieved"))
        if value is None or now is None:
            continue
        shown, _ = parameter_quantity(
            {"value": value, "q05": value - now, "q95": value + now, "unit": entry.get("unit")}
        )
        after, repeated = number(entry.get("sd_after")), number(entry.get("sd_repeated"))
        if entry.get("target"):
            marked.append(len(rows))
        rows.append((
            symbol(name), shown.value, shown.unit, *(_relative(sd, value) for sd in (now, after, achieved, repeated)),
            bar((gain or 0.0) / most, f"{name}: {significant(gain)} times narrower"), _times(gain),
        ))  # fmt: skip
    columns = (
        "parameter", Column("value", "right"), "unit", Column("now", "right"), Column("expected after", "right"),
        Column("in simulation", "right"), Column("same input again", "right"), "", Column("times narrower", "right"),
    )  # fmt: skip
    caption = "Standard deviations in per cent of the value (marked: what the signal is for)"
    return html_table(columns, rows, caption, marked) if rows else None


def _relative(sd: float | None, value: float) -> str:
    return NOTHING if sd is None or not value else f"{significant(100 * sd / abs(value), 2)} %"


def _times(gain: float | None) -> str:
    return NOTHING if gain is None else f"{gain:.2f}" if gain < 10 else tidy(gain, 3)


def _models(plan: Mapping[str, Any]) -> Markup | None:
    """The two effects as the recordings at hand have them."""
    rows = []
    for entry in plan.get("models") or []:
        for name, stated in mapping(entry, "parameters").items():
            shown, sure = parameter_quantity(mapping(stated))
            interval = f"{shown.low} … {shown.high}" if sure else NOTHING
            label = named_effect(str(mapping(entry).get("id")))
            rows.append((label, symbol(name), shown.value, interval, shown.unit))
    columns = ("effect", "parameter", Column("value", "right"), Column("90 % interval", "right"), "unit")
    return html_table(columns, rows, "The two effects, fitted to the recordings at hand") if rows else None


def _gain_check(plan: Mapping[str, Any]) -> Markup:
    check = mapping(plan, "check")
    repeats, failures = (int(number(check.get(key)) or 0) for key in ("repeats", "failures"))
    verdict = "The expected gain comes true." if check.get("agrees") else "The expected gain does not quite come true."
    return Markup(
        "{} {} simulated repetitions: a truth drawn from what is known, its recording with noise, a fit to it. "
        "The errors that were left are in the column <em>in simulation</em>, each uncertain by about {} %{}."
    ).format(
        verdict, count(repeats - failures), f"{100 / (2 * max(repeats - failures, 1)) ** 0.5:.0f}",
        f"; {count(failures)} more failed" if failures else "",
    )  # fmt: skip


def _already(plan: Mapping[str, Any]) -> Markup:
    """What the recordings at hand say of the two effects."""
    densities = plan.get("log_posterior_now") or []
    first, second = (number(x) for x in [*densities, None, None][:2])
    if first is None or second is None:
        return Markup("")
    names = texts(plan, "effects")
    if abs(first - second) < (number(mapping(plan, "check").get("decisive")) or 0.0):
        return Markup("The recordings at hand do not tell them apart (difference in log-posterior {}). ").format(
            significant(abs(first - second), 2)
        )
    better = names[0] if first > second else names[1]
    return Markup("The recordings at hand already favour {}, by {} in log-posterior. ").format(
        named_effect(better), significant(abs(first - second))
    )


def _separation_check(plan: Mapping[str, Any]) -> Markup:
    check = mapping(plan, "check")
    repeats, failures = (int(number(check.get(key)) or 0) for key in ("repeats", "failures"))
    share = 100 * (number(check.get("told_apart")) or 0.0)
    return _already(plan) + Markup(
        "Expected difference in log-evidence: {} if the first is true, {} if the second is. In {} simulated "
        "repetitions, half of them with either: {} and {} on average; {} % of them put the true one ahead by more "
        "than {} (odds of twenty to one){}. The expectation is linear in what is not known; the repetitions are not."
    ).format(
        significant(number(plan.get("first_true"))), significant(number(plan.get("second_true"))),
        count(repeats - failures), significant(number(check.get("first_true"))),
        significant(number(check.get("second_true"))), f"{share:.0f}", tidy(number(check.get("decisive"))),
        f"; {count(failures)} more failed" if failures else "",
    )  # fmt: skip


def _families(plan: Mapping[str, Any]) -> Markup | None:
    """How well the best signal of each kind would do."""
    scores = {name: score for name, x in mapping(plan, "families").items() if (score := number(x)) is not None}
    if not scores:
        return None
    separate = plan.get("kind") == "separate"
    worth = {name: score if separate else float(np.exp(-score)) for name, score in scores.items()}
    most = max(worth.values())
    rows = [
        (name, bar(value / most if most > 0 else 0.0, f"{name}: {significant(value)}"), significant(value))
        for name, value in sorted(worth.items(), key=lambda item: -item[1])
    ]
    head = "difference in log-evidence" if separate else "times narrower"
    return html_table(("kind of signal", "", Column(head, "right")), rows, "The best signal of every kind tried")


def _limits(run: RunDirectory, plan: Mapping[str, Any]) -> Markup | None:
    driven, limits = str(plan.get("input", "")), mapping(plan, "limits")
    values = run.series.get(f"plan/input/{driven}")
    rows = [(
        symbol(driven), significant(None if values is None else largest(values)),
        significant(number(limits.get("amplifier"))), pretty_unit(plan.get("unit") or unit_of(run, driven)),
    )]  # fmt: skip
    for name, limit in mapping(limits, "travel").items():
        reached = number(mapping(plan, "travel").get(name))
        rows.append((symbol(name), significant(reached), significant(number(limit)), pretty_unit(unit_of(run, name))))
    columns = ("", Column("largest", "right"), Column("limit", "right"), "unit")
    return html_table(columns, [(a, minus(b), minus(c), d) for a, b, c, d in rows], "What the rig is asked for")

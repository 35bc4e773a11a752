"""The proposed experiment: its signal and the expected gain."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup

from aero_bayes.arrays import FloatArray
from aero_bayes.report.curves import largest, named
from aero_bayes.report.drawing import Band, Layer, Line, Panel, Plate, plate
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.schema_estimate import QuantilesJson
from aero_bayes.report.schema_run import DesignJson
from aero_bayes.report.svg import INK, SERIES
from aero_bayes.report.tables import bar, html_table, parameter_quantity
from aero_bayes.report.text import (
    NO_VALUE,
    duration,
    minus,
    named_effect,
    pretty_unit,
    scaled_unit,
    signal_title,
    significant,
    symbol,
    tidy,
)

_TIME = "plan/time"
#: Difference in log-evidence above which two models count as separated (odds of 20 to 1).
DECISIVE = 3.0


def experiment(run: RunDirectory) -> list[Any]:
    """Return what the page shows of a run of ``aero-bayes design``: nothing of other runs."""
    plan, words = run.result.design, run.result.effect_words()
    if plan is None:
        return []
    lead = Markup('<p class="lead">{}</p>').format(_lead(plan, words))
    found = [_models(plan, words), Markup("<p>{}</p>").format(_separation(plan, words))]
    found = found if plan.kind == "separate" else [_gains(plan)]
    return [lead, _signal(run, plan), *found, _families(plan), _limits(run, plan)]


def _lead(plan: DesignJson, words: dict[str, str]) -> Markup:
    length = Markup("{}, {}.").format(duration(plan.duration), plan.family)
    if plan.file:
        where = " The signal is in <code>{}</code>: one row per sample, each value holds until the next."
        length += Markup(where).format(plan.file)
    if plan.kind == "separate":
        first, second = (named_effect(id_, words) for id_ in plan.effects)
        return Markup("This input would best tell {} from {}: {}").format(first, second, length)
    names = Markup(", ").join(symbol(name) for name, entry in plan.parameters.items() if entry.target)
    return Markup("This input would narrow the intervals of {} most: {}").format(names, length)


def _signal(run: RunDirectory, plan: DesignJson) -> Plate | None:
    time, values = run.series.get(_TIME), run.series.get(f"plan/input/{plan.input}")
    if time is None or values is None or len(time) < 2:
        return None
    models = list(dict.fromkeys(k.split("/")[2] for k in run.series if k.startswith("plan/middle/")))
    outputs = list(dict.fromkeys(k.split("/")[3] for k in run.series if k.startswith("plan/middle/")))
    unit = pretty_unit(plan.unit or run.result.unit(plan.input))
    held = Line(time, values, INK, 1.3, label="input", held=True)
    panels = [Panel(signal_title(plan.input, unit), (held,), height=70, ticks=3)]
    panels += [_output(run, plan, time, name, models) for name in outputs]
    alt = f"Proposed {plan.input} over {duration(float(time[-1] - time[0]))} and the expected {named(outputs)}."
    legend = tuple(
        (SERIES[k % len(SERIES)], "expected, with its 90 % band" if model == "expected" else f"if {model} is true")
        for k, model in enumerate(models)
    )
    caption = "Outputs without sensor noise." + (" Dashed: limits of the outputs." if plan.limits.travel else "")
    return plate(panels, alt, "time (s)", caption, legend=legend, link="plan")


def _output(run: RunDirectory, plan: DesignJson, time: FloatArray, name: str, models: list[str]) -> Panel:
    """Return an output as every model expects it; with its limit where the signal comes near."""
    keys = {m: [f"plan/{part}/{m}/{name}" for part in ("lower", "middle", "upper")] for m in models}
    most = largest(*(run.series[key] for triple in keys.values() for key in triple))
    limit = plan.limits.travel.get(name)
    levels = (-limit, limit) if limit is not None and most > 0.4 * limit else ()
    factor, unit = scaled_unit(max(most, *levels) if levels else most, run.result.unit(name))
    layers: list[Layer] = []
    for k, (model, (low, middle, high)) in enumerate(keys.items()):
        colour = SERIES[k % len(SERIES)]
        edges = factor * run.series[low], factor * run.series[high]
        layers += [
            Band(time, *edges, colour, label=f"{model}, 90 %"),
            Line(time, factor * run.series[middle], colour, 1.2, label=model),
        ]
    shown = tuple(factor * level for level in levels)
    edge = 1.06 * max(factor * most, *shown) if shown else None
    limits = None if edge is None else (-edge, edge)
    return Panel(signal_title(name, unit), tuple(layers), 130, levels=shown, y_limits=limits)


def _gains(plan: DesignJson) -> Markup:
    rows: list[tuple[object, ...]] = []
    marked: list[int] = []
    most = max((entry.gain or 0.0 for entry in plan.parameters.values()), default=1.0)
    for name, entry in sorted(plan.parameters.items(), key=lambda item: not item[1].target):
        value, now = entry.value, entry.sd_before
        if value is None or now is None:
            continue
        shown, _ = parameter_quantity(QuantilesJson(value=value, q05=value - now, q95=value + now, unit=entry.unit))
        spreads = (now, entry.sd_after, entry.sd_repeated)
        if entry.target:
            marked.append(len(rows))
        rows.append((
            symbol(name), shown.value, shown.unit, *(_relative(sd, value) for sd in spreads),
            bar((entry.gain or 0.0) / most, f"{name}: {significant(entry.gain)} times narrower"), _times(entry.gain),
        ))  # fmt: skip
    columns = ("parameter", "value", "unit", "now", "expected after", "old input again", "", "times narrower")
    caption = "Standard deviations in per cent of the value (marked: the parameters that the signal is for)"
    return html_table(columns, rows, caption, marked)


def _relative(sd: float | None, value: float) -> str:
    return NO_VALUE if sd is None or not value else f"{significant(100 * sd / abs(value), 2)} %"


def _times(gain: float | None) -> str:
    return NO_VALUE if gain is None else f"{gain:.2f}" if gain < 10 else tidy(gain, 3)


def _models(plan: DesignJson, words: dict[str, str]) -> Markup:
    """Return the two effects as they fit the present recordings."""
    rows = []
    for entry in plan.models:
        for name, stated in entry.parameters.items():
            shown, sure = parameter_quantity(stated)
            interval = f"{shown.low} … {shown.high}" if sure else NO_VALUE
            rows.append((named_effect(entry.id, words), symbol(name), shown.value, interval, shown.unit))
    columns = ("effect", "parameter", "value", "90 % interval", "unit")
    return html_table(columns, rows, "The two effects, fitted to the present recordings")


def _already(plan: DesignJson, words: dict[str, str]) -> Markup:
    """Say which of the two effects the present recordings favour."""
    first, second = [*plan.log_posterior_now, None, None][:2]
    if first is None or second is None:
        return Markup("")
    if abs(first - second) < DECISIVE:
        return Markup("The present recordings do not tell them apart (difference in log-posterior {}). ").format(
            significant(abs(first - second), 2)
        )
    better = plan.effects[0] if first > second else plan.effects[1]
    return Markup("The present recordings already favour {}, by {} in log-posterior. ").format(
        named_effect(better, words), significant(abs(first - second))
    )


def _separation(plan: DesignJson, words: dict[str, str]) -> Markup:
    return _already(plan, words) + Markup(
        "Expected difference in log-evidence, by a linearised model: {} if the first effect is true, {} if the "
        "second is ({} are odds of 20 to 1)."
    ).format(significant(plan.first_true), significant(plan.second_true), tidy(DECISIVE))


def _families(plan: DesignJson) -> Markup:
    """Return how well the best signal of each kind would do."""
    scores = {name: score for name, score in plan.families.items() if score is not None}
    separate = plan.kind == "separate"
    worth = {name: score if separate else float(np.exp(-score)) for name, score in scores.items()}
    most = max(worth.values(), default=0.0)
    rows = [
        (name, bar(value / most if most > 0 else 0.0, f"{name}: {significant(value)}"), significant(value))
        for name, value in sorted(worth.items(), key=lambda item: -item[1])
    ]
    head = "difference in log-evidence" if separate else "times narrower"
    return html_table(("kind of signal", "", head), rows, "The best signal of each kind")


def _limits(run: RunDirectory, plan: DesignJson) -> Markup:
    values = run.series.get(f"plan/input/{plan.input}")
    rows = [(
        symbol(plan.input), significant(None if values is None else largest(values)),
        significant(plan.limits.amplifier), pretty_unit(plan.unit or run.result.unit(plan.input)),
    )]  # fmt: skip
    for name, limit in plan.limits.travel.items():
        reached = plan.travel.get(name)
        rows.append((symbol(name), significant(reached), significant(limit), pretty_unit(run.result.unit(name))))
    columns = ("", "largest", "limit", "unit")
    return html_table(columns, [(a, minus(b), minus(c), d) for a, b, c, d in rows], "Demands on the rig")

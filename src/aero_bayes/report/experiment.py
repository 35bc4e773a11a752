"""The proposed experiment: its signal and the expected gain."""

from __future__ import annotations

import math
from typing import Any

from markupsafe import Markup

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.identifiability import Estimate
from aero_bayes.estimate.propose import DesignJson
from aero_bayes.report.curves import largest, named
from aero_bayes.report.drawing import Band, Line, Panel, Plate, plate
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.svg import INK, SERIES
from aero_bayes.report.tables import bar, html_table, parameter_quantity
from aero_bayes.report.text import (
    NO_VALUE,
    duration,
    minus,
    pretty_unit,
    scaled_unit,
    signal_title,
    significant,
    symbol,
    tidy,
)

_TIME = "plan/time"


def experiment(run: RunDirectory) -> list[Any]:
    """Return what the page shows of a run of ``aero-bayes design``: nothing of other runs."""
    plan = run.result.design
    if plan is None:
        return []
    lead = Markup('<p class="lead">{}</p>').format(_lead(plan))
    return [lead, _signal(run, plan), _gains(plan), _limits(run, plan)]


def _lead(plan: DesignJson) -> Markup:
    length = Markup("{} of steps.").format(duration(plan.duration))
    if plan.file:
        where = " The signal is in <code>{}</code>: one row per sample, each value holds until the next."
        length += Markup(where).format(plan.file)
    names = Markup(", ").join(symbol(name) for name, entry in plan.parameters.items() if entry.target)
    return Markup("This input would narrow the intervals of {} most: {}").format(names, length)


def _signal(run: RunDirectory, plan: DesignJson) -> Plate | None:
    time, values = run.series.get(_TIME), run.series.get(f"plan/input/{plan.input}")
    if time is None or values is None or len(time) < 2:
        return None
    outputs = [k.split("/")[2] for k in run.series if k.startswith("plan/middle/")]
    unit = pretty_unit(plan.unit or run.result.unit(plan.input))
    held = Line(time, values, INK, 1.3, label="input", held=True)
    panels = [Panel(signal_title(plan.input, unit), (held,), height=70, ticks=3)]
    panels += [_output(run, plan, time, name) for name in outputs]
    alt = f"Proposed {plan.input} over {duration(float(time[-1] - time[0]))} and the expected {named(outputs)}."
    legend = ((SERIES[0], "expected, with its 90 % band"),)
    caption = "Outputs without sensor noise." + (" Dashed: limits of the outputs." if plan.limits.travel else "")
    return plate(panels, alt, "time (s)", caption, legend=legend, link="plan")


def _output(run: RunDirectory, plan: DesignJson, time: FloatArray, name: str) -> Panel:
    """Return an output as the fit expects it; with its limit where the signal comes near."""
    low, middle, high = (run.series[f"plan/{part}/{name}"] for part in ("lower", "middle", "upper"))
    most = largest(low, middle, high)
    limit = plan.limits.travel.get(name)
    levels = (-limit, limit) if limit is not None and most > 0.4 * limit else ()
    factor, unit = scaled_unit(max(most, *levels) if levels else most, run.result.unit(name))
    band = Band(time, factor * low, factor * high, SERIES[0], label="expected, 90 %")
    layers = (band, Line(time, factor * middle, SERIES[0], 1.2, label="expected"))
    shown = tuple(factor * level for level in levels)
    edge = 1.06 * max(factor * most, *shown) if shown else None
    limits = None if edge is None else (-edge, edge)
    return Panel(signal_title(name, unit), layers, 130, levels=shown, y_limits=limits)


def _gains(plan: DesignJson) -> Markup:
    rows: list[tuple[object, ...]] = []
    marked: list[int] = []
    most = max((entry.gain for entry in plan.parameters.values() if math.isfinite(entry.gain)), default=1.0)
    for name, entry in sorted(plan.parameters.items(), key=lambda item: not item[1].target):
        value, now = entry.value, entry.sd_before
        if not math.isfinite(value + now):
            continue
        shown, _ = parameter_quantity(Estimate(name, value, q05=value - now, q95=value + now, unit=entry.unit))
        spreads = (now, entry.sd_after, entry.sd_repeated)
        if entry.target:
            marked.append(len(rows))
        rows.append((
            symbol(name), shown.value, shown.unit, *(_relative(sd, value) for sd in spreads),
            bar(entry.gain / most, f"{name}: {significant(entry.gain)} times narrower"), _times(entry.gain),
        ))  # fmt: skip
    columns = ("parameter", "value", "unit", "now", "expected after", "old input again", "", "times narrower")
    caption = "Standard deviations in per cent of the value (marked: the parameters that the signal is for)"
    return html_table(columns, rows, caption, marked)


def _relative(sd: float, value: float) -> str:
    return NO_VALUE if not math.isfinite(sd) or not value else f"{significant(100 * sd / abs(value), 2)} %"


def _times(gain: float) -> str:
    return NO_VALUE if not math.isfinite(gain) else f"{gain:.2f}" if gain < 10 else tidy(gain, 3)


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

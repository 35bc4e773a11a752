"""What the loop's evidence rests on, and the structures that it leaves, with intervals over all of them."""

from __future__ import annotations

from markupsafe import Markup

from aero_bayes.display import join_names
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.tables import Column, html_table, parameter_quantity
from aero_bayes.report.text import NO_VALUE, significant, symbol
from aero_bayes.schema import LoopPart, Quantiles


def evidence_words(loop: LoopPart) -> str:
    """How many effective samples the log-evidence rests on; empty where the result does not say."""
    samples = [n for n in loop.effective_samples.values() if n is not None]
    if not samples or not loop.readings:
        return ""
    text = (
        "It is honest evidence: the log-evidence of "
        f"{_samples(sum(samples))} effective samples (of {_readings(sum(loop.readings.values()))})"
    )
    if len(samples) < 2:
        return f"{text}."
    parts = [
        f"{_samples(n)} of {symbol(output)} (of {_readings(loop.readings[output])})"
        for output, n in loop.effective_samples.items()
        if n is not None
    ]
    return f"{text}: {join_names(parts)}."


def structures_words(loop: LoopPart) -> str:
    """The structures that the data leave, with their odds; empty where there is one."""
    if loop.averaged is None:
        return ""
    found = [f"{join_names(s.terms)} (odds {significant(s.odds, 2)})" for s in loop.averaged.structures]
    return (
        f"The data leave {len(found)} structures: {'; '.join(found)}. The intervals of the parameters that all of them "
        "have are those of the mixture, weighted by these odds."
    )


def averaged_table(run: RunDirectory, loop: LoopPart) -> Markup | None:
    """How far intervals over all structures differ from those of the chosen one; None where there is one structure."""
    if loop.averaged is None:
        return None
    rows = []
    for name, found in loop.averaged.parameters.items():
        stated = run.result.parameters.get(name)
        if stated is None or stated.q05 is None:
            continue
        one, all_ = (
            parameter_quantity(q.model_copy(update={"value": q.q50, "unit": stated.unit}))[0]
            for q in (found.chosen, found.mixture)
        )
        widths = [_width(q) for q in (found.chosen, found.mixture)]
        rows.append((
            Markup("{}<small>{}</small>").format(symbol(name), stated.description), f"{one.low} … {one.high}",
            f"{all_.low} … {all_.high}", all_.unit,
            significant(widths[1] / widths[0], 3) if widths[0] > 0.0 else NO_VALUE,
        ))  # fmt: skip
    if not rows:
        return None
    columns = (
        "parameter", Column("chosen structure", "right"), Column("all structures", "right"), "unit",
        Column("times as wide", "right"),
    )  # fmt: skip
    return html_table(columns, rows, "90 % intervals over the structures that the data leave")


def _width(q: Quantiles) -> float:
    return (q.q95 or 0.0) - (q.q05 or 0.0)


def _samples(count: float) -> str:
    return f"{count:,.0f}"


def _readings(count: int) -> str:
    return f"{count:,} readings"

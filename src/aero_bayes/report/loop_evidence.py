"""The structures that the loop leaves, with intervals over all of them, and process noise."""

from __future__ import annotations

from markupsafe import Markup

from aero_bayes.display import join_names
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.tables import Column, html_table, parameter_quantity
from aero_bayes.report.text import NO_VALUE, significant, symbol
from aero_bayes.schema import LoopJson, QuantilesJson


def structures_words(loop: LoopJson) -> str:
    """Return the structures that the data leave, with how often each is the best; empty where there is one."""
    if loop.averaged is None:
        return ""
    found = [f"{join_names(s.terms)} (best in {100.0 * (s.wins or 0.0):.0f} %)" for s in loop.averaged.structures]
    return (
        f"The data leave {len(found)} structures: {'; '.join(found)}. The intervals of the parameters that all of them "
        "have are those of the mixture, weighted by how often each is the best on resampled blocks."
    )


def averaged_table(run: RunDirectory, loop: LoopJson) -> Markup | None:
    """Return how far intervals over all structures differ from those of the chosen one.

    None where there is one structure."""
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


def process_noise_words(loop: LoopJson) -> str:
    """Return what process noise explains, and its gain; empty where it gains nothing."""
    found = loop.process_noise
    if found is None:
        return ""
    gain, needed = significant(found.log_evidence_gain, 3), significant(found.needed, 2)
    return f"{found.sentence} Its gain in log-evidence is {gain} (needed: {needed})."


def process_noise_table(run: RunDirectory, loop: LoopJson) -> Markup | None:
    """Write parameters with process noise beside those without; None where it does not explain what is left."""
    if loop.process_noise is None or not loop.process_noise.explains:
        return None
    rows = []
    for name, found in loop.process_noise.parameters.items():
        now, without = parameter_quantity(found)[0], run.result.parameters.get(name)
        was = parameter_quantity(without)[0] if without is not None else None
        rows.append((
            Markup("{}<small>{}</small>").format(symbol(name), found.description),
            f"{was.value} {was.unit}".strip() if was is not None else NO_VALUE,
            f"{now.value} {now.unit}".strip(), f"{now.low} … {now.high} {now.unit}".strip(),
        ))  # fmt: skip
    columns = (
        "parameter", Column("without process noise", "right"), Column("with it", "right"),
        Column("90 % interval", "right"),
    )  # fmt: skip
    return html_table(columns, rows, "Parameters with process noise")


def _width(q: QuantilesJson) -> float:
    return (q.q95 or 0.0) - (q.q05 or 0.0)

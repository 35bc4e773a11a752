"""Table of what the sensors add to the physics: ripple locked to the rotor, and the counts of an encoder."""

from __future__ import annotations

from collections.abc import Iterator

from markupsafe import Markup

from aero_bayes.report.run_directory import RunDirectory, mapping, number
from aero_bayes.report.series_figures import unit_of
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import NOTHING, pretty_unit, significant, symbol, tidy

_TURN = {"1": "once a turn", "2": "twice a turn"}


def sensor_table(run: RunDirectory) -> Markup | None:
    """Ripple with its evidence and the noise with and without it, and the quantum of encoders; by output."""
    rows: list[tuple[object, ...]] = []
    for output in mapping(run.result, "sensors"):
        rows += _ripple(run, output)
        rows += _encoder(run, output)
    if not rows:
        return None
    columns = (
        "output", "what", Column("size", "right"), "unit", Column("log-evidence", "right"), "what it does to the noise",
    )  # fmt: skip
    return html_table(columns, rows, "What the sensors add (ripple: amplitude; encoder: one count)")


def _ripple(run: RunDirectory, output: str) -> Iterator[tuple[object, ...]]:
    entry = mapping(run.result, "sensors", output)
    left_in = "" if entry.get("ripple_subtracted") is True else ", left in"
    for recording, ripple in mapping(entry, "ripple").items():
        found = mapping(ripple)
        alone, together = (significant(number(found.get(k))) for k in ("noise_sd", "noise_sd_with_ripple"))
        for order, size in mapping(found, "orders").items():
            turn = f"ripple {_TURN.get(order, f'{order} times a turn')}{left_in}"
            yield (
                symbol(output), Markup("{}<small>{}</small>").format(turn, recording),
                significant(number(mapping(size).get("amplitude"))), pretty_unit(unit_of(run, output)),
                tidy(number(mapping(size).get("log_evidence")), 3), f"{together} with it, {alone} without",
            )  # fmt: skip


def _encoder(run: RunDirectory, output: str) -> Iterator[tuple[object, ...]]:
    found = mapping(run.result, "sensors", output, "encoder")
    step, share = number(found.get("step")), number(found.get("share"))
    if step is not None and share is not None:
        unit = pretty_unit(unit_of(run, output))
        yield (
            symbol(output), "encoder", significant(step), unit, NOTHING,
            f"rounding is {tidy(100.0 * share, 2)} % of the residual's variance",
        )  # fmt: skip

"""Table of sensor errors: ripple at multiples of the rotor's angle, and quantisation of encoders."""

from __future__ import annotations

from collections.abc import Iterator

from markupsafe import Markup

from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import NO_VALUE, pretty_unit, significant, symbol, tidy
from aero_bayes.schema import SensorJson

_TURN = {"1": "once a turn", "2": "twice a turn"}


def sensor_table(run: RunDirectory) -> Markup | None:
    """Write ripple with its evidence and the noise with and without it, and the quantum of encoders; by output."""
    rows: list[tuple[object, ...]] = []
    for output, found in run.result.sensors.items():
        unit = pretty_unit(run.result.unit(output))
        rows += _ripple(found, output, unit)
        if found.encoder is not None:
            words = f"rounding is {tidy(100.0 * found.encoder.share, 2)} % of the residual's variance"
            rows.append((symbol(output), "encoder", significant(found.encoder.step), unit, NO_VALUE, words))
    if not rows:
        return None
    columns = (
        "output", "what", Column("size", "right"), "unit", Column("log-evidence", "right"), "effect on the noise",
    )  # fmt: skip
    return html_table(columns, rows, "Sensor errors (ripple: amplitude; encoder: one count)")


def _ripple(found: SensorJson, output: str, unit: str) -> Iterator[tuple[object, ...]]:
    left_in = "" if found.ripple_subtracted else ", not subtracted"
    for recording, ripple in found.ripple.items():
        for order, size in ripple.orders.items():
            turn = f"ripple {_TURN.get(order, f'{order} times a turn')}{left_in}"
            sizes = f"{significant(ripple.noise_sd_with_ripple)} with ripple, {significant(ripple.noise_sd)} without"
            yield (
                symbol(output), Markup("{}<small>{}</small>").format(turn, recording), significant(size.amplitude),
                unit, tidy(size.log_evidence, 3), sizes,
            )  # fmt: skip

"""Table of sensor errors: quantisation of encoders."""

from __future__ import annotations

from markupsafe import Markup

from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.tables import Column, html_table
from aero_bayes.report.text import pretty_unit, significant, symbol, tidy


def sensor_table(run: RunDirectory) -> Markup | None:
    """Write the count of encoders, and what rounding to it adds to the residual; by output."""
    rows = [
        (symbol(output), significant(found.encoder.step), pretty_unit(run.result.unit(output)),
         f"rounding is {tidy(100.0 * found.encoder.share, 2)} % of the residual's variance")
        for output, found in run.result.sensors.items()
        if found.encoder is not None
    ]  # fmt: skip
    if not rows:
        return None
    return html_table(("output", Column("one count", "right"), "unit", "effect on the noise"), rows, "Encoders")

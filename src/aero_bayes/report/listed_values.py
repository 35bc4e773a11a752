"""Table of the listed values of parameters that were each fitted."""

from __future__ import annotations

from markupsafe import Markup

from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.tables import Column, bar, html_table
from aero_bayes.report.text import NO_VALUE, significant, symbol


def listed_values_table(run: RunDirectory) -> Markup | None:
    """List every combination of values with its probability, and how far its log-posterior is below the best."""
    trials = run.result.fit.values
    if not trials:
        return None
    names = list(trials[0].values)
    rows = []
    for trial in trials:
        share = trial.share or 0.0
        shown = NO_VALUE if trial.failed else f"{significant(100.0 * share)} %" if share >= 1e-3 else "< 0.1 %"
        values = [_shown(trial.values[name]) for name in names]
        worse = Markup("<small>{}</small>").format(trial.failed) if trial.failed else significant(trial.worse_by)
        rows.append((*values, shown, bar(share, f"probability {shown}"), worse))
    columns: tuple[Column | str, ...] = (
        *(Column(symbol(name)) for name in names), Column("probability", "right"), "",
        Column("log-posterior below the best", "right"),
    )  # fmt: skip
    return html_table(columns, rows, "Listed values, each fitted; the first are reported", [0])


def _shown(value: bool | float | str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return value if isinstance(value, str) else f"{value:.6g}"

"""The row of the search: parameters on bounds."""

from __future__ import annotations

from aero_bayes.display import join_names
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.identifiability import Status
from aero_bayes.estimate.result import Fit


def check_search(fit: Fit) -> DiagnosisRow:
    """Tell which parameters ended on a bound of their range."""
    bounds = [name for name, status in fit.identifiability.status.items() if status is Status.AT_BOUND]
    if fit.modes:
        where = f"also {len(bounds)} on a bound" if bounds else ""
        done = "A posterior has draws of each; bounds or a prior that exclude the others leave one answer."
        return DiagnosisRow("search", True, fit.modes_sentence, where, done)
    if not bounds:
        return DiagnosisRow("search", False, "Every parameter ended inside its range.")
    # A model that lacks an effect drives parameters to bounds, too, so that a bound alone explains no residual.
    return DiagnosisRow(
        "search", True, f"The best value of {join_names(bounds)} lies on a bound of the search range.",
        ", ".join(f"{name} = {fit.value(name):.4g}" for name in bounds), "Widen the bounds if they are not physical.",
    )  # fmt: skip

"""The row of the search: other optima, starts that disagree, parameters on bounds."""

from __future__ import annotations

from aero_bayes.diagnosis.left_over import LeftOver
from aero_bayes.display import join_names
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.identifiability import Status
from aero_bayes.estimate.levenberg_marquardt import Stop
from aero_bayes.estimate.result import Fit

#: Difference of two log-posteriors up to which two fits are at the same cost; fewest starts of which it tells anything.
SAME_LEVEL, MIN_STARTS = 3.0, 4


def check_search(fit: Fit, left: LeftOver) -> DiagnosisRow:
    """Tell which other optima there are, whether starts disagree, and which parameters ended on a bound."""
    bounds = [name for name, status in fit.identifiability.status.items() if status is Status.AT_BOUND]
    if fit.reason is Stop.INTERRUPTED:
        what = "The search was interrupted before it had converged, so that its residual says little of the model."
        return DiagnosisRow("search", True, what, "", "Fit again and let it end.", explains=True)
    if fit.modes:
        where = f"also {len(bounds)} on a bound" if bounds else ""
        done = "A posterior has draws of each; bounds or a prior that exclude the others leave one answer."
        return DiagnosisRow("search", True, fit.modes_sentence, where, done)
    agree = sum(max(fit.start_levels) - level < SAME_LEVEL for level in fit.start_levels) if fit.start_levels else 0
    count = len(fit.start_levels)
    # Where the residual is noise, the best end is the right one, however few starts lead there.
    if agree == 1 and count >= MIN_STARTS and left.structured:
        what = f"Local fits from {count} starts end at different costs, and only one of them at the best."
        done = "A larger swarm ([fit.pso] particles) or narrower bounds would show whether there is a better one."
        return DiagnosisRow("search", True, what, "", done)
    if not bounds:
        ends = f" {agree} of {count} starts of the local search ended at the best cost." if count > 1 else ""
        return DiagnosisRow("search", False, f"Every parameter ended inside its range.{ends}")
    # A model that lacks an effect drives parameters to bounds, too, so that a bound alone explains no residual.
    return DiagnosisRow(
        "search", True, f"The best value of {join_names(bounds)} lies on a bound of the search range.",
        ", ".join(f"{name} = {fit[name].value:.4g}" for name in bounds), "Widen the bounds if they are not physical.",
    )  # fmt: skip

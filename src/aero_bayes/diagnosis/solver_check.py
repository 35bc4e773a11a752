"""The row of the solver: runs that failed."""

from __future__ import annotations

from aero_bayes.diagnosis.failed_runs import MAX_NAMED, domain_texts, failing_run
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.interface import Outcome

#: Share of failed runs up to which they are the far corners of a search, which no answer depends on.
MAX_FAILED_SHARE = 0.2


def check_solver(fit: Fit) -> DiagnosisRow:
    """Tell how many simulations failed, by which message, where, and which equations may be the reason."""
    runs = sum(fit.outcomes.values())
    failed = {o: count for o, count in fit.outcomes.items() if o is not Outcome.OK and count}
    if not failed:
        return DiagnosisRow("solver", False, f"All {runs} runs were completed.")
    share, commonest = sum(failed.values()) / runs, max(failed, key=lambda o: failed[o])
    what = f"{sum(failed.values())} of {runs} runs failed, most of them since {commonest.text}."
    if share <= MAX_FAILED_SHARE:
        return DiagnosisRow("solver", False, what)
    domains = domain_texts(fit.calibration.model) if commonest in (Outcome.NOT_FINITE, Outcome.SOLVER_FAILED) else []
    done = ""
    if domains:
        what = f"{what} The equations have {'; '.join(domains[:MAX_NAMED]).rstrip(',')}."
        done = "Keep the argument in its domain, as by sqrt(max(x, 0)), so that these values can be compared too."
    return DiagnosisRow("solver", True, what, failing_run(fit), done, explains=True)

"""The row of the solver: runs that failed, and an answer that depends on the tolerance."""

from __future__ import annotations

import numpy as np

from aero_bayes.check.residual_tests import exact_level
from aero_bayes.diagnosis.failed_runs import MAX_NAMED, domain_texts, failing_run
from aero_bayes.diagnosis.left_over import LeftOver
from aero_bayes.display import join_names, with_unit
from aero_bayes.estimate.diagnosis import DiagnosisRow
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.interface import Outcome

#: Share of failed runs up to which they are the far corners of a search, which no answer depends on.
MAX_FAILED_SHARE = 0.2
#: RMS by which a ten times tighter tolerance moves an output, as a share of the RMS residual, up to which the solver's
#: error is hidden: a tenth adds half a percent to the residual, and is too small to bias a parameter by much.
MAX_SOLVER_SHARE = 0.1
#: Standard deviations by which the solver's error moves a parameter from which the answer is another one: a bias of
#: half of one makes a 90 % interval hold 86 %.
MAX_SHIFT = 0.5
#: Share of the structured part of a residual from which the solver's error may be all of it: the tighter run has an
#: error, too, and the fitted parameters take up some of it.
EXPLAINING_SHARE = 0.5


def check_solver(fit: Fit, left: LeftOver) -> DiagnosisRow:
    """Tell which share of simulations failed and why, or which output moves when the solver works more tightly."""
    runs = sum(fit.outcomes.values())
    failed = {o: count for o, count in fit.outcomes.items() if o is not Outcome.OK and count}
    what = f"All {runs} runs were completed."
    if failed:
        share, commonest = sum(failed.values()) / runs, max(failed, key=lambda o: failed[o])
        what = f"{sum(failed.values())} of {runs} runs failed, most of them since {commonest.text}."
        if share > MAX_FAILED_SHARE:
            return _failed_row(fit, what, commonest)
    moved = _moved_outputs(fit)
    if moved and _changes_the_answer(fit, moved, left):
        return _tolerance_row(fit, moved, left)
    if moved:
        shift = max(fit.solver_shift.values(), default=0.0)
        what = (
            f"{what} A ten times tighter tolerance moves {join_names(list(moved))} by more than a tenth of its "
            f"residual, but no parameter by more than {shift:.1g} of its standard deviation."
        )
    elif fit.solver_difference:
        what = f"{what} A ten times tighter tolerance moves no output by more than a tenth of its residual."
    return DiagnosisRow("solver", False, what)


def _failed_row(fit: Fit, what: str, commonest: Outcome) -> DiagnosisRow:
    """Tell where runs fail, and which equations may be the reason."""
    domains = domain_texts(fit.calibration.model) if commonest in (Outcome.NOT_FINITE, Outcome.SOLVER_FAILED) else []
    done = ""
    if domains:
        what = f"{what} The equations have {'; '.join(domains[:MAX_NAMED]).rstrip(',')}."
        done = "Keep the argument in its domain, as by sqrt(max(x, 0)), so that these values can be compared too."
    return DiagnosisRow("solver", True, what, failing_run(fit), done, explains=True)


def _moved_outputs(fit: Fit) -> dict[str, float]:
    """Compute the RMS by which outputs move at ten times tighter tolerances, where it is a share of what is left."""
    rms, solver = fit.rms, fit.calibration.simulated.solver
    level = {
        output: max((exact_level(solver, s) for s in fit.series if s.output == output), default=0.0) for output in rms
    }
    return {
        output: size
        for output, size in fit.solver_difference.items()
        if size > MAX_SOLVER_SHARE * max(rms[output], level[output])
    }


def _changes_the_answer(fit: Fit, moved: dict[str, float], left: LeftOver) -> bool:
    """Tell whether the solver's error moves a parameter by a clear share of its sd, or is what is left."""
    if max(fit.solver_shift.values(), default=0.0) > MAX_SHIFT:
        return True
    if any(size > EXPLAINING_SHARE * fit.rms[output] for output, size in moved.items()):
        return True
    return bool(left.structured) and _explains(fit, moved, left)


def _tolerance_row(fit: Fit, moved: dict[str, float], left: LeftOver) -> DiagnosisRow:
    """Tell which outputs move at a ten times tighter tolerance."""
    rms = fit.rms
    units = fit.calibration.model.units
    sizes = (f"{with_unit(f'{size:.2g}', units.get(output, ''))} rms" for output, size in moved.items())
    shares = (f"{size / rms[output]:.2g} times its residual" for output, size in moved.items())
    where = "; ".join(f"{o} moves by {size}, {share}" for o, size, share in zip(moved, sizes, shares, strict=True))
    furthest = max(fit.solver_shift, key=lambda name: fit.solver_shift[name], default="")
    if furthest:
        where = f"{where}; {furthest} by {fit.solver_shift[furthest]:.2g} of its standard deviation"
    tolerance = 0.1 * fit.calibration.simulated.solver.relative_tolerance
    return DiagnosisRow(
        "solver", True, "The answer is another one at a ten times tighter tolerance of the solver.", where,
        f"Tighten [solver] relative_tolerance and absolute_tolerance, as to {tolerance:.0e}, and fit again.",
        _explains(fit, moved, left),
    )  # fmt: skip


def _explains(fit: Fit, moved: dict[str, float], left: LeftOver) -> bool:
    """Return whether the solver's error is of the size of what the noise does not explain in each output that moves."""
    for output, size in moved.items():
        noise = [sd**2 for (_, name), sd in left.floors.items() if name == output]
        structured = max(fit.rms[output] ** 2 - (float(np.mean(noise)) if noise else 0.0), 0.0)
        if size**2 < EXPLAINING_SHARE**2 * structured:
            return False
    return True

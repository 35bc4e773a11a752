"""Diagnose a fit: one check a cause, in the order in which causes are blamed."""

from __future__ import annotations

from collections.abc import Callable

from aero_bayes.diagnosis.data_check import check_data
from aero_bayes.diagnosis.left_over import LeftOver
from aero_bayes.diagnosis.model_check import check_model
from aero_bayes.diagnosis.noise_check import check_noise
from aero_bayes.diagnosis.search_check import check_search
from aero_bayes.diagnosis.solver_check import check_solver
from aero_bayes.estimate.diagnosis import Diagnosis, DiagnosisRow
from aero_bayes.estimate.result import Fit

#: What fills one row of a diagnosis.
DiagnosisCheck = Callable[[Fit, LeftOver], DiagnosisRow]
#: One check for each of :data:`aero_bayes.estimate.diagnosis.CAUSES`, in their order.
CHECKS: tuple[DiagnosisCheck, ...] = (check_data, check_solver, check_search, check_noise, check_model)


def diagnose(fit: Fit) -> Diagnosis:
    """Look at each cause of a residual that is not noise."""
    left = LeftOver(fit)
    return Diagnosis(tuple(check(fit, left) for check in CHECKS))

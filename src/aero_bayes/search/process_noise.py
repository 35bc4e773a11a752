"""Process noise beside a structure: the random force that explains what its terms leave.

A random force explains whatever a missing law would. So it is tried last, beside the structure that was chosen, and
does not compete with laws. Fits with process noise are compared with each other, and with the structure without any, on
the same readings. A fit explains the residual only if its innovations are white.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from aero_bayes.check.residual_tests import ResidualReport, check_residuals, structured_residuals
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.local_fit import LocalFitSettings
from aero_bayes.search.edits import Edit, EditContext
from aero_bayes.search.explored import SearchControl, SearchResult
from aero_bayes.search.models import CandidateModel, FitNoise, FittedModel, ModelCache
from aero_bayes.search.score import common_noise
from aero_bayes.search.structure import Structure

#: Readings of an output in a recording that are filtered: a filter stops at each of them.
MAX_READINGS = 2000
#: Largest number of states with process noise.
MAX_STATES = 2


@dataclass(frozen=True, eq=False)
class ProcessNoiseFit:
    """A structure fitted with process noise.

    Parameters
    ----------
    fitted : FittedModel
    gain : float
        Log-evidence gained over the structure without process noise, both tempered by what that one leaves.
    needed : float
        Least gain that counts.
    reports : tuple of ResidualReport
        Of the innovations.
    """

    fitted: FittedModel
    gain: float
    needed: float
    reports: tuple[ResidualReport, ...]

    @property
    def states(self) -> tuple[str, ...]:
        return self.fitted.structure.process_noise

    @property
    def explains(self) -> bool:
        """Whether only white innovations are left."""
        return not structured_residuals(self.reports)

    @property
    def score(self) -> float:
        return self.gain - self.needed


def fit_process_noise(
    cache: ModelCache,
    chosen: FittedModel,
    explored: SearchResult,
    states: Sequence[str],
    edits: Sequence[Edit],
    settings: LocalFitSettings,
    control: SearchControl,
) -> tuple[ProcessNoiseFit, ...]:
    """Fit a structure with process noise of its states, one state first, then the best with another; best first.

    Parameters
    ----------
    cache : ModelCache
        Of few enough readings for a filter. The fits live on its models.
    chosen : FittedModel
    explored : SearchResult
    states : sequence of str
        Those that process noise may drive.
    edits : sequence of Edit
    settings : LocalFitSettings
    control : SearchControl

    Raises
    ------
    CannotFinishError
        If the model cannot be simulated.
    """
    model = cache.of(chosen.structure)
    start = model.at(chosen.values, chosen.terms)
    base = model.fit(chosen.structure, start, explored.noise.noise, settings)
    noise = common_noise(base, explored.floors)
    if noise.adequate:
        return ()
    base = base.with_noise(noise.noise)
    price = math.log(max(len(states), 1)) + explored.penalty.margin
    found: list[ProcessNoiseFit] = []
    here = base
    for _ in range(MAX_STATES):
        context = EditContext(here, False, (), {}, (), (), (), (), False, True, True, tuple(states))
        wanted = [s for edit in edits for s in edit.neighbours(context)]
        tasks = [partial(_fit, cache.of(s), s, here, noise.noise, settings) for s in wanted]
        control.precompute(tasks, lambda done: control.report("process noise", done))
        for task in tasks:
            if control.time_is_up():
                break
            if (fitted := task()) is not None:
                found.append(_judged(fitted, base, price, explored))
        found.sort(key=lambda f: (-f.score, f.states))
        if not found or found[0].explains or found[0].fitted is here:
            break
        here = found[0].fitted
    return tuple(found)


def _fit(
    model: CandidateModel, structure: Structure, near: FittedModel, noise: FitNoise, settings: LocalFitSettings
) -> FittedModel | None:
    """The fit of a structure from the values of another; None where it cannot be simulated."""
    try:
        return model.fit(structure, model.at(near.values, structure.terms), noise, settings)
    except CannotFinishError:
        return None


def _judged(fitted: FittedModel, base: FittedModel, price: float, explored: SearchResult) -> ProcessNoiseFit:
    objective = fitted.model.objective
    reports = check_residuals(objective.calibration, objective.series, fitted.optimum, explored.floors)
    needed = price * len(fitted.structure.process_noise)
    return ProcessNoiseFit(fitted, fitted.log_evidence - base.log_evidence, needed, reports)

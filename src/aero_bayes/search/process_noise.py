"""Process noise beside a structure: the random force that explains what its terms leave.

A random force explains whatever a missing law would. So it is tried last, beside the structure that was chosen, and
does not compete with laws. Fits with process noise are compared with each other, and with the structure without any, on
the same readings. A fit explains the residual only if its innovations are white.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

from aero_bayes.check.residual_tests import ResidualReport, check_residuals, structured_residuals
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, local_fit
from aero_bayes.parallel import Task
from aero_bayes.search.common_noise import common_noise
from aero_bayes.search.edits import Edit, EditContext
from aero_bayes.search.explored import SearchControl
from aero_bayes.search.models import CandidateModel, FittedModel
from aero_bayes.search.refit import refit_from_here
from aero_bayes.search.structure import Structure
from aero_bayes.simulation.interface import DiffusionTarget, ReadingNoiseTarget

#: Readings of an output in a recording that are filtered: a filter stops at each of them.
MAX_FILTER_READINGS = 2000
#: Changes of an input in a recording up to twice which all are filtered: it stops at each of these too, and then every
#: second of them may have a reading. Filters of so many, with derivatives, take a few tenths of a second.
MAX_FILTERED_CHANGES = 2 * MAX_FILTER_READINGS
#: Log-likelihood, each reading counted as a share of an independent one, by which a state's process noise may be behind
#: the best after a fit of the noise alone.
MAX_BEHIND = 25.0
#: Log-evidence that the process noise of each state has to gain beyond the logarithm of the number of states.
MARGIN = 4.0
#: Difference in log-evidence within which the data do not tell two models apart: a hundred to one.
EQUIVALENT = 4.6


@dataclass(frozen=True, eq=False)
class ProcessNoiseFit:
    """A structure fitted with process noise."""

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
    model_of: Callable[[Structure], CandidateModel],
    values: Mapping[str, float],
    floors: Mapping[tuple[str, str], float],
    states: Sequence[str],
    edits: Sequence[Edit],
    control: SearchControl,
) -> tuple[ProcessNoiseFit, ...]:
    """Fit a model with the process noise that edits offer; best first.

    First only the noise is fitted. All parameters are fitted where that comes close to the best."""
    fit = LocalFitSettings(hold_noise=True)
    base = _base_fit(model_of(Structure()), values, floors, fit)
    context = EditContext(
        fitted=base, adequate=False, offered=(), refines={}, curves=(), rivals=(), free_later=(), directions=(),
        interpolation_is_free=False, best=True, states=tuple(states),
    )  # fmt: skip
    wanted = [s for edit in edits for s in edit.neighbours(context)]
    built = [(model_of(s), s) for s in wanted]
    works = [partial(_noise_fit, model, s, base.values, fit) for model, s in built]
    sized = _fits(built, works, base.temperature, control, 0.0)
    least = max((f.optimum.log_likelihood for f in sized), default=0.0) - MAX_BEHIND * base.temperature
    near = [f for f in sized if f.optimum.log_likelihood >= least]
    again = [partial(refit_from_here, f, base.noise, fit) for f in near]
    fitted = _fits([(f.model, f.structure) for f in near], again, base.temperature, control, 0.5)
    price = math.log(max(len(states), 1)) + MARGIN
    found = [_judged(f, base, price, floors) for f in fitted]
    return tuple(sorted(found, key=lambda f: (-f.score, f.states)))


def _base_fit(
    model: CandidateModel, values: Mapping[str, float], floors: Mapping[tuple[str, str], float], fit: LocalFitSettings
) -> FittedModel:
    """Return the fit without process noise, under the noise of what it leaves."""
    at = model.coordinates_of(values, ())
    squares = replace(fit, hold_noise=False).least_squares(model.objective.outputs)
    found = FittedModel(model, Structure(), local_fit(model.objective, at, model.free_base_columns, settings=squares))
    return found.with_noise(common_noise(found, floors).noise)


def _fits(
    built: Sequence[tuple[CandidateModel, Structure]],
    works: Sequence[Callable[[], Optimum | None]],
    temperature: float,
    control: SearchControl,
    done: float,
) -> list[FittedModel]:
    """Fits that can be simulated, until the time is up; ``done`` is the share of the work before them."""
    tasks = [Task(work, model.objective.outcomes) for (model, _), work in zip(built, works, strict=True)]
    ends = control.map(tasks, lambda share: control.report("process noise", done + 0.5 * share))
    return [
        FittedModel(model, structure, end, temperature)
        for (model, structure), end in zip(built, ends, strict=True)
        if end is not None
    ]


def _noise_fit(
    model: CandidateModel, structure: Structure, values: Mapping[str, float], settings: LocalFitSettings
) -> Optimum | None:
    """Fit a structure's process noise and reading noise, all else held at SI values of another fit."""
    parameters = model.objective.parameters
    columns = [j for j, p in enumerate(parameters) if isinstance(p.target, DiffusionTarget | ReadingNoiseTarget)]
    with suppress(CannotFinishError):
        return local_fit(model.objective, model.coordinates_of(values, structure.terms), columns, settings=settings)
    return None


def _judged(
    fitted: FittedModel, base: FittedModel, price: float, floors: Mapping[tuple[str, str], float]
) -> ProcessNoiseFit:
    objective = fitted.model.objective
    reports = check_residuals(objective.calibration, objective.series, fitted.optimum, floors)
    needed = price * len(fitted.structure.process_noise)
    return ProcessNoiseFit(fitted, fitted.log_evidence - base.log_evidence, needed, reports)

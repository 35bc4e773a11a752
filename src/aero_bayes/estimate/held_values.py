"""Values that are held, and the free parameters that the data show only together with one of them.

A rotor's and a stator's moments of inertia enter as their sum: with one held, the other takes up all that is wrong with
it, and nothing in the fit shows so. The columns of sensitivity of both are parallel."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.display import join_names, with_unit
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Parameter, ParameterSet, parameters_from_model
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.interface import NORMAL_HALF_WIDTH, ParameterTarget

#: Most held values that are looked at, those first that the user or the package holds.
MOST_HELD = 40
#: Relative error of a held value that must not go unnoticed.
ERROR = 0.1
#: Largest share of a held value's effect that the free parameters leave, where they can do the same.
MAX_LEFT = 0.03
#: Most held values that a sentence names.
MAX_NAMED = 3


def with_held_beside(fit: Fit, open_simulator: OpenSimulator) -> Fit:
    """Return the fit with a sentence on each parameter that the data show only together with a held value."""
    if not fit.free or fit.calibration.process is not None or not (held := _held(fit.calibration)):
        return fit
    found: dict[str, list[Parameter]] = {}
    with suppress(CannotFinishError, InputError):
        for name, one in _standing_for(fit, held, open_simulator):
            found.setdefault(name, []).append(one)
    notes = {name: _note(fit.calibration, own) for name, own in found.items()}
    return replace(fit, identifiability=fit.identifiability.beside_held(notes)) if notes else fit


def held_parameters(calibration: Calibration, declared: Iterable[str] = ()) -> Iterator[Parameter]:
    """Yield parameters of the model that are held at a value that is not zero: those first that the user gave one,
    then ``declared`` ones."""
    model, fixed = calibration.model, calibration.fixed
    searched = {p.target.name for p in calibration.parameters if isinstance(p.target, ParameterTarget)}
    starts = {v.name: v.start for v in model.parameters}
    for name in dict.fromkeys([*fixed, *declared, *starts]):
        value = fixed.get(name, starts.get(name))
        if value and name not in searched:
            with suppress(InputError):
                yield replace(parameters_from_model(model, [name]).items[0], start=value)


def _held(calibration: Calibration) -> list[Parameter]:
    """Return held parameters between zero and twice their values."""
    held = islice(held_parameters(calibration, calibration.model.declared.fixed), MOST_HELD)
    bounds = ((p, sorted((0.0, 2.0 * p.start))) for p in held)
    return [replace(p, lower=low, upper=high, scale="linear") for p, (low, high) in bounds]


def _standing_for(fit: Fit, held: list[Parameter], open_simulator: OpenSimulator) -> list[tuple[str, Parameter]]:
    """Pair free parameters with held ones whose error they alone would take up, beyond what their intervals allow.

    Alone, or each by as much in the same unit: a value that is added in several places."""
    if (known := slopes_beside(fit, held, open_simulator)) is None:
        return []
    slopes = known[1]
    free, found = list(fit.free), []
    items = [fit.calibration.parameters.items[j] for j in free]
    sd = fit.laplace.sd[: len(free)] * fit.calibration.parameters.jacobian(fit.values)[free]
    own = slopes[: len(free)]
    norm = np.linalg.norm(own, axis=1)
    seen = norm > 0.0
    for one, column in zip(held, slopes[len(free) :], strict=True):
        size = float(np.linalg.norm(column))
        if size * ERROR * abs(one.start) < NORMAL_HALF_WIDTH:
            continue  # the data do not show it either way
        share = np.zeros(len(free))
        share[seen] = np.linalg.lstsq((own[seen] / norm[seen, None]).T, column, rcond=1e-8)[0] / norm[seen]
        if float(np.linalg.norm(column - share @ own)) > MAX_LEFT * size:
            continue
        moved = np.abs(share) * ERROR * abs(one.start) > NORMAL_HALF_WIDTH * sd
        added = moved & np.isclose(np.abs(share), 1.0, rtol=0.02) & np.array([p.unit == one.unit for p in items])
        if moved.sum() == 1 or (moved.any() and np.array_equal(added, moved)):
            found += [(p.name, one) for p, so in zip(items, moved, strict=True) if so and p.recording is None]
    return found


def searched_too(calibration: Calibration, added: Sequence[Parameter]) -> Calibration:
    """Return the calibration with more parameters that are searched, which are then no longer held."""
    names = {p.name for p in added}
    fixed = {name: value for name, value in calibration.fixed.items() if name not in names}
    return replace(calibration, parameters=ParameterSet((*calibration.parameters, *added)), fixed=fixed)


def slopes_beside(
    fit: Fit, added: Sequence[Parameter], open_simulator: OpenSimulator
) -> tuple[FloatArray, FloatArray] | None:
    """Return the whitened residual of a fit, and the whitened changes of its outputs by the free parameters and then by
    added ones at their start, in SI units of each; None where the model cannot be simulated so."""
    whole, count = searched_too(fit.calibration, added), len(fit.calibration.parameters)
    values = np.concatenate([fit.values, [p.start for p in added]])
    columns = [*fit.free, *range(count, count + len(added))]
    with open_simulator(whole.problem()) as simulator:
        objective = Objective(whole, simulator)
        run = objective.evaluate(whole.parameters.to_search(values), columns)
        if run is None:
            return None
        white = objective.whiten(run, fit.noise)
    return white.residual, white.slopes / whole.parameters.jacobian(values)[columns, None]


def _note(calibration: Calibration, held: list[Parameter]) -> str:
    """Say with which held values a parameter is known."""
    texts = [f"{p.name} held at {with_unit(f'{p.start:.4g}', p.unit)}" for p in held[:MAX_NAMED]]
    more = [f"{len(held) - MAX_NAMED} more"] if len(held) > MAX_NAMED else []
    value = "that value" if len(held) == 1 else "these values"
    return (
        f"with {join_names([*texts, *more])} only: the data show what they make together, the interval is for {value}"
    )

"""What a simulation leaves open: the error of its solver, and the width over which its equations round a corner."""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.diagnosis import MAX_SHIFT
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.noise_estimation import whiten
from aero_bayes.estimate.objective import objective_of
from aero_bayes.estimate.result import Fit
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.syntax import Call, Number
from aero_bayes.simulation.interface import Outcome, ParameterTarget
from aero_bayes.simulation.load_model import session_folder
from aero_bayes.simulation.model import Model

#: The tolerances of the second run, as a share of the problem's own.
TIGHTER = 0.1
#: Times that a fit is done again at tighter tolerances: from 1e-6 to 1e-8, below which few simulations differ.
MOST_TIGHTENED = 2
#: The widths of roundings in the second run. What a rounding changes is proportional to its width, or to a higher power
#: of it, so that a third as much is left at a quarter of it at most.
SHARPER = 0.25
#: By how much parameters move without a rounding, over by how much they do at ``SHARPER`` times its width.
LEFT_OPEN = 1.0 / (1.0 - SHARPER)
#: Steps of Gauss and Newton to the optimum with narrower roundings.
NEWTON_STEPS = 3


def is_rounding(name: str) -> bool:
    """Return whether a constant is, by its name, a width over which a corner of a law is rounded.

    Such are ``v_smooth`` and ``knee``, and the ``T_min`` below which a delay is not taken as small as it is."""
    own = name.rpartition(".")[2]
    return own.endswith("_smooth") or own in ("knee", "T_min")


def sharpened(flat: FlatModel, taken: Collection[str] = ()) -> FlatModel | None:
    """Return a flat model with narrower roundings; None where it has none but those that are ``taken``."""
    found = {v.name: v.binding for v in flat.variables if v.constant and is_rounding(v.name) and v.name not in taken}
    widths = {name: binding for name, binding in found.items() if binding is not None}
    if not widths:
        return None
    variables = tuple(
        replace(v, binding=Call("*", (Number(SHARPER), widths[v.name]))) if v.name in widths else v
        for v in flat.variables
    )
    return replace(flat, variables=variables)


def sharper_model(model: Model) -> Model | None:
    """Return a model with narrower roundings where these are constants of its source; None where there are none."""
    if model.source is None or model.interface != "model exchange":
        return None
    with suppress(InputError):
        flat = load_flat(model.source.name, model.source.files, model.source.libraries)
        if (narrow := sharpened(flat, [v.name for v in model.parameters])) is not None:
            return Model.load(export_flat(narrow, session_folder() / "sharper.fmu"))
    return None


def with_simulation_error(fit: Fit, open_simulator: OpenSimulator, sharper: Model | None = None) -> Fit:
    """Simulate the optimum with tighter tolerances, step to that with narrower roundings, and compare the parameters.

    Intervals are wider by as much as the parameters move: a simulation is no surer than that. The step counts as a
    standard deviation and is added in quadrature: an interval that is off by ``b`` standard deviations and wider by
    the root of ``1 + b^2`` holds the truth in 90 % at least, whatever ``b`` is. ``sharper`` is the model with
    narrower roundings, where these are constants."""
    calibration = fit.calibration
    if calibration.process is not None:
        return fit
    exact = _tighter(calibration)
    moved = _moved_outputs(fit, exact, open_simulator)
    sizes = {}
    for k, output in enumerate(calibration.data.outputs):
        rows = np.concatenate([y[:, k] for y in moved])
        if np.isfinite(rows).any():
            sizes[output] = float(np.sqrt(np.nanmean(rows**2)))
    if not sizes:
        return replace(fit, solver_difference={}, solver_shift={}, rounding_shift={})
    steps = [_moved_parameters(fit, moved)]
    if (narrow := _narrower(exact, sharper)) is not None:
        steps.append(LEFT_OPEN * (_refitted_step(fit, narrow, open_simulator) - steps[0]))
    count, covariance = len(steps[0]), fit.laplace.covariance.copy()
    sd = np.maximum(fit.laplace.sd[:count], 1e-300)
    shifts = [dict(zip(fit.laplace.names, np.abs(step / sd).tolist(), strict=False)) for step in steps]
    covariance[:count, :count] += sum(np.outer(step, step) for step in steps)
    wider = replace(fit.laplace, covariance=covariance)
    rounding = shifts[1] if len(shifts) > 1 else {}
    return replace(fit, solver_difference=sizes, solver_shift=shifts[0], rounding_shift=rounding, laplace=wider)


def exact_enough(
    fit: Fit, fitted_again: Callable[[Calibration, Fit], Fit], open_simulator: OpenSimulator, sharper: Model | None
) -> Fit:
    """Return :func:`with_simulation_error`, fitted at tighter tolerances as long as these move a parameter."""
    for _ in range(MOST_TIGHTENED):
        found = with_simulation_error(fit, open_simulator, sharper)
        if max(found.solver_shift.values(), default=0.0) <= MAX_SHIFT:
            return found
        try:
            fit = fitted_again(_tighter(fit.calibration), fit)
        except CannotFinishError:
            return found
    return with_simulation_error(fit, open_simulator, sharper)


def _tighter(calibration: Calibration) -> Calibration:
    """Return the calibration at tighter tolerances."""
    solver = calibration.solver
    relative, absolute = TIGHTER * solver.relative_tolerance, TIGHTER * solver.absolute_tolerance
    return replace(calibration, solver=replace(solver, relative_tolerance=relative, absolute_tolerance=absolute))


def _narrower(calibration: Calibration, sharper: Model | None) -> Calibration | None:
    """Return the calibration with narrower roundings; None where the model has none."""
    model, fixed = calibration.model, dict(calibration.fixed)
    searched = {p.target.name for p in calibration.parameters if isinstance(p.target, ParameterTarget)}
    widths = {v.name: fixed.get(v.name, v.start) for v in model.parameters if is_rounding(v.name)}
    own = {name: SHARPER * w for name, w in widths.items() if isinstance(w, float) and name not in searched}
    if sharper is None and not own:
        return None
    return replace(calibration, model=sharper or model, fixed=fixed | own)


def _moved_outputs(fit: Fit, other: Calibration, open_simulator: OpenSimulator) -> list[FloatArray]:
    """Return by how much the outputs (n, m) of each recording differ in another calibration; NaN where a run fails."""
    moved = [np.full_like(y, np.nan) for y in fit.fitted]
    with suppress(CannotFinishError, InputError), open_simulator(other.problem()) as simulator:
        runs = simulator.simulate(fit.values[np.newaxis])
        for e, (found, fitted) in enumerate(zip(runs.outputs, fit.fitted, strict=True)):
            if runs.outcomes[0, e] == Outcome.OK:
                moved[e] = found[0] - fitted
    return moved


def _refitted_step(fit: Fit, narrow: Calibration, open_simulator: OpenSimulator) -> FloatArray:
    """Return by how much each free parameter moves, in search coordinates, to the optimum of another calibration.

    A first step is far off where a parameter moves by a tenth, so that a few follow, as long as they lead upwards."""
    best = -np.inf
    free, point = list(fit.free), fit.optimum.coordinates.copy()
    parameters = fit.calibration.parameters
    low, high = parameters.box
    # where a search ended early, its own slope is no rounding's
    slope = fit.optimum.whitened.score + parameters.prior_derivatives(point)[0][free]
    with suppress(CannotFinishError, InputError), open_simulator(narrow.problem()) as simulator:
        objective = objective_of(narrow, simulator)
        for _ in range(NEWTON_STEPS if free else 0):
            if (found := objective.evaluate(point, free)) is None:
                break
            white = objective.whiten(found, fit.optimum.noise)
            if white.log_likelihood < best:
                break
            best = white.log_likelihood
            first, second = parameters.prior_derivatives(point)
            information = white.information + parameters.prior_curvature(second, free)
            point[free] += np.linalg.lstsq(information, white.score + first[free] - slope, rcond=1e-12)[0]
            point = np.clip(point, low, high)
    return np.asarray(point[free] - fit.optimum.coordinates[free])


def _moved_parameters(fit: Fit, moved: list[FloatArray]) -> FloatArray:
    """Return by how much each free parameter moves, in search coordinates, where the outputs do by ``moved`` (n, m).

    To first order: one step of Gauss and Newton from the optimum."""
    rows = [np.nan_to_num(moved[s.experiment][s.sampling.index, s.column])[np.newaxis] for s in fit.series]
    noise = fit.optimum.noise
    white = [whiten(y, s.sampling, noise[s.output])[0][0] for y, s in zip(rows, fit.series, strict=True)]
    covariance = fit.optimum.laplace(fit.calibration.parameters)[0]
    return np.asarray(covariance @ (fit.optimum.whitened.slopes @ np.concatenate(white)))

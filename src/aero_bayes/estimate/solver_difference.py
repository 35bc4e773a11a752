"""How far the fitted answer moves when the solver works more tightly: the error of the integration."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.progressive_horizon import OpenSimulator
from aero_bayes.estimate.result import Fit
from aero_bayes.sensors.whitening import whiten
from aero_bayes.simulation.interface import Outcome

#: The tolerances of the second run, as a share of the problem's own.
TIGHTER = 0.1


def with_solver_difference(fit: Fit, open_simulator: OpenSimulator) -> Fit:
    """Simulate the optimum at a tenth of the problem's tolerances, and compare outputs and parameters with the fit."""
    calibration = fit.calibration
    if calibration.simulated.process is not None:
        return fit
    usual = calibration.simulated.solver
    relative, absolute = TIGHTER * usual.relative_tolerance, TIGHTER * usual.absolute_tolerance
    solver = replace(usual, relative_tolerance=relative, absolute_tolerance=absolute)
    exact = replace(calibration, simulated=replace(calibration.simulated, solver=solver))
    moved = [np.zeros_like(y) for y in fit.fitted]
    with suppress(CannotFinishError), open_simulator(exact.problem()) as simulator:
        runs = simulator.simulate(fit.values[np.newaxis])
        for e, (tight, fitted) in enumerate(zip(runs.outputs, fit.fitted, strict=True)):
            moved[e] = tight[0] - fitted if runs.outcomes[0, e] == Outcome.OK else np.full_like(fitted, np.nan)
    sizes = {}
    for k, output in enumerate(calibration.data.outputs):
        rows = np.concatenate([y[:, k] for y in moved])
        if np.isfinite(rows).any():
            sizes[output] = float(np.sqrt(np.nanmean(rows**2)))
    return replace(fit, solver_difference=sizes, solver_shift=_shift(fit, moved) if sizes else {})


def _shift(fit: Fit, moved: list[FloatArray]) -> dict[str, float]:
    """Return by how many of its standard deviations each free parameter moves where the outputs do by ``moved`` (n, m).

    To first order: one step of Gauss and Newton from the optimum."""
    white = np.concatenate(
        [
            whiten(
                np.nan_to_num(moved[s.experiment][s.sampling.index, s.column])[np.newaxis],
                s.sampling,
                fit.optimum.noise[s.output],
            )[0][0]
            for s in fit.series
        ]
    )
    covariance = fit.optimum.laplace(fit.calibration.parameters)[0]
    step = covariance @ (fit.optimum.whitened.slopes @ white)
    sd = fit.laplace.sd[: len(step)]
    names = fit.laplace.names[: len(step)]
    return {name: abs(float(s)) for name, s in zip(names, step / np.maximum(sd, 1e-300), strict=True)}

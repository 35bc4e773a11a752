"""How far the fitted answer moves when the solver works more tightly: the error of the integration."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.progressive_horizon import OpenSimulator
from aero_bayes.simulation.interface import Outcome

FloatArray = NDArray[np.float64]

#: The tolerances of the second run, as a share of the problem's own.
TIGHTER = 0.1


def solver_difference(
    calibration: Calibration, values: FloatArray, fitted: Sequence[FloatArray], open_simulator: OpenSimulator
) -> dict[str, float]:
    """Simulate the optimum at a tenth of the problem's tolerances and compare it with what was fitted.

    Parameters
    ----------
    calibration : Calibration
    values : ndarray, shape (p,)
        SI values of all its parameters.
    fitted : sequence of ndarray, shape (n, m)
        Outputs at these values of each experiment, at the problem's own tolerances.
    open_simulator : callable
        Opens a simulator for a problem.

    Returns
    -------
    dict of str to float
        RMS difference by output at the samples, in its unit. Empty with process noise, whose filter corrects the
        states at each reading, and where the second run fails in every recording.
    """
    if calibration.process is not None:
        return {}
    own = calibration.solver
    solver = replace(
        own,
        relative_tolerance=TIGHTER * own.relative_tolerance,
        absolute_tolerance=TIGHTER * own.absolute_tolerance,
    )
    squares: dict[str, list[FloatArray]] = {output: [] for output in calibration.outputs}
    with suppress(CannotFinishError), open_simulator(replace(calibration, solver=solver).problem()) as simulator:
        runs = simulator.simulate(values[np.newaxis])
        for e, (tight, usual) in enumerate(zip(runs.outputs, fitted, strict=True)):
            if runs.outcomes[0, e] == Outcome.OK:
                for k, output in enumerate(calibration.outputs):
                    squares[output].append((tight[0][:, k] - usual[:, k]) ** 2)
    joined = {output: np.concatenate([*parts, np.zeros(0)]) for output, parts in squares.items()}
    finite = {output: rows[np.isfinite(rows)] for output, rows in joined.items()}
    return {output: float(np.sqrt(np.mean(rows))) for output, rows in finite.items() if rows.size}

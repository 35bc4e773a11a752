"""What the paper's experiment can tell about each parameter, from exact sensitivities and the noise floor.

Columns are sensitivities to the logarithm of a parameter (the delay: to itself in s), in units of each output's noise.
The inverse of the information they hold is the Cramer-Rao bound: no method gets below it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.identifiability import assess
from aero_bayes.simulation.interface import (
    DelayTarget,
    Experiment,
    Outcome,
    ParameterTarget,
    Problem,
    ProblemTarget,
    SolverSettings,
)
from aero_bayes.simulation.model import Model

FloatArray = NDArray[np.float64]

COLUMNS = ("R_a", "L_a", "c_m", "J_r", "J_s", "k_d", "k_t", "D_p", "K_sp")
DELAY = "input_delay"
#: Prior standard deviation on the log axis against which "visible" is judged: a factor of two.
PRIOR_SD = float(np.log(2.0))


@dataclass(frozen=True, eq=False)
class Visibility:
    """Sensitivities of a recording at one point.

    Parameters
    ----------
    names : tuple of str
        Columns; the last is the input's delay.
    values : mapping of str to float
        Where they were taken, SI units.
    columns : ndarray, shape (samples * outputs, p)
        Noise units per unit logarithm (per second for the delay).
    outputs : tuple of str
    rate_hz : float
    combinations : tuple of str
        What is seen only as one number.
    """

    names: tuple[str, ...]
    values: Mapping[str, float]
    columns: FloatArray
    outputs: tuple[str, ...]
    rate_hz: float
    combinations: tuple[str, ...]

    def norm(self, name: str) -> float:
        """Return the linearised change of the readings, in noise units, where a parameter doubles (delay: plus 1 s)."""
        return float(np.linalg.norm(self.columns[:, self.names.index(name)]))

    def relative_sd(
        self, name: str, unknown: Sequence[str] | None = None, outputs: Sequence[str] | None = None
    ) -> float:
        """Compute the smallest relative standard deviation of a parameter while ``unknown`` others are not known.

        By default all others but ``J_s`` and ``L_a`` are unknown. ``outputs`` restricts the readings.
        """
        others = unknown if unknown is not None else [n for n in self.names if n not in ("J_s", "L_a")]
        kept = np.array([self.outputs.index(output) for output in outputs or self.outputs])
        rows = np.isin(np.arange(len(self.columns)) % len(self.outputs), kept)
        own = self.columns[rows, self.names.index(name)]
        rest = self.columns[rows][:, [self.names.index(other) for other in others if other != name]]
        length = np.linalg.norm(rest, axis=0)
        scaled = rest[:, length > 0.0] / length[length > 0.0]
        u, s, _ = np.linalg.svd(scaled, full_matrices=False)
        basis = u[:, s > 1e-9 * s.max()] if s.size else u[:, :0]
        left = float(np.linalg.norm(own - basis @ (basis.T @ own)))
        return np.inf if left <= 1e-9 * float(np.linalg.norm(own)) else 1.0 / left

    def alike(self, first: str, second: str) -> float:
        """Return the largest difference of the two columns' directions: 0 where they are one and the same."""
        a, b = (self.columns[:, self.names.index(n)] for n in (first, second))
        return float(np.linalg.norm(a / np.linalg.norm(a) - b / np.linalg.norm(b)))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "at": dict(self.values),
            "norm": {name: self.norm(name) for name in self.names},
            "relative_sd": {name: _finite(self.relative_sd(name)) for name in self.names if name != DELAY},
            "relative_sd_from_pitch": {
                name: _finite(self.relative_sd(name, outputs=("theta",))) for name in self.names if name != DELAY
            },
            "J_r_against_J_s": self.alike("J_r", "J_s"),
            "combinations": list(self.combinations),
        }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def sensitivity_problem(model: Model, experiment: Experiment) -> Problem:
    """Pose the problem with one column for each of :data:`COLUMNS`, and one for the input's delay."""
    targets: tuple[ProblemTarget, ...] = (*(ParameterTarget(name) for name in COLUMNS), DelayTarget())
    return Problem(model, (experiment,), (targets,), settings=SolverSettings(relative_tolerance=1e-8))


def judge_visibility(
    problem: Problem, outputs: FloatArray, sensitivities: FloatArray, values: FloatArray, noise: FloatArray
) -> Visibility:
    """Compute what one simulation of :func:`sensitivity_problem` tells about each parameter.

    Parameters
    ----------
    problem : Problem
    outputs, sensitivities : ndarray, shapes (n, m) and (n, m, p)
    values : ndarray, shape (p,)
    noise : ndarray, shape (m,)
        Standard deviation of each output.

    Raises
    ------
    CannotFinishError
        If the simulation had failed.
    """
    if not (np.isfinite(outputs).all() and np.isfinite(sensitivities).all()):
        raise CannotFinishError(f"the replay's model cannot be simulated: {Outcome.NOT_FINITE.text}")
    experiment = problem.experiments[0]
    names = (*COLUMNS, DELAY)
    unit = np.where(np.array([n == DELAY for n in names]), 1.0, values)
    columns = (sensitivities / noise[None, :, None] * unit).reshape(-1, len(names))
    logarithmic = [n != DELAY for n in names]
    prior = np.where(logarithmic, PRIOR_SD, 0.01)
    judged = assess(names, values, logarithmic, columns.T @ columns, prior)
    return Visibility(
        names,
        dict(zip(names, values.tolist(), strict=True)),
        columns,
        experiment.outputs,
        float(1.0 / np.median(np.diff(experiment.time))),
        tuple(c.text for c in judged.combinations),
    )

"""The paper's constrained search, rerun: unscaled axes and coarse finite differences; and the same stages done right.

RaPId's template hands ``fmincon`` a ``FinDiffRelStep`` of 0.1, and MATLAB takes that relative to ``max(|x|, 1)``: for
every parameter of Table 1 but R_a the step is 0.1 in the parameter's own unit, four orders of magnitude above the
inertias. The paper does not say which of ``fmincon``'s algorithms ran, so two of their kind are rerun here, both from
SciPy: a quasi-Newton method that starts from a unit Hessian with a line search along bounds (L-BFGS-B, the kind of
``sqp`` and ``active-set``), and an interior-point method (``trust-constr``, after Byrd, Hribar and Nocedal, 1999, SIAM
J. Optim. 9, 877, the kind of ``interior-point``).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, minimize

from aero_bayes.estimate.levenberg_marquardt import FixedCost, LocalSettings, QuadraticModel, levenberg_marquardt
from aero_bayes.estimate.staged import Stage
from paper_replay.evaluator import ModelEvaluator
from paper_replay.published import BOX, PAPER_STAGES
from paper_replay.swarm import axis_box

FloatArray = NDArray[np.float64]

RELATIVE_STEP, TYPICAL = 0.1, 1.0
MAX_ITERATIONS = 60
Method = Literal["line search", "interior point"]
_SCIPY: Mapping[Method, str] = {"line search": "L-BFGS-B", "interior point": "trust-constr"}


@dataclass(frozen=True)
class Slope:
    """Derivative of a stage's Eq. 6 by one parameter at the start: exact, and as the coarse difference sees it."""

    parameter: str
    output: str
    value: float
    step: float
    exact: float
    coarse: float


@dataclass(frozen=True)
class Descent:
    """Where a stage's search ended, and the slopes it started from (empty for the exact search)."""

    stage: Stage
    values: Mapping[str, float]
    start_cost: float
    cost: float
    slopes: tuple[Slope, ...]
    evaluations: int
    reason: str


def coarse_step(x: float, low: float, high: float) -> float:
    """Return the forward-difference step at ``x``, turned round or cut where it would leave the bounds."""
    step = RELATIVE_STEP * max(abs(x), TYPICAL)
    if x + step <= high:
        return step
    if x - step >= low:
        return -step
    return high - x if high - x >= x - low else low - x


def coarse_gradient(
    cost: Callable[[FloatArray], FloatArray], x: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compute forward differences of a batched cost with :func:`coarse_step`, and the steps, shape (k,) each."""
    steps = np.array([coarse_step(*corner) for corner in zip(x.tolist(), low.tolist(), high.tolist(), strict=True)])
    costs = cost(np.vstack((x, x + np.diag(steps))))
    with np.errstate(invalid="ignore"):
        slope = (costs[1:] - costs[0]) / steps
    return np.where(np.isfinite(slope), slope, 0.0), steps


def coarse_stage(
    evaluator: ModelEvaluator, stage: Stage, base: Mapping[str, float], method: Method = "line search"
) -> Descent:
    """Run one stage by the paper's recipe. A failed run counts as a very large cost."""
    output, columns = stage.outputs[0], [evaluator.names.index(name) for name in stage.parameters]
    low, high = np.transpose([BOX[name] for name in stage.parameters])
    evaluations = 0

    def cost(points: FloatArray) -> FloatArray:
        nonlocal evaluations
        evaluations += len(points)
        values = np.tile(evaluator.vector(base), (len(points), 1))
        values[:, columns] = points
        return evaluator.cost(values, output)

    def single(x: FloatArray) -> float:
        found = float(cost(np.clip(x, low, high)[None, :])[0])
        return found if np.isfinite(found) else 1e30

    x0 = evaluator.vector(base)[columns]
    start_cost = single(x0)
    coarse, steps = coarse_gradient(cost, x0, low, high)
    exact = evaluator.slopes(evaluator.vector(base), output, columns)
    slopes = tuple(
        Slope(name, output, float(x), float(h), float(e), float(c))
        for name, x, h, e, c in zip(stage.parameters, x0, steps, exact, coarse, strict=True)
    )
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        found = minimize(
            single, x0, jac=lambda x: coarse_gradient(cost, np.clip(x, low, high), low, high)[0],
            method=_SCIPY[method], bounds=Bounds(low, high), options={"maxiter": MAX_ITERATIONS},
        )  # fmt: skip
    x = np.clip(np.asarray(found.x, dtype=np.float64), low, high)
    values = dict(base) | dict(zip(stage.parameters, x.tolist(), strict=True))
    return Descent(stage, values, start_cost, single(x), slopes, evaluations, str(found.message))


def exact_stage(evaluator: ModelEvaluator, stage: Stage, base: Mapping[str, float]) -> Descent:
    """Run the same stage and cost on logarithmic axes with exact sensitivities."""
    output, columns = stage.outputs[0], [evaluator.names.index(name) for name in stage.parameters]
    low, high = axis_box(evaluator, stage.parameters, "log")

    def quadratic(point: FloatArray) -> QuadraticModel | None:
        values = evaluator.vector(base)[None].copy()
        slope = values[0, columns] = np.exp(point)
        cost, gradient, hessian = evaluator.products(values, output, columns)
        if not np.isfinite(cost[0]):
            return None
        return QuadraticModel(float(cost[0]), gradient[0] * slope, hessian[0] * np.outer(slope, slope))

    x0 = np.clip(np.log(evaluator.vector(base)[columns]), low, high)
    start_cost = float(evaluator.cost(evaluator.vector(base)[None, :], output)[0])
    found = levenberg_marquardt(
        FixedCost(quadratic), x0, low, high, LocalSettings(tolerance=1e-9, relative_tolerance=1e-9)
    )
    x = np.exp(found.point)
    values = dict(base) | dict(zip(stage.parameters, x.tolist(), strict=True))
    return Descent(stage, values, start_cost, 2.0 * found.cost, (), found.evaluations, found.reason.value)


def descend(
    one: Callable[[ModelEvaluator, Stage, Mapping[str, float]], Descent],
    evaluator: ModelEvaluator,
    stages: Sequence[Stage] = PAPER_STAGES,
) -> tuple[Descent, ...]:
    """Run the stages one after the other, each with what the one before found."""
    base: Mapping[str, float] = evaluator.start
    ends = []
    for stage in stages:
        ends.append(one(evaluator, stage, base))
        base = ends[-1].values
    return tuple(ends)

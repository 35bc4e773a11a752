"""The paper's two searches, rerun stage by stage, and the same stages done right.

The swarm: RaPId's has no transform of the axes, its particles stop at the bounds, and its command template asks for few
of them. The number of iterations is not published; :data:`ITERATIONS` is ours.

The constrained search: RaPId's template hands ``fmincon`` a ``FinDiffRelStep`` of 0.1, and MATLAB takes that relative
to ``max(|x|, 1)``: for every parameter of Table 1 but R_a the step is 0.1 in the parameter's own unit, four orders of
magnitude above the inertias. The paper does not say which of ``fmincon``'s algorithms ran, so two of their kind are
rerun here, both from SciPy: a quasi-Newton method that starts from a unit Hessian with a line search along bounds
(L-BFGS-B, the kind of ``sqp`` and ``active-set``), and an interior-point method (``trust-constr``, after Byrd, Hribar
and Nocedal, 1999, SIAM J. Optim. 9, 877, the kind of ``interior-point``).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import Bounds, minimize

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.levenberg_marquardt import FixedCost, LocalSettings, QuadraticModel, levenberg_marquardt
from aero_bayes.estimate.staged import Stage
from aero_bayes.estimate.swarm import Swarm, SwarmSettings
from paper_replay.evaluator import ModelEvaluator
from paper_replay.published import BOX, PAPER_STAGES

Axes = Literal["linear", "log"]
Method = Literal["line search", "interior point"]

PARTICLES, ITERATIONS = 8, 30
#: On log axes: this factor below and above the data sheet.
REACH = 100.0
RELATIVE_STEP, TYPICAL, MAX_ITERATIONS = 0.1, 1.0, 60
_SCIPY: Mapping[Method, str] = {"line search": "L-BFGS-B", "interior point": "trust-constr"}


@dataclass(frozen=True)
class Slope:
    """Derivative of a stage's Eq. 6 by one parameter at the start: exact, and as the coarse difference sees it."""

    parameter: str
    value: float
    step: float
    exact: float
    coarse: float


@dataclass(frozen=True, eq=False)
class StageEnd:
    """Where a stage ended: values, and Eq. 6 of the stage's output at its start (the data sheet) and at its end.

    ``path`` is a swarm's best position after each iteration, SI units, shape (iterations, k); ``slopes`` are those
    that a coarse search started from.
    """

    stage: Stage
    values: Mapping[str, float]
    start_cost: float
    cost: float
    path: FloatArray | None = None
    slopes: tuple[Slope, ...] = ()


@dataclass(frozen=True, eq=False)
class _StageCost:
    """Eq. 6 of a stage's output by the stage's parameters, all others held."""

    evaluator: ModelEvaluator
    stage: Stage
    base: Mapping[str, float]

    @property
    def columns(self) -> list[int]:
        return [self.evaluator.names.index(name) for name in self.stage.parameters]

    @property
    def start(self) -> FloatArray:
        return self.evaluator.vector(self.base)[self.columns]

    def box(self, axes: Axes) -> tuple[FloatArray, FloatArray]:
        """Return the corners of the search box: SI units on linear axes, their natural logarithm on log axes."""
        if axes == "linear":
            low, high = np.transpose([BOX[name] for name in self.stage.parameters])
            return low, high
        centre = np.log([self.evaluator.start[name] for name in self.stage.parameters])
        return centre - np.log(REACH), centre + np.log(REACH)

    def __call__(self, points: FloatArray) -> FloatArray:
        values = np.tile(self.evaluator.vector(self.base), (len(points), 1))
        values[:, self.columns] = points
        return self.evaluator.cost(values, self.stage.outputs[0])

    def end(
        self, x: FloatArray, cost: float, path: FloatArray | None = None, slopes: tuple[Slope, ...] = ()
    ) -> StageEnd:
        """Describe the end of a search at ``x``; at a cost that is not finite the start is kept."""
        moved = dict(zip(self.stage.parameters, x.tolist(), strict=True)) if np.isfinite(cost) else {}
        return StageEnd(self.stage, dict(self.base) | moved, float(self(self.start[None])[0]), cost, path, slopes)


def swarm_stage(
    evaluator: ModelEvaluator, stage: Stage, base: Mapping[str, float], axes: Axes, rng: np.random.Generator
) -> StageEnd:
    """Search the parameters of one stage with a particle swarm, all others held at ``base``."""
    cost = _StageCost(evaluator, stage, base)
    to_si: Callable[[FloatArray], FloatArray] = np.exp if axes == "log" else np.asarray
    swarm = Swarm(*cost.box(axes), rng, SwarmSettings(particles=PARTICLES, reflect=False))
    path = np.empty((ITERATIONS, len(stage.parameters)))
    for iteration in range(ITERATIONS):
        swarm.tell(cost(to_si(swarm.ask())))
        path[iteration] = to_si(swarm.own[swarm.best])
    return cost.end(path[-1], float(swarm.own_cost[swarm.best]), path=path)


def coarse_step(x: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return forward-difference steps at ``x``, shape (k,), turned round or cut where they would leave the bounds."""
    step = RELATIVE_STEP * np.maximum(np.abs(x), TYPICAL)
    cut = np.where(high - x >= x - low, high - x, low - x)
    return np.where(x + step <= high, step, np.where(x - step >= low, -step, cut))


def coarse_gradient(
    cost: Callable[[FloatArray], FloatArray], x: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compute forward differences of a batched cost with :func:`coarse_step`, and the steps, shape (k,) each."""
    steps = coarse_step(x, low, high)
    costs = cost(np.vstack((x, x + np.diag(steps))))
    with np.errstate(invalid="ignore"):
        slope = (costs[1:] - costs[0]) / steps
    return np.where(np.isfinite(slope), slope, 0.0), steps


def coarse_stage(
    evaluator: ModelEvaluator, stage: Stage, base: Mapping[str, float], method: Method = "line search"
) -> StageEnd:
    """Run one stage by the paper's constrained search. A failed run counts as a very large cost."""
    cost = _StageCost(evaluator, stage, base)
    low, high = cost.box("linear")

    def single(x: FloatArray) -> float:
        value = float(cost(np.clip(x, low, high)[None, :])[0])
        return value if np.isfinite(value) else 1e30

    coarse, steps = coarse_gradient(cost, cost.start, low, high)
    exact = evaluator.slopes(evaluator.vector(base), stage.outputs[0], cost.columns)
    slopes = tuple(
        Slope(name, *map(float, numbers))
        for name, *numbers in zip(stage.parameters, cost.start, steps, exact, coarse, strict=True)
    )
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        best = minimize(
            single, cost.start, jac=lambda x: coarse_gradient(cost, np.clip(x, low, high), low, high)[0],
            method=_SCIPY[method], bounds=Bounds(low, high), options={"maxiter": MAX_ITERATIONS},
        )  # fmt: skip
    x = np.clip(np.asarray(best.x, dtype=np.float64), low, high)
    return cost.end(x, single(x), slopes=slopes)


def exact_stage(evaluator: ModelEvaluator, stage: Stage, base: Mapping[str, float]) -> StageEnd:
    """Run the same stage and cost on logarithmic axes with exact sensitivities."""
    cost = _StageCost(evaluator, stage, base)
    low, high = cost.box("log")

    def quadratic(point: FloatArray) -> QuadraticModel | None:
        values = evaluator.vector(base)[None].copy()
        slope = values[0, cost.columns] = np.exp(point)
        half, gradient, hessian = evaluator.products(values, stage.outputs[0], cost.columns)
        if not np.isfinite(half[0]):
            return None
        return QuadraticModel(float(half[0]), gradient[0] * slope, hessian[0] * np.outer(slope, slope))

    settings = LocalSettings(tolerance=1e-9, relative_tolerance=1e-9)
    best = levenberg_marquardt(FixedCost(quadratic), np.clip(np.log(cost.start), low, high), low, high, settings)
    return cost.end(np.exp(best.point), 2.0 * best.cost)


def in_stages(
    search: Callable[[ModelEvaluator, Stage, Mapping[str, float]], StageEnd], evaluator: ModelEvaluator
) -> tuple[StageEnd, ...]:
    """Run the stages one after the other, each with what the one before found."""
    ends: list[StageEnd] = []
    for stage in PAPER_STAGES:
        ends.append(search(evaluator, stage, ends[-1].values if ends else evaluator.start))
    return tuple(ends)


def swarm_recipe(evaluator: ModelEvaluator, axes: Axes, rng: np.random.Generator) -> tuple[StageEnd, ...]:
    """Run the swarm's stages, each with a random stream of its own."""
    streams = iter(rng.spawn(len(PAPER_STAGES)))
    return in_stages(lambda one, stage, base: swarm_stage(one, stage, base, axes, next(streams)), evaluator)

"""The paper's two searches, rerun stage by stage, and the same stages done right.

RaPId's swarm has no transform of the axes, its particles stop at the bounds, and its command template asks for few of
them; the number of iterations is ours. Its template hands ``fmincon`` a ``FinDiffRelStep`` of 0.1, which MATLAB takes
relative to ``max(|x|, 1)``: but for R_a a step of 0.1 in the parameter's own unit, four orders above the inertias. The
paper does not say which of ``fmincon``'s algorithms ran; here SciPy's L-BFGS-B does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import Bounds, least_squares, minimize

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.levenberg_marquardt import Stage
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.estimate.swarm import minimise as swarm_minimise
from paper_replay.models import ModelEvaluator
from paper_replay.published import BOX, PAPER_STAGES

Axes = Literal["linear", "log"]
PARTICLES, ITERATIONS = 8, 30
#: On log axes: this factor below and above the data sheet.
REACH = 100.0
RELATIVE_STEP, TYPICAL, MAX_ITERATIONS = 0.1, 1.0, 60


@dataclass(frozen=True)
class StageEnd:
    """Where a stage ended: values, and Eq. 6 of the stage's output at its start (the data sheet) and at its end."""

    stage: Stage
    values: Mapping[str, float]
    start_cost: float
    cost: float


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

    def end(self, x: FloatArray, cost: float) -> StageEnd:
        """Describe the end of a search at ``x``; at a cost that is not finite the start is kept."""
        moved = dict(zip(self.stage.parameters, x.tolist(), strict=True)) if np.isfinite(cost) else {}
        return StageEnd(self.stage, dict(self.base) | moved, float(self(self.start[None])[0]), cost)


def swarm_stage(
    evaluator: ModelEvaluator, stage: Stage, base: Mapping[str, float], axes: Axes, rng: np.random.Generator
) -> StageEnd:
    """Search the parameters of one stage with a particle swarm, all others held at ``base``."""
    cost = _StageCost(evaluator, stage, base)
    to_si: Callable[[FloatArray], FloatArray] = np.exp if axes == "log" else np.asarray
    settings = SwarmSettings(particles=PARTICLES, iterations=ITERATIONS, patience=ITERATIONS, reflect=False)
    found = swarm_minimise(lambda points: cost(to_si(points)), *cost.box(axes), rng, settings)
    return cost.end(to_si(found.best), found.cost)


def coarse_stage(evaluator: ModelEvaluator, stage: Stage, base: Mapping[str, float]) -> StageEnd:
    """Run one stage by the paper's constrained search. A failed run counts as a very large cost."""
    cost = _StageCost(evaluator, stage, base)
    steps = RELATIVE_STEP * np.maximum(np.abs(cost.start), TYPICAL)

    def single(x: FloatArray) -> float:
        value = float(cost(x[None, :])[0])
        return value if np.isfinite(value) else 1e30

    options = {"eps": steps, "maxiter": MAX_ITERATIONS}
    best = minimize(single, cost.start, method="L-BFGS-B", bounds=Bounds(*cost.box("linear")), options=options)
    return cost.end(np.asarray(best.x, dtype=np.float64), float(best.fun))


def scaled_stage(evaluator: ModelEvaluator, stage: Stage, base: Mapping[str, float]) -> StageEnd:
    """Run the same stage and cost by least squares on logarithmic axes, with fine steps."""
    cost = _StageCost(evaluator, stage, base)
    output, start = evaluator.outputs.index(stage.outputs[0]), np.log(cost.start)

    def residual(point: FloatArray) -> FloatArray:
        values = dict(base) | dict(zip(stage.parameters, np.exp(point).tolist(), strict=True))
        error = evaluator.simulate(evaluator.vector(values))[0][:, output] - evaluator.measured[:, output]
        return np.where(np.isfinite(error), error, 1e3)

    reach = np.log(REACH)
    best = least_squares(residual, start, bounds=(start - reach, start + reach), diff_step=1e-4, xtol=1e-9)
    return cost.end(np.exp(best.x), 2.0 * float(best.cost))


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

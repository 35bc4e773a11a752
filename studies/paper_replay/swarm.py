"""The paper's particle swarm, rerun: eight particles, stage by stage, on linear axes; and again on logarithmic ones.

RaPId's swarm has no transform of the axes, its particles stop at the bounds, and its command template asks for few of
them. The number of iterations is not published; :data:`ITERATIONS` is ours.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.staged import Stage
from aero_bayes.estimate.swarm import Swarm, SwarmSettings
from paper_replay.evaluator import ModelEvaluator
from paper_replay.published import BOX, PAPER_STAGES

FloatArray = NDArray[np.float64]
Axes = Literal["linear", "log"]

PARTICLES, ITERATIONS = 8, 30
#: On log axes: this factor below and above the data sheet.
REACH = 100.0


@dataclass(frozen=True)
class StageEnd:
    """Where a stage ended: the data sheet's cost and the swarm's (Eq. 6 of the stage's output), and the path there.

    ``path`` has shape (iterations, k): the best position after each iteration, SI units.
    """

    stage: Stage
    values: Mapping[str, float]
    start_cost: float
    cost: float
    path: FloatArray
    failures: int


def axis_box(evaluator: ModelEvaluator, names: Sequence[str], axes: Axes) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the search box, in SI units on linear axes and in their natural logarithm on log axes."""
    if axes == "linear":
        low, high = np.transpose([BOX[name] for name in names])
        return low, high
    centre = np.log([evaluator.start[name] for name in names])
    return centre - np.log(REACH), centre + np.log(REACH)


def swarm_stage(
    evaluator: ModelEvaluator,
    stage: Stage,
    base: Mapping[str, float],
    axes: Axes,
    rng: np.random.Generator,
    iterations: int = ITERATIONS,
) -> StageEnd:
    """Search the parameters of one stage, all others held at ``base``."""
    output, columns = stage.outputs[0], [evaluator.names.index(name) for name in stage.parameters]
    low, high = axis_box(evaluator, stage.parameters, axes)
    to_si: Callable[[FloatArray], FloatArray] = np.exp if axes == "log" else np.asarray

    def cost(position: FloatArray) -> FloatArray:
        values = np.tile(evaluator.vector(base), (len(position), 1))
        values[:, columns] = to_si(position)
        return evaluator.cost(values, output)

    failed = evaluator.failures
    start_cost = float(evaluator.cost(evaluator.vector(base)[None, :], output)[0])
    swarm = Swarm(low, high, rng, SwarmSettings(particles=PARTICLES, reflect=False))
    path = np.empty((iterations, len(columns)))
    for iteration in range(iterations):
        swarm.tell(cost(swarm.ask()))
        path[iteration] = to_si(swarm.own[swarm.best])
    best = float(swarm.own_cost[swarm.best])
    values = dict(base)
    if np.isfinite(best):
        values |= dict(zip(stage.parameters, path[-1].tolist(), strict=True))
    return StageEnd(stage, values, start_cost, best, path, evaluator.failures - failed)


def swarm_recipe(
    evaluator: ModelEvaluator, axes: Axes, rng: np.random.Generator, stages: Sequence[Stage] = PAPER_STAGES
) -> tuple[StageEnd, ...]:
    """Search the stages one after the other, each with what the one before found."""
    base: Mapping[str, float] = evaluator.start
    ends = []
    for stage, stream in zip(stages, rng.spawn(len(stages)), strict=True):
        ends.append(swarm_stage(evaluator, stage, base, axes, stream))
        base = ends[-1].values
    return tuple(ends)

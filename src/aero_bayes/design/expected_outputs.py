"""The outputs that are expected of a proposed experiment, with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.design.information import Engine, ExperimentPredictor
from aero_bayes.design.propose import Design
from aero_bayes.design.separation import Separation
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate import Fit


@dataclass(frozen=True, eq=False)
class ExpectedOutputs:
    """Expected outputs at the times of a proposal, without sensor noise.

    ``middle``, ``lower`` and ``upper`` (n, m) are the median and the 90 % band over the posterior of the parameters."""

    outputs: tuple[str, ...]
    middle: FloatArray
    lower: FloatArray
    upper: FloatArray


def expected_outputs(
    proposal: Design | Separation,
    fit: Fit,
    *,
    draws: int = 40,
    seed: int = 1,
    engine: Engine = "native",
    workers: int | None = None,
) -> ExpectedOutputs:
    """Return the outputs that a fitted model expects of a proposed experiment."""
    predictor = ExperimentPredictor(fit, proposal.time, proposal.limits, engine, workers)
    values = predictor.draws(draws, np.random.default_rng(seed))
    rows = np.column_stack([values, np.full(draws, predictor.delay_value)])
    experiment = predictor.experiment(proposal.values, proposal.time)
    with predictor.open(predictor.problem([experiment])) as simulator:
        result = simulator.simulate(rows)
    usable = result.outputs[0][result.outcomes[:, 0] == 0]
    if not len(usable):
        raise CannotFinishError("the proposed experiment could not be simulated")
    low, middle, high = np.quantile(usable, (0.05, 0.5, 0.95), axis=0)
    return ExpectedOutputs(predictor.outputs, middle, low, high)

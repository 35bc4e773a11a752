"""Numbers behind the replay's sentences that its rows do not hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from paper_replay.evaluator import ModelEvaluator
from paper_replay.published import BOX, PSO, PSO_DATASHEET, UNOPTIMISED
from paper_replay.result import Details, ReplayRow, Variant
from paper_replay.rigs import OUTPUTS, Rigs

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Facts:
    """Numbers that the sentences of the replay are made of.

    Parameters
    ----------
    samples : int
    rate_hz : float
    rows : tuple of ReplayRow
    details : Details
    measured : mapping of str to float
        Mean of each output over the last second at 24 V.
    linear, quadratic : mapping of str to float
        The same of the data-sheet values under either law.
    peak : mapping of str to mapping
        Largest value of each output for the paper's two swarm models.
    speed_cost : (float, float)
        Eq. 6 of the speed at J_r = 1 kg m^2 and at the box's edge.
    still : float
        Fitness of a pitch that never moves.
    """

    samples: int
    rate_hz: float
    rows: tuple[ReplayRow, ...]
    details: Details
    measured: Mapping[str, float]
    linear: Mapping[str, float]
    quadratic: Mapping[str, float]
    peak: Mapping[str, Mapping[str, float]]
    speed_cost: tuple[float, float]
    still: float

    @classmethod
    def gather(cls, rigs: Rigs, details: Details, rows: tuple[ReplayRow, ...]) -> Facts:
        """Run the simulations that are still missing, and collect the numbers."""
        recording, linear = rigs.recording, rigs.linear
        driven = recording.inputs["V_m"] > 0.0
        late = driven & (recording.time > recording.time[driven][-1] - 1.0)

        def steady(evaluator: ModelEvaluator) -> dict[str, float]:
            outputs = evaluator.simulate(evaluator.vector(UNOPTIMISED.model_values))[0]
            return dict(zip(OUTPUTS, outputs[late].mean(axis=0).tolist(), strict=True))

        def peak(values: Mapping[str, float]) -> dict[str, float]:
            largest = np.abs(linear.simulate(linear.vector(values))[0]).max(axis=0)
            return dict(zip(OUTPUTS, largest.tolist(), strict=True))

        heavy = [dict(details.swarm[0].values) | {"J_r": inertia, "J_s": 0.0} for inertia in (1.0, BOX["J_r"][1])]
        costs = linear.cost(np.array([linear.vector(values) for values in heavy]), "omega_m")
        return cls(
            recording.rows,
            recording.rate_hz,
            rows,
            details,
            {name: float(np.nanmean(recording.outputs[name][late])) for name in OUTPUTS},
            steady(linear),
            steady(rigs.quadratic),
            {one.label: peak(one.model_values) for one in (PSO, PSO_DATASHEET)},
            (float(costs[0]), float(costs[1])),
            float(np.nansum(recording.outputs["theta"] ** 2)),
        )

    @property
    def delay(self) -> float:
        """The input's delay in s, as fitted."""
        return self.details.quadratic.value("input_delay")

    def fitness(self, model: str, variant: Variant) -> float:
        """Return the fitness of a row; NaN where its simulation failed."""
        found = next(row for row in self.rows if (row.model, row.variant) == (model, variant))
        return float("nan") if found.fitness is None else found.fitness

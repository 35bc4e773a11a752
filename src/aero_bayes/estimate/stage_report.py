"""The result of one stage of the search, for readers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.global_search import FittedStage
from aero_bayes.estimate.objective import Series
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.staged import Stage


@dataclass(frozen=True)
class StageReport:
    """Where a stage of the local search ended: cost, values and RMS error by output."""

    stage: Stage
    cost: float
    values: Mapping[str, float]
    rms: Mapping[str, float]

    def to_dict(self) -> dict[str, object]:
        """Return the entry of result.json."""
        return {
            "parameters": list(self.stage.parameters),
            "outputs": list(self.stage.outputs),
            "cost": self.cost,
            "values": dict(self.values),
            "rms": dict(self.rms),
        }


def stage_report(fitted: FittedStage, parameters: ParameterSet, series: Sequence[Series]) -> StageReport:
    """Return values in SI units and errors by output, over all recordings, at the optimum of a stage."""
    residuals: dict[str, list[FloatArray]] = {}
    own = [s for s in series if s.output in fitted.stage.outputs]
    for s, residual in zip(own, fitted.optimum.evaluation.residual, strict=True):
        residuals.setdefault(s.output, []).append(residual)
    rms = {o: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for o, parts in residuals.items()}
    values = parameters.from_search(fitted.optimum.coordinates)
    return StageReport(fitted.stage, fitted.cost, dict(zip(parameters.names, values.tolist(), strict=True)), rms)

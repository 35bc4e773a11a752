"""Stages of a fit in the order of causality: parameters that affect few outputs come first.

Otherwise a wrong model of the last outputs would bias the parameters of the parts that drive them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.objective import Objective


@dataclass(frozen=True)
class Stage:
    """One stage: the parameters that are fitted, and the outputs that they are fitted to."""

    parameters: tuple[str, ...]
    outputs: tuple[str, ...]


def _causal_stages(names: Sequence[str], outputs: Sequence[str], effect: FloatArray) -> tuple[Stage, ...]:
    """Order stages from the effects of parameters on outputs."""
    moved = [frozenset(np.flatnonzero(effect[:, k] > 0.0).tolist()) for k in range(len(outputs))]
    stages: list[Stage] = []
    settled: set[int] = set()
    for members in sorted(set(moved), key=lambda s: (len(s), sorted(s))):
        new = sorted(members - settled)
        if not new:
            continue
        settled |= set(new)
        group = tuple(out for out, m in zip(outputs, moved, strict=True) if m == members)
        stages.append(Stage(tuple(names[j] for j in new), group))
    return tuple(stages)


def stages_by_effect(objective: Objective, point: FloatArray, free: Sequence[int]) -> tuple[Stage, ...]:
    """Order stages of the free columns by their effects at a point (p,) in search coordinates.

    None where one would do."""
    calibration = objective.calibration
    found = objective.evaluate(point, free)
    if found is None or found.slopes is None or len(calibration.data.outputs) == 1:
        return ()
    effect = np.zeros((len(free), len(calibration.data.outputs)))
    for k, series in enumerate(objective.series):
        size = np.max(np.abs(found.slopes[k]), axis=1) / calibration.data.scale[series.column]
        effect[:, series.column] = np.maximum(effect[:, series.column], size)
    names = [objective.parameters.names[j] for j in free]
    stages = _causal_stages(names, calibration.data.outputs, np.where(effect > 1e-6, effect, 0.0))
    return stages if len(stages) > 1 else ()

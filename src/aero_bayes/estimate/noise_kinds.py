"""Fits under noise that is not equally large at each reading: the kind is chosen, then fit and spread are renewed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.global_search import GlobalSearch
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.noise import NoiseModel
from aero_bayes.estimate.objective import Series
from aero_bayes.estimate.reading_spread import SpreadModel, choose_spread, estimate_spread
from aero_bayes.estimate.whiteness import FALSE_ALARM_RATE, correlation_p_value

#: Fits in turn with the spread of the readings, and relative change of a spread at which they have converged.
MAX_REFITS, MIN_CHANGE = 10, 0.02
#: Fits after which a residual that is still correlated is the model's, whatever the spread.
HOPELESS_REFITS = 3


def choose_spreads(noise: NoiseModel, series: Sequence[Series], here: Optimum) -> dict[str, SpreadModel]:
    """Return the outputs whose noise is not equally large at each reading, with the kind that the residual shows."""
    found = {}
    for output in dict.fromkeys(s.output for s in series):
        declared = noise.spread_kind(output)
        if declared == "constant":
            continue
        residuals, predictions = _of_output(output, series, here)
        if not residuals:
            continue
        model = (choose_spread if declared == "auto" else partial(estimate_spread, declared))(residuals, predictions)
        if not model.equal:
            found[output] = model
    return found


def _with_spread(
    data: MeasuredData, models: Mapping[str, SpreadModel], series: Sequence[Series], here: Optimum
) -> MeasuredData:
    """Return the data with the spread of each reading, from the predictions and residuals of a fit."""
    spreads = [np.ones(measured.shape) for measured in data.measured]
    for output, model in models.items():
        own = [s for s in series if s.output == output]
        for s, spread in zip(own, model.spreads(*_of_output(output, series, here)), strict=True):
            spreads[s.experiment][s.sampling.index, s.column] = spread
    experiments = tuple(replace(e, spread=spread) for e, spread in zip(data.experiments, spreads, strict=True))
    return replace(data, experiments=experiments, spreads=dict(models))


def refit_with_spread(
    search: GlobalSearch, here: Optimum, models: Mapping[str, SpreadModel]
) -> tuple[GlobalSearch, Optimum] | None:
    """Renew fit and spread in turn until they agree."""
    first, simulator, last = search.objective.calibration, search.objective.simulator, search
    asked = [o for o in models if first.noise.spread_kind(o) == "auto"]
    for k in range(MAX_REFITS):
        data = _with_spread(first.data, models, last.objective.series, here)
        old = [s.sampling.spread for s in last.objective.series]
        last = GlobalSearch(search.objective.with_calibration(replace(first, data=data), simulator), search.settings)
        if all(_alike(a, s.sampling.spread) for a, s in zip(old, last.objective.series, strict=True)):
            break
        here = last.refit(here.coordinates, here.free, here.noise)
        if k == HOPELESS_REFITS and any(is_correlated(last.objective.series, here, o) for o in asked):
            return None
        models = {
            o: estimate_spread(m.kind, *_of_output(o, last.objective.series, here), bool(m.scales))
            for o, m in models.items()
        }
    return None if any(is_correlated(last.objective.series, here, o) for o in asked) else (last, here)


def _of_output(output: str, series: Sequence[Series], here: Optimum) -> tuple[list[FloatArray], list[FloatArray]]:
    """Collect residuals and predictions of one output in each recording."""
    own = [k for k, s in enumerate(series) if s.output == output]
    return [here.evaluation.residual[k] for k in own], [here.evaluation.predicted[k] for k in own]


def _alike(old: FloatArray | None, new: FloatArray | None) -> bool:
    if old is None or new is None:
        return old is new
    return bool(np.max(np.abs(np.log(new / old)), initial=0.0) < MIN_CHANGE)


def is_correlated(series: Sequence[Series], here: Optimum, output: str) -> bool:
    """Return whether an output's innovations are correlated over time in a recording."""
    by_series = np.split(here.whitened.residual, np.cumsum([s.sampling.size for s in series])[:-1])
    own = [white for s, white in zip(series, by_series, strict=True) if s.output == output]
    return any(correlation_p_value(white, white) < FALSE_ALARM_RATE / len(own) for white in own)

"""Readings that are not like the others: outliers, and noise that is not equally large at each reading.

Outliers are single readings that are far off a fit and off the readings beside them. They are told from heavy tails of
the noise, which have as many readings a little too far off as very far ones, and from what a model lacks, which lasts
longer than a reading or follows a change of an input. Where noise is uneven, fit and spread are renewed in turn.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from aero_bayes.arrays import FloatArray
from aero_bayes.data.columns import MAD_TO_SD, Mask, after_changes, runs
from aero_bayes.data.find_table import DataFinding
from aero_bayes.data.mend import hide
from aero_bayes.data.noise_floor import quantisation_step
from aero_bayes.data.recording import Recording
from aero_bayes.display import with_unit
from aero_bayes.estimate.global_search import GlobalSearch
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.noise import FALSE_ALARM_RATE, NoiseModel, correlation_p_value
from aero_bayes.estimate.objective import Series
from aero_bayes.estimate.reading_spread import SpreadModel, choose_spread, estimate_spread

#: Distance from the residuals around it, in robust standard deviations, above which a reading is an outlier (1 in 5e8
#: of normal ones), and above which it is unusual (1 in 2,000).
OUTLIER, UNUSUAL = 6.0, 3.5
#: Share of normal readings that may be unusual, twice what is expected.
NORMAL_UNUSUAL = 1e-3
#: Smallest outlier as a share of the output's range: smaller ones decide nothing.
MIN_SIZE = 0.01
#: Readings around one that say what is usual there, most outliers in a row, and largest share of all readings.
AROUND, MOST_IN_A_ROW, MAX_SHARE = 7, 2, 0.1
#: Share of its distance from the fit that an outlier is off the readings beside it, too.
MIN_OFF_NEIGHBOURS = 0.5
#: After a change of an input, an outlier is a single reading that is off by more than what the fit moves within so many
#: readings, times this: a delay that the model lacks leaves no more.
BESIDE, MIN_TIMES_MOVED = 5, 2.0
#: Fewest readings that tell what is usual.
MIN_OUTLIER_READINGS = 30


def without_outliers(
    data: MeasuredData, fitted: Sequence[FloatArray], kept_whole: Collection[str] = ()
) -> tuple[MeasuredData, tuple[DataFinding, ...]]:
    """Return the data without the readings that are outliers of a fit, and what is told of them.

    Outputs that are ``kept_whole`` are not looked at."""
    experiments, recordings = list(data.experiments), list(data.recordings)
    if not recordings:
        return data, ()
    for k, (experiment, measured) in enumerate(zip(data.experiments, data.measured, strict=True)):
        recording = recordings[k]
        rows = np.searchsorted(recording.time, experiment.time)
        inputs = {name: values[rows] for name, values in recording.inputs.items()}
        kept = measured.copy()
        for column, name in enumerate(experiment.outputs):
            if name in kept_whole:
                continue
            found = outlier_rows(measured[:, column], fitted[k][:, column], inputs)
            if not found.any():
                continue
            kept[found, column] = np.nan
            recording = _hidden(recording, name, rows[found], np.abs(measured - fitted[k])[found, column])
        if recording is not recordings[k]:
            recordings[k], experiments[k] = recording, replace(experiment, measured=kept)
    findings = tuple(
        f for new, old in zip(recordings, data.recordings, strict=True) for f in new.findings[len(old.findings) :]
    )
    if not findings:
        return data, ()
    return replace(data, experiments=tuple(experiments), recordings=tuple(recordings)), findings


def outlier_rows(measured: FloatArray, fitted: FloatArray, inputs: Mapping[str, FloatArray]) -> Mask:
    """Mark rows of an output whose readings are outliers of a fit."""
    none = np.zeros(measured.size, dtype=bool)
    at = np.flatnonzero(np.isfinite(measured))
    if at.size < MIN_OUTLIER_READINGS:
        return none
    residual, seen = measured[at] - fitted[at], measured[at]
    off = residual - median_filter(residual, AROUND, mode="nearest")
    # Rounding alone spreads readings by this; the median of what is left of it may be anything below.
    least = (quantisation_step(seen) or 0.0) / math.sqrt(12.0)
    size = max(MAD_TO_SD * float(np.median(np.abs(off))), least)
    far = np.abs(off) > max(OUTLIER * size, MIN_SIZE * float(np.ptp(fitted[at])), 1e-300)
    beside = np.abs(seen - median_filter(seen, AROUND, mode="nearest"))
    far &= beside > MIN_OFF_NEIGHBOURS * np.abs(off)
    moved = maximum_filter1d(fitted[at], BESIDE) - minimum_filter1d(fitted[at], BESIDE)
    near = after_changes(inputs)[at] if inputs else none[at]
    far &= ~near | (np.abs(off) > MIN_TIMES_MOVED * moved)
    every = far.copy()
    for start, stop in runs(far):
        too_long = stop - start > (1 if near[start:stop].any() else MOST_IN_A_ROW)
        if too_long or not _off_the_curve(residual, off, start, stop):
            far[start:stop] = False
    # Where most of what is far off is no outlier, the fit is poor, and says nothing of the rest.
    unusual = int(((np.abs(off) > UNUSUAL * size) & (np.abs(off) <= OUTLIER * size)).sum()) + int((every & ~far).sum())
    if not far.any() or every.mean() > MAX_SHARE or far.sum() <= unusual - NORMAL_UNUSUAL * at.size:
        return none
    found = none.copy()
    found[at[far]] = True
    return found


def _off_the_curve(residual: FloatArray, off: FloatArray, start: int, stop: int) -> bool:
    """Return whether a run of readings is off the cubic through the two residuals on either side of it.

    What a model lacks near a resonance has crests of a few readings; these lie on the curve, outliers do not."""
    beside = np.array([k for k in (start - 2, start - 1, stop, stop + 1) if 0 <= k < residual.size])
    rows = np.arange(start, stop)
    middle = 0.5 * (start + stop - 1)
    curve = np.polynomial.Polynomial.fit(beside - middle, residual[beside], beside.size - 1)
    distance = np.abs(residual[rows] - curve(rows - middle))
    return bool(np.any(distance > MIN_OFF_NEIGHBOURS * np.abs(off[rows])))


def _hidden(recording: Recording, name: str, rows: np.ndarray, distances: FloatArray) -> Recording:
    """Return the recording without the outliers, one finding for all that were ever found of an output."""
    mask = np.zeros(recording.rows, dtype=bool)
    mask[rows] = True
    unit, share = recording.units.get(name, ""), mask.sum() / np.isfinite(recording.outputs[name]).sum()
    size = with_unit(f"{float(np.median(distances)):.3g}", unit)
    what = f"{int(mask.sum())} readings of {name} ({share:.2%}) are outliers, off the fit by about {size}."
    return hide(recording, name, mask, "outliers", what, "They are not fitted.")


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

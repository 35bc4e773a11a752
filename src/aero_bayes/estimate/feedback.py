"""An input that follows an output (a controller sets it) while a disturbance acts: fitted values are then biased.

A simulation's residual is coloured by what nobody recorded, and through the controller the input is correlated with it.
What the input's own past does not tell of it is compared with what is new in the residual at the same reading and at
those before. Of an input from elsewhere, it is new to both. An input that repeats, or runs along a curve, leaves no
noise and tells nothing; one that holds over many readings is not looked at.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm, rankdata

from aero_bayes.arrays import FloatArray
from aero_bayes.data.find_table import DataFinding
from aero_bayes.display import with_unit
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.noise import FALSE_ALARM_RATE, autocorrelation
from aero_bayes.estimate.objective import Series
from aero_bayes.estimate.other_reading import changed_outputs, told_fit
from aero_bayes.estimate.outliers import is_correlated
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.interface import InputSignal

#: Readings of a past that predicts the next one, at most and as a share; fewest readings.
PAST, PAST_SHARE, MIN_READINGS = 20, 0.05, 100
#: Readings by which an input may follow a residual.
LAGS = 10
#: Share of the readings between which an input has to move: a controller answers each.
MIN_MOVING = 0.5
#: Medians of the sizes from which a value is a jump (4 standard deviations of a normal one), and rounds without them.
JUMP, ROUNDS = 6.0, 4
#: Least correlation that is told: 4 % of what is new in the input then comes from the output.
MIN_CORRELATION = 0.2
#: Correlation with itself at any time beyond that past up to which what is new in the input is noise.
MAX_REPEATED = 0.3


def with_feedback(fit: Fit, open_simulator: OpenSimulator) -> Fit:
    """Return the fit with a finding where an input follows the coloured residual of an output."""
    data = fit.calibration.data
    if fit.calibration.process is not None:  # whose filter counts a disturbance as such
        return fit
    pairs = [
        (series, residual, signal)
        for series, residual in zip(fit.series, fit.optimum.evaluation.residual, strict=True)
        if _is_coloured(fit, series.output)
        for signal in data.experiments[series.experiment].inputs
    ]
    best: tuple[float, int, Series, str] | None = None
    for series, residual, signal in pairs:
        found = _correlations(_at(series, signal), residual, len(pairs))
        if found is None:
            continue
        if signal.interpolation != "hold" or not _against(fit, signal, series, found[0], open_simulator):
            found[0] = 0.0  # an input that acts at once leaves a correlation with the reading of its time, too
        lag = int(np.argmax(np.abs(found)))
        if found[lag] and (best is None or abs(found[lag]) > abs(best[0])):
            best = float(found[lag]), lag, series, signal.name
    return fit if best is None else _told(fit, *best)


def _is_coloured(fit: Fit, output: str) -> bool:
    noise = fit.noise[output]
    return noise.model_error or noise.kind == "ou" or is_correlated(fit.series, fit.optimum, output)


def _at(series: Series, signal: InputSignal) -> FloatArray:
    """Return the values that an input has at the readings of a series."""
    at = np.searchsorted(signal.time, series.sampling.time, side="right") - 1
    return signal.values[np.maximum(at, 0)]


def _correlations(values: FloatArray, residual: FloatArray, pairs: int) -> FloatArray | None:
    """Return the correlation of an input with the residual some readings before, 0 where it may be chance.

    None where the input tells nothing. Ranks are compared: a few steps of a set point count as little as other values.
    """
    past = min(PAST, int(PAST_SHARE * values.size))
    if values.size < MIN_READINGS or np.mean(np.diff(values) != 0.0) < MIN_MOVING:
        return None
    own, others = _past(values, past), _past(residual, past)
    moved = _ranks(_new(values[past:], own))
    if np.max(np.abs(autocorrelation(moved)[past + 1 : moved.size // 2])) > MAX_REPEATED:
        return None
    left = _ranks(_new(residual[past:], np.hstack([own, others])))
    found = np.array([np.mean(moved[lag:] * left[: left.size - lag]) for lag in range(LAGS + 1)])
    chance = norm.isf(FALSE_ALARM_RATE / (2.0 * pairs * found.size)) / np.sqrt(left.size)
    return np.where(np.abs(found) > max(chance, MIN_CORRELATION), found, 0.0)


def _past(values: FloatArray, count: int) -> FloatArray:
    """Return rows of the ``count`` values before each value from that of this number on."""
    return np.lib.stride_tricks.sliding_window_view(values[:-1], count)


def _new(values: FloatArray, past: FloatArray) -> FloatArray:
    """Return what a past does not tell of values, by least squares over those that are no jumps (of a set point)."""
    design, used = np.column_stack([np.ones(values.size), past]), np.ones(values.size, dtype=bool)
    for _ in range(ROUNDS):
        new = np.asarray(values - design @ np.linalg.lstsq(design[used], values[used], rcond=1e-10)[0])
        used = np.abs(new) <= JUMP * np.median(np.abs(new))
    return new


def _ranks(values: FloatArray) -> FloatArray:
    """Return the ranks of values, of mean 0 and variance 1."""
    ranks = rankdata(values)
    return np.asarray((ranks - ranks.mean()) / ranks.std())


def _against(fit: Fit, signal: InputSignal, series: Series, correlation: float, open_simulator: OpenSimulator) -> bool:
    """Return whether an input moves against the output at once: what acts without delay would move it along.

    The model's own reaction to a larger input says which way is along."""
    if not correlation:
        return False
    step = float(np.std(signal.values))
    changes = changed_outputs(fit, signal.name, lambda v: v + step, open_simulator)
    k = next(k for k, s in enumerate(fit.series) if s is series)
    return changes is not None and float(np.mean(changes[k])) * correlation < 0.0


def _told(fit: Fit, correlation: float, lag: int, series: Series, name: str) -> Fit:
    recording = fit.calibration.data.recordings[series.experiment]
    after = float(np.median(np.diff(series.sampling.time))) * lag
    when = f"{with_unit(f'{after:.3g}', 's')} before" if lag else "of the same time"
    what = (
        f"{name} follows {series.output}, as where a controller sets it: what is new in {name} has a correlation of "
        f"{correlation:.2f} with the residual of {series.output} {when}. What disturbs {series.output} reaches {name}, "
        "so that the fitted values are biased, by more than their intervals say"
    )
    done = (
        f"Record the disturbance as an input; or move the set point, or add a test signal to {name}, so that this "
        f"outweighs it; or fit process noise ([noise.process])."
    )
    return told_fit(fit, DataFinding("feedback", recording.name, name, what, recording.name, done, False))

"""Noise of a measured input that, passed through the model, is as large as the residual (errors in variables).

The noise is known from the input's own differences. What one sample of it does is the model's response to a pulse at
the fit; the responses of all samples add up in their squares. An input that truly moves so fast would leave less."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import partial

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.find_table import DataFinding
from aero_bayes.data.noise_floor import noise_floor
from aero_bayes.data.recording import Recording
from aero_bayes.display import with_unit
from aero_bayes.estimate.identifiability import BIASED
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.noise import autocorrelation, autocovariance
from aero_bayes.estimate.other_reading import changed_outputs, told_fit
from aero_bayes.estimate.result import Fit

#: Largest noise of an input, as a share of its standard deviation: what moves more by noise is an excitation.
MOST_NOISE = 0.3
#: Size of the passed noise, as a share of the residual, between which they are alike.
LIKE = (0.5, 1.5)
#: Where in a recording the pulse is, and its size in standard deviations of the noise.
PULSE_AT, PULSE = 0.02, 3.0
#: Correlation of the passed noise down to which it is compared, and by how much that of the residual may be off it.
COMPARED, MAX_APART = 0.2, 0.35


def with_input_noise(fit: Fit, open_simulator: OpenSimulator) -> Fit:
    """Return the fit with a finding where an input's own noise, passed through the model, is as large as a residual."""
    poor = [k for k, s in enumerate(fit.series) if fit.noise[s.output].model_error]
    if fit.calibration.process is not None or not poor:
        return fit
    recordings = fit.calibration.data.recordings
    for name in dict.fromkeys(s.name for e in fit.calibration.data.experiments for s in e.inputs):
        known = {e: sd for e, r in enumerate(recordings) if name in r.inputs and (sd := _noise_of(r, name))}
        pulse = PULSE * max(known.values(), default=0.0)
        changes = changed_outputs(fit, name, partial(_with_pulse, pulse), open_simulator) if known else None
        if changes is None:
            continue
        for k in poor:
            series = fit.series[k]
            if (sd := known.get(series.experiment)) and (size := _as_large(fit, k, name, changes[k] * sd / pulse)):
                return _told(fit, recordings[series.experiment], name, sd, series.output, size)
    return fit


def asked_again(fit: Fit, started: Collection[str], open_simulator: OpenSimulator) -> Fit:
    """Return an extended model's fit without what was found of the first one's residual and holds no longer.

    That is a wrong start of a state that is now ``started``; the noise of an input is held against what is left."""
    data = fit.calibration.data

    def holds(f: DataFinding) -> bool:
        return f.kind != "noise" and (f.kind != "value" or f.signal not in started)

    kept = tuple(replace(r, findings=tuple(filter(holds, r.findings))) for r in data.recordings)
    if kept == data.recordings:
        return fit
    fit = replace(fit, calibration=replace(fit.calibration, data=replace(data, recordings=kept)))
    return with_input_noise(fit, open_simulator)


def _noise_of(recording: Recording, name: str) -> float | None:
    """Return the standard deviation of an input's noise where its differences show it."""
    values = recording.inputs[name]
    sd = noise_floor(values, recording.time).sd
    return sd if sd is not None and sd < MOST_NOISE * float(np.nanstd(values)) else None


def _with_pulse(size: float, values: FloatArray) -> FloatArray:
    return np.asarray(values + size * (np.arange(values.size) == int(PULSE_AT * values.size)))


def _as_large(fit: Fit, k: int, name: str, change: FloatArray) -> float | None:
    """Return the RMS of an input's noise in a series, if that is as large and as correlated as its residual.

    ``change`` (n,) is what a pulse of one standard deviation does."""
    series, residual = fit.series[k], fit.optimum.evaluation.residual[k]
    signal = next(s for s in fit.calibration.data.experiments[series.experiment].inputs if s.name == name)
    response = change[series.sampling.time >= signal.time[int(PULSE_AT * signal.time.size)]]
    later = 1.0 - np.arange(response.size) / residual.size
    samples = signal.time.size / residual.size
    size = float(np.sqrt(samples * np.sum(later * response**2)))
    left = float(np.sqrt(np.mean(residual**2)))
    return size if LIKE[0] * left < size < LIKE[1] * left and _as_correlated(response, residual) else None


def _as_correlated(response: FloatArray, residual: FloatArray) -> bool:
    """Return whether a residual is as correlated over time as white noise that passed a pulse response."""
    passed = autocovariance(response, 0.0)[: residual.size // 10]
    expected = passed / passed[0]
    below = np.flatnonzero(expected < COMPARED)
    count = max(int(below[0]), 2) if below.size else expected.size
    return bool(np.all(np.abs(autocorrelation(residual, count)[:count] - expected[:count]) < MAX_APART))


def _told(fit: Fit, recording: Recording, name: str, sd: float, output: str, size: float) -> Fit:
    units, left = fit.calibration.model.units, fit.rms[output]
    sizes = (sd, name), (size, output), (left, output)
    texts = [with_unit(f"{value:.2g}", units.get(signal, "")) for value, signal in sizes]
    what = (
        f"{name} was read with noise of {texts[0]}, which its differences show. Passed through the model, it moves "
        f"{output} by {texts[1]}, and the residual is {texts[2]}"
    )
    done = f"Measure {name} with less noise, or take the values as biased: the model may be right."
    names, told = fit.calibration.parameters.names, dict(fit.failed_intervals)
    told |= dict.fromkeys((names[j] for j in fit.free), BIASED)
    fit = replace(fit, failed_intervals=told)
    return told_fit(fit, DataFinding("noise", recording.name, name, what, recording.name, done, False))

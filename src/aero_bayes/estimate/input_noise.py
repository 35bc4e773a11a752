"""Noise of a measured input that, passed through the model, is as large as the residual (errors in variables).

The noise is known from the input's own differences. What one sample of it does is the model's response to a pulse at
the fit; the responses of all samples add up in their squares. An input that truly moves so fast would leave less."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.find_table import DataFinding
from aero_bayes.data.noise import noise_floor
from aero_bayes.data.recording import Recording
from aero_bayes.display import with_unit
from aero_bayes.estimate.local_fit import OpenSimulator
from aero_bayes.estimate.noise import autocorrelation
from aero_bayes.estimate.other_reading import told_fit
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.interface import Outcome

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
    data = fit.calibration.data
    if fit.calibration.process is not None:
        return fit
    for e, recording in enumerate(data.recordings):
        for name, sd in _noisy_inputs(recording):
            for k, series in enumerate(fit.series):
                if series.experiment != e or not fit.noise[series.output].model_error:
                    continue
                size = _passed(fit, name, sd, k, open_simulator)
                if size is not None:
                    return _told(fit, recording, name, sd, series.output, size)
    return fit


def _noisy_inputs(recording: Recording) -> Iterator[tuple[str, float]]:
    """Yield the inputs whose noise is known from their differences, and its standard deviation."""
    for name, values in recording.inputs.items():
        sd = noise_floor(values, recording.time).sd
        if sd is not None and 0.0 < sd < MOST_NOISE * float(np.nanstd(values)):
            yield name, sd


def _passed(fit: Fit, name: str, sd: float, k: int, open_simulator: OpenSimulator) -> float | None:
    """Return the RMS of an input's noise in a series, if that is as large and as correlated as its residual."""
    series, data = fit.series[k], fit.calibration.data
    experiment = data.experiments[series.experiment]
    signal = next((s for s in experiment.inputs if s.name == name), None)
    if signal is None or signal.time.size < 2:
        return None
    at = int(PULSE_AT * signal.time.size)
    pulse = replace(signal, values=signal.values + PULSE * sd * (np.arange(signal.time.size) == at))
    inputs = tuple(pulse if s is signal else s for s in experiment.inputs)
    moved = [replace(e, inputs=inputs) if e is experiment else e for e in data.experiments]
    with open_simulator(replace(fit.calibration, data=data.with_experiments(moved)).problem()) as simulator:
        run = simulator.simulate(fit.values[np.newaxis])
    if run.outcomes[0, series.experiment] != Outcome.OK:
        return None
    rows, residual = series.sampling.index, fit.optimum.evaluation.residual[k]
    change = run.outputs[series.experiment][0, rows, series.column] - fit.optimum.evaluation.predicted[k]
    response = change[series.sampling.time >= signal.time[at]] / PULSE
    later = 1.0 - np.arange(response.size) / residual.size
    samples = signal.time.size / residual.size
    size = float(np.sqrt(samples * np.sum(later * response**2)))
    left = float(np.sqrt(np.mean(residual**2)))
    return size if LIKE[0] * left < size < LIKE[1] * left and _as_correlated(response, residual) else None


def _as_correlated(response: FloatArray, residual: FloatArray) -> bool:
    """Return whether a residual is as correlated over time as white noise that passed a pulse response."""
    lags = residual.size // 10
    padded = np.fft.irfft(np.abs(np.fft.rfft(response, 2 * response.size)) ** 2)[:lags]
    expected = padded / padded[0]
    below = np.flatnonzero(expected < COMPARED)
    count = max(int(below[0]), 2) if below.size else lags
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
    return told_fit(fit, DataFinding("noise", recording.name, name, what, recording.name, done, False))

"""The curves that the page draws, under the keys of ``series.npz``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.recording import Recording
from aero_bayes.estimate.prediction import Predictive
from aero_bayes.estimate.result import Fit
from aero_bayes.loop.result import LoopResult
from aero_bayes.simulation.interface import SmoothedStates

Series = dict[str, FloatArray]


def measured_series(recordings: Sequence[Recording]) -> Series:
    """Return ``time/<rec>``, ``input/<rec>/<name>`` and ``measured/<rec>/<output>``."""
    series: Series = {}
    for recording in recordings:
        series[f"time/{recording.name}"] = recording.time
        series |= {f"input/{recording.name}/{name}": values for name, values in recording.inputs.items()}
        series |= {f"measured/{recording.name}/{name}": values for name, values in recording.outputs.items()}
    return series


def unfitted_series(read: Sequence[Recording], used: Sequence[Recording]) -> Series:
    """Return ``unfitted/<rec>/<output>``: readings that were taken out of a recording before it was fitted, if any.

    ``read`` are the recordings as they were read, ``used`` the ones that were fitted, or parts of them."""
    series: Series = {}
    raw = {recording.name: recording for recording in read}
    for recording in used:
        whole = raw.get(recording.part_of or recording.name)
        if whole is None:
            continue
        rows = np.searchsorted(whole.time, recording.time)
        for output, values in recording.outputs.items():
            taken = np.isnan(values) & np.isfinite(whole.outputs[output][rows])
            if taken.any():
                series[f"unfitted/{recording.name}/{output}"] = np.where(taken, whole.outputs[output][rows], np.nan)
    return series


def fitted_series(fit: Fit) -> Series:
    """Return ``fitted/<rec>/<output>`` for the outputs that were recorded."""
    series: Series = {}
    for name, fitted, residual in zip(fit.calibration.data.names, fit.fitted, fit.residuals, strict=True):
        for column, output in enumerate(fit.outputs):
            if np.isfinite(residual[:, column]).any():
                series[f"fitted/{name}/{output}"] = fitted[:, column]
    return series


def state_series(names: Sequence[str], states: Mapping[str, SmoothedStates]) -> Series:
    """Return ``smoothed/<rec>/<state>`` and its 90 % band, ``smoothed_lower/...`` and ``smoothed_upper/...``.

    ``states`` are by recording; their columns have the ``names``."""
    series: Series = {}
    for recording, found in states.items():
        low, high = found.band
        for group, rows in (("smoothed", found.mean), ("smoothed_lower", low), ("smoothed_upper", high)):
            series |= {f"{group}/{recording}/{name}": rows[:, k] for k, name in enumerate(names)}
    return series


def band_series(names: Sequence[str], outputs: Sequence[str], bands: Sequence[Predictive]) -> Series:
    """Return ``lower/<rec>/<output>`` and ``upper/...``: the 90 % predictive band of each recording."""
    series: Series = {}
    for name, band in zip(names, bands, strict=True):
        for column, output in enumerate(outputs):
            series[f"lower/{name}/{output}"] = band.lower[:, column]
            series[f"upper/{name}/{output}"] = band.upper[:, column]
    return series


def loop_series(loop: LoopResult) -> Series:
    """Return the curves of a loop: of both models, and those of the final one as fitted ones, too."""
    fitted = {f"fitted/{recording}/{output}": y for (recording, output), y in loop.predicted_after.fitted.items()}
    return fitted | loop.series()


def only_measured(series: Mapping[str, FloatArray]) -> Series:
    """Leave out curves of outputs that no sensor recorded."""
    measured = {key.partition("/")[2] for key in series if key.startswith("measured/")}
    return {
        key: values
        for key, values in series.items()
        if not key.startswith(("lower/", "upper/", "fitted/")) or key.partition("/")[2] in measured
    }

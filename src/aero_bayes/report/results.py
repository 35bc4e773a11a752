"""Writing a run directory: result.json, and the curves that the page draws, under the keys of ``series.npz``."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.noise_floor import noise_floors
from aero_bayes.data.recording import Recording
from aero_bayes.estimate.prediction import Predictive
from aero_bayes.estimate.result import Fit
from aero_bayes.files import write_whole
from aero_bayes.loop.result import LoopResult
from aero_bayes.plain import picked, plain
from aero_bayes.report.schema_run import RecordingJson, RunJson
from aero_bayes.simulation.interface import SmoothedStates

Json = dict[str, Any]
Series = dict[str, FloatArray]

PACKAGES = ("aero-bayes", "numpy", "scipy", "emcee", "arviz", "fmpy", "rumoca")


def write_result(directory: Path, result: Mapping[str, Any]) -> RunJson:
    """Write ``result.json``, once it can be read back; numbers that are not finite become null. Return it as read."""
    document = plain(result)
    told = RunJson.model_validate(document)
    write_json(directory / "result.json", document)
    return told


def write_json(path: Path, document: Mapping[str, Any]) -> Path:
    """Write a document of finite numbers."""
    return write_whole(path, json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def versions() -> dict[str, str]:
    """Return versions of Python and of the packages that the numbers depend on."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found


def merge(*parts: Mapping[str, Any]) -> Json:
    """Return one document from several; nested tables are merged, lists joined, later values win."""
    merged: Json = {}
    for part in parts:
        for key, value in part.items():
            before = merged.get(key)
            if isinstance(before, Mapping) and isinstance(value, Mapping):
                merged[key] = merge(before, value)
            elif isinstance(before, list) and isinstance(value, list):
                merged[key] = [*before, *(item for item in value if item not in before)]
            else:
                merged[key] = value
    return merged


def recording_row(recording: Recording, role: str) -> Json:
    """Return the entry of a recording in result.json, with the noise floors that are known."""
    floor = {output: sd for (_, output), sd in noise_floors([recording], list(recording.outputs)).items()}
    signals = {"inputs": list(recording.inputs), "outputs": list(recording.outputs)}
    return picked(RecordingJson, recording, role=role, duration_s=recording.duration, **signals, noise_floor=floor)


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

"""Writing a run directory: result.json, series.npz, posterior.nc and the page, each whole or not at all."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.noise import noise_floors
from aero_bayes.data.recording import Recording
from aero_bayes.files import whole_file, write_whole
from aero_bayes.plain import plain
from aero_bayes.report.schema_run import RunJson

Json = dict[str, Any]

PACKAGES = ("aero-bayes", "numpy", "scipy", "emcee", "arviz", "fmpy", "rumoca")


def write_result(directory: Path, result: RunJson | Mapping[str, Any]) -> Path:
    """Write ``result.json``; numbers that are not finite become null."""
    told = result if isinstance(result, RunJson) else RunJson.model_validate(plain(result))
    return write_json(directory / "result.json", told.model_dump(by_alias=True, exclude_unset=True))


def write_json(path: Path, document: Mapping[str, Any]) -> Path:
    """Write a document of finite numbers."""
    return write_whole(path, json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def write_series(directory: Path, series: Mapping[str, FloatArray]) -> Path:
    """Write ``series.npz``, the curves that the page draws."""
    path = directory / "series.npz"
    with whole_file(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **{key: np.asarray(v) for key, v in series.items()})
    return path


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
    return {
        "name": recording.name,
        "role": role,
        "rows": recording.rows,
        "rate_hz": recording.rate_hz,
        "duration_s": recording.duration,
        "inputs": list(recording.inputs),
        "outputs": list(recording.outputs),
        "noise_floor": floor,
    }

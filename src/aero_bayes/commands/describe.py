"""Describe a run: the data, the model, the residuals, and a verdict."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from aero_bayes.commands.job import Job
from aero_bayes.data.recording import Recording
from aero_bayes.estimate.other_tools import ValueTrial, trials_sentence
from aero_bayes.estimate.residual_tests import check_residuals, reports_by_recording
from aero_bayes.estimate.result import Fit
from aero_bayes.report.results import recording_row, versions
from aero_bayes.report.schema_run import SCHEMA

Json = dict[str, Any]

#: Written beside the recordings of the simulated bench; its presence is how a page knows to say so.
LABEL = "simulated.json"


def preamble(job: Job, command: str) -> Json:
    """Return the keys that every result.json starts with."""
    recordings = (*job.recordings, *job.tests)
    units = {name: unit for recording in recordings for name, unit in recording.units.items()}
    return {
        "schema": SCHEMA,
        "command": command,
        "seed": job.options.seed,
        "versions": versions(),
        "data": [recording.to_dict() for recording in job.read or recordings],
        "simulated": any(_is_simulated(recording) for recording in recordings),
        "units": units,
        "model": {
            "name": job.name,
            "fmu_sha256": job.model.sha256,
            "exporter": "Modelica source" if job.modelica else "FMU given",
            "engine": job.engine,
        },
        "recordings": [
            *(recording_row(recording, "train") for recording in job.recordings),
            *(recording_row(recording, "test") for recording in job.tests),
        ],
    }


def _is_simulated(recording: Recording) -> bool:
    """Return whether the simulated bench wrote the recording, by the label beside its file.

    Nothing else of it is read."""
    if recording.path is None or not (label := recording.path.with_name(LABEL)).is_file():
        return False
    return recording.path.stem in json.loads(label.read_text("utf-8")).get("recordings", [])


def residual_table(fit: Fit, recordings: Sequence[Mapping[str, Any]]) -> Json:
    """Write residual reports of a fit by recording and output, with the noise floors of ``recordings``."""
    floors = {(r["name"], output): floor for r in recordings for output, floor in r["noise_floor"].items()}
    return reports_by_recording(check_residuals(fit.calibration, fit.series, fit.optimum, floors))


def values_line(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return one line for a terminal: which of the listed values is reported, and how much worse the others are."""
    return trials_sentence([ValueTrial(**row) for row in rows])

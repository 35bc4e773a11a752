"""Describe a run: the data, the model, the residuals, and a verdict."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from aero_bayes.check.residual_tests import check_residuals, reports_by_recording
from aero_bayes.data import Recording, noise_floors
from aero_bayes.estimate.diagnosis import more_words
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.value_comparison import ValueTrial, trials_sentence
from aero_bayes.workflow.job import Job
from aero_bayes.workflow.results import SCHEMA, versions

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


def residual_table(fit: Fit, recordings: Sequence[Mapping[str, Any]]) -> Json:
    """Write residual reports of a fit by recording and output, with the noise floors of ``recordings``."""
    floors = {(r["name"], output): floor for r in recordings for output, floor in r["noise_floor"].items()}
    return reports_by_recording(check_residuals(fit.calibration, fit.series, fit.optimum, floors))


def fit_verdict(
    diagnosis: Sequence[Mapping[str, Any]],
    mcmc: Mapping[str, Any] | None,
    flat: Sequence[str] = (),
    exact: bool = False,
) -> Json:
    """Judge a fit."""
    if mcmc is not None and not mcmc.get("converged", False):
        return {"level": "bad", "text": f"The sampler has not converged: {mcmc.get('reason', 'no reason given')}."}
    found = [row for row in diagnosis if row["found"]]
    structured = any(row["cause"] == "model" for row in found)
    if structured and len(found) == 1:
        what = f"{found[0]['what']} Data, solver, search and form of the noise do not explain it: the model lacks an "
        return {"level": "warning", "text": f"{what}effect."}
    told = _cause_sentence(found[0]) if found else ""
    if structured:
        left = next(str(row["what"]) for row in found if row["cause"] == "model")
        rest = f"{left} This cause is looked into before the model is blamed."
        return {"level": "warning", "text": f"{told} {rest}"}
    sampled = ", and the posterior has converged" if mcmc is not None else ""
    down = "exactly: they have no noise at all" if exact else "down to the noise"
    text = " ".join(filter(None, [f"The model explains the recordings {down}{sampled}.", told, *flat]))
    caution = bool(flat) or any(row["cause"] in ("data", "solver", "search") for row in found)
    return {"level": "warning" if caution else "good", "text": text}


def _cause_sentence(row: Mapping[str, Any]) -> str:
    """Return a row of a diagnosis as text: the cause, what was found, where, and what was done."""
    where = f" ({row['where']})" if row["where"] else ""
    text = f"{row['cause'].capitalize()}: {row['what'].removesuffix('.')}{where}. {row['done']}".strip()
    return f"{text}{more_words(row.get('more', ()))}"


def diagnosis_line(diagnosis: Sequence[Mapping[str, Any]]) -> str:
    """Return one line for a terminal: the state of each cause."""
    return "diagnosis: " + ", ".join(f"{row['cause']} {'FOUND' if row['found'] else 'clear'}" for row in diagnosis)


def values_line(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return one line for a terminal: which of the listed values is reported, and how much worse the others are."""
    return trials_sentence([ValueTrial(**row) for row in rows])

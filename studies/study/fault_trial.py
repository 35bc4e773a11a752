"""Complete models of simulated rigs, with one fault of data, solver or noise, or with none.

The diagnosis of a fit has to name the cause of the fault before all others, and never the model alone; without a fault
it has to name nothing. Noise that is correlated over time is in a third of the rigs; it is found there by right. Seeds
are ``[44302, kind, number]``; those of ``--development`` are for tuning.
"""

from __future__ import annotations

import tempfile
import tomllib
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import aero_bayes
from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.simulation.interface import SolverSettings
from simulated_rigs import DEVELOPMENT, RigTrial, draw_rig_trial
from simulated_rigs.faults import FAULTS, Faulty, with_fault
from simulated_rigs.kinds import KINDS
from study.study import Row, Study, Tasks, Told, keyed, percent, rate_cells, rate_of

#: First number of the seeds of the report.
REPORT = 44302
#: Trials with a fault, and as many without.
COUNT = 300
#: The rig of a trial is drawn anew where its fault makes no sense: the angle of the pendulum is the only one.
MAX_DRAWS = 100
#: Rows of a recording, so that a trial takes about a second.
MOST_ROWS = 2000
#: Factor by which a residual has to be larger for the solver's error to be a fault.
MIN_LARGER = 1.2
#: The search starts within a third of the true values, so that a small swarm does.
SWARM, SWARM_SAMPLES = SwarmSettings(particles=20, iterations=20, patience=5), 200


def tasks(options: Namespace) -> Tasks:
    """List all trials, kinds of faults in turn and those without one between them, so that a partial run has all."""
    base, kinds = DEVELOPMENT if options.development else REPORT, tuple(FAULTS)
    pairs = ((kinds[k % len(kinds)], k // len(kinds), "clear", k) for k in range(COUNT))
    return keyed((base, *one) for fault, n, clear, k in pairs for one in ((fault, n), (clear, k)))


@dataclass(frozen=True)
class Rig:
    """A rig whose model is complete, its compiled model, and what is free in it."""

    trial: RigTrial
    model: aero_bayes.Model
    free: list[str]

    def fit(self, given: Faulty) -> aero_bayes.Fit:
        """Fit the complete model as the configuration of the rig says, by a small swarm: it starts near the truth."""
        tolerance = given.tolerance or SolverSettings().relative_tolerance
        calibration = CalibrationSettings(initial_states="estimated", solver=SolverSettings(tolerance, tolerance))
        settings = aero_bayes.FitSettings(pso=SWARM, swarm_samples=SWARM_SAMPLES, calibration=calibration)
        recordings = [r for r in (given.recording, given.second) if r is not None]
        return aero_bayes.fit(recordings, self.model, parameters=self.free, settings=settings, workers=0)


def draw(task: tuple[int, str, int], folder: Path) -> tuple[Rig, Faulty]:
    """Draw the rig of a trial and what the program is given; the same task always gives the same.

    A solver that is too coarse is a fault where it makes a residual larger: this is looked at by a fit with a fine one.
    """
    base, fault, n = task
    rng = np.random.default_rng([base, [*FAULTS, "clear"].index(fault), n])
    for k in range(MAX_DRAWS):
        kind = tuple(KINDS)[int(rng.integers(len(KINDS)))]
        trial = shortened(draw_rig_trial(kind, int(rng.integers(2**31)), base, "none"))
        given = Faulty(trial.train) if fault == "clear" else with_fault(trial, fault, rng)
        if given is None:
            continue
        section = tomllib.loads(trial.toml.read_text(encoding="utf-8"))
        model = aero_bayes.load_model(section["model"]["name"], sources=[trial.model], folder=folder / str(k))
        rig = Rig(trial, model, list(section["parameters"]))
        if fault != "solver" or _larger(rig.fit(given), rig.fit(Faulty(trial.train))):
            return rig, given
    raise RuntimeError(f"no rig can have the fault {fault}")


def shortened(trial: RigTrial) -> RigTrial:
    """Return the trial with the beginning of its recordings."""

    def beginning(recording: Recording) -> Recording:
        return recording.rows_where(np.arange(recording.rows) < MOST_ROWS, recording.name)

    noise_free = {run: beginning(recording) for run, recording in trial.noise_free.items()}
    return replace(trial, train=beginning(trial.train), test=beginning(trial.test), noise_free=noise_free)


def _larger(coarse: aero_bayes.Fit, fine: aero_bayes.Fit) -> bool:
    return any(coarse.rms[output] > MIN_LARGER * fine.rms[output] for output in fine.outputs)


def attempt(task: tuple[int, str, int]) -> Row:
    """Draw, fit, and set the diagnosis beside the truth."""
    with tempfile.TemporaryDirectory(prefix="fault-trial-") as folder:
        rig, given = draw(task, Path(folder))
        found = rig.fit(given)
        causes = [row for row in found.diagnosis if row.found]
    trial = rig.trial
    return {
        "rig": trial.kind.name,
        "output": given.output,
        "tolerance": given.tolerance,
        "correlated": any(noise.slow for noise in trial.noise.values()),
        "causes": [row.cause for row in causes],
        "what": [row.what for row in causes],
        "findings": sorted({f.kind for r in found.calibration.data.recordings for f in r.findings}),
        "worst_error": max(abs(found[name].value / trial.parameters[name] - 1.0) for name in rig.free),
    }


def cause_named(row: Row) -> bool:
    """Whether the first cause found is that of the fault; without a fault, whether any is found that is not there."""
    causes = row.get("causes", [])
    if row["fault"] in FAULTS:
        return bool(causes[:1] == [FAULTS[row["fault"]]])
    return bool(set(causes) - ({"noise"} if row.get("correlated") else set()))


def summary(rows: Sequence[Row]) -> Row:
    """Return the rates of all trials, and of each kind of fault. A trial that failed counts as missed."""
    rows = [{**row, "fault": row["key"].split("/")[1]} for row in rows]
    clear, faults = ([row for row in rows if (row["fault"] in FAULTS) is there] for there in (False, True))
    return {
        "rates": [
            rate_of("a fault: its cause is named first", "90 %", faults, cause_named),
            rate_of("a fault: the model is blamed", "≤ 2 %", faults, lambda row: row.get("causes") == ["model"]),
            rate_of("no fault: a cause is named", "≤ 2 %", clear, cause_named),
        ],
        "kinds": [
            rate_of(kind.replace("_", " "), "", [row for row in faults if row["fault"] == kind], cause_named)
            for kind in FAULTS
        ],
        "errors": sum("error" in row for row in rows),
    }


def table(found: Mapping[str, Any]) -> Told:
    """Write the rates over all kinds of faults, and which kinds are missed most."""
    worst = [
        f"{kind['what']} {percent(kind['share'])} of {kind['trials']}"
        for kind in found["kinds"]
        if kind["share"] is not None and kind["share"] < 0.9
    ]
    return f"Named less often than 90 %: {', '.join(worst) or 'none'}.", rate_cells(found["rates"])


STUDY = Study(
    "fault_trial",
    f"Complete models of simulated rigs, with one fault of {len(FAULTS)} kinds in data, solver or noise, or with none.",
    tasks, attempt, summary, table, minutes=15.0,
)  # fmt: skip

"""The trial of the diagnosis: rigs whose model is complete, with one fault of data, solver or noise, or with none.

The program is given the recording and the complete model. Its diagnosis has to name the cause of the fault before all
others, and never the model alone; of a rig without a fault it has to name nothing. Noise that is correlated over time
is in a third of the rigs; the noise of such a rig is found by right.

Seeds of the report are ``[44302, kind, number, ...]``; what was tuned was tuned on ``[11001, ...]``
(``--development``). Finished trials are kept, one row each, so that a run that was stopped goes on where it was.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import tempfile
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import aero_bayes
from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.simulation.interface import SolverSettings
from simulated_rigs import DEVELOPMENT, RigTrial, draw_rig_trial, rig_kinds
from simulated_rigs.faults import FAULTS, Faulty, with_fault, without_fault
from trial_runs import Row, cell, markdown_table, rate, run_study, trial_parser, write_summary

#: First number of the seeds of the report.
REPORT = 44302
#: Trials with a fault, and without.
COUNTS = {"fault": 300, "clear": 300}
#: The rig of a trial is drawn anew where its fault makes no sense: the angle of the pendulum is the only one.
MAX_DRAWS = 100
#: Rows of a recording, so that a trial takes about a second.
MOST_ROWS = 2000
#: Factor by which a residual has to be larger for the solver's error to be a fault.
MIN_LARGER = 1.2
#: The search starts within a third of the true values, so that a small swarm does.
SWARM, SWARM_SAMPLES = SwarmSettings(particles=20, iterations=20, patience=5), 200


@dataclass(frozen=True)
class FaultTask:
    """One trial: ``fault`` is one of the kinds of faults, or ``clear``."""

    base: int
    fault: str
    number: int

    @property
    def key(self) -> str:
        """Key of the row."""
        return f"{self.base}/{self.fault}/{self.number}"


def fault_tasks(base: int, faults: int, clear: int) -> list[FaultTask]:
    """List all trials, kinds of faults in turn and those without one between them, so that a partial run has all."""
    kinds = tuple(FAULTS)
    tasks = [(k / faults, FaultTask(base, kinds[k % len(kinds)], k // len(kinds))) for k in range(faults)]
    tasks += [(k / clear, FaultTask(base, "clear", k)) for k in range(clear)]
    return [task for _, task in sorted(tasks, key=lambda one: (one[0], one[1].fault))]


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
        return aero_bayes.fit(given.recording, self.model, parameters=self.free, settings=settings, workers=0)


def draw(task: FaultTask, folder: Path) -> tuple[Rig, Faulty]:
    """Draw the rig of a trial and what the program is given; the same task always gives the same.

    A solver that is too coarse is a fault where it makes a residual larger: this is looked at by a fit with a fine one.
    """
    which = list(FAULTS).index(task.fault) if task.fault in FAULTS else len(FAULTS)
    rng = np.random.default_rng([task.base, which, task.number])
    for k in range(MAX_DRAWS):
        kind = rig_kinds()[int(rng.integers(len(rig_kinds())))]
        trial = shortened(draw_rig_trial(kind, int(rng.integers(2**31)), task.base, "none"))
        given = without_fault(trial) if task.fault == "clear" else with_fault(trial, task.fault, rng)
        if given is None:
            continue
        section = tomllib.loads(trial.toml.read_text(encoding="utf-8"))
        model = aero_bayes.load_model(section["model"]["name"], sources=[trial.model], folder=folder / str(k))
        rig = Rig(trial, model, list(section["parameters"]))
        if task.fault != "solver" or _larger(rig.fit(given), rig.fit(without_fault(trial))):
            return rig, given
    raise RuntimeError(f"no rig can have the fault {task.fault}")


def shortened(trial: RigTrial) -> RigTrial:
    """Return the trial with the beginning of its recordings."""

    def beginning(recording: Recording) -> Recording:
        return recording.rows_where(np.arange(recording.rows) < MOST_ROWS, recording.name)

    noise_free = {run: beginning(recording) for run, recording in trial.noise_free.items()}
    return replace(trial, train=beginning(trial.train), test=beginning(trial.test), noise_free=noise_free)


def _larger(coarse: aero_bayes.Fit, fine: aero_bayes.Fit) -> bool:
    return any(coarse.rms[output] > MIN_LARGER * fine.rms[output] for output in fine.outputs)


def attempt(task: FaultTask) -> Row:
    """Draw, fit, and set the diagnosis beside the truth; a trial that fails is a row that says so."""
    began = time.process_time()
    row: Row = {"key": task.key, "fault": task.fault, "cause": FAULTS.get(task.fault, "")}
    try:
        with tempfile.TemporaryDirectory(prefix="fault-trial-") as folder:
            rig, given = draw(task, Path(folder))
            row |= {"rig": rig.trial.truth.kind, "output": given.output, "tolerance": given.tolerance}
            found = rig.fit(given)
            causes = [r for r in found.diagnosis if r.found]
        truth = rig.trial.truth
        row |= {
            "correlated": any(noise.slow for noise in truth.noise.values()),
            "causes": [r.cause for r in causes],
            "what": [r.what for r in causes],
            "findings": sorted({f.kind for r in found.calibration.data.recordings for f in r.findings}),
            "worst_error": max(abs(found[name].value / truth.parameters[name] - 1.0) for name in rig.free),
        }
    except Exception as error:
        row |= {"causes": [], "error": f"{type(error).__name__}: {error}"}
    return {**row, "seconds": round(time.process_time() - began, 3)}


def cause_named(row: Row) -> bool:
    """Whether the first cause found is that of the fault; without a fault, whether any is found that is not there."""
    if row["fault"] in FAULTS:
        return bool(row["causes"][:1] == [row["cause"]])
    there = {"noise"} if row.get("correlated") else set()
    return bool(set(row["causes"]) - there)


def model_blamed(row: Row) -> bool:
    """Whether nothing but the model is found."""
    return bool(row["causes"] == ["model"])


def summarise(rows: Sequence[Row], left: int) -> dict[str, Any]:
    """Compute rates of all trials, and of each kind of fault; ``left`` trials have not been run."""
    faults = [row for row in rows if row["fault"] in FAULTS]
    clear = [row for row in rows if row["fault"] not in FAULTS]
    kinds = {kind: [row for row in faults if row["fault"] == kind] for kind in FAULTS}
    return {
        "faults": _rates(faults),
        "clear": {"loops": len(clear), "cause_named": rate(clear, cause_named)},
        "kinds": {kind: _rates(own) for kind, own in kinds.items()},
        "errors": sum("error" in row for row in rows),
        "left": left,
        "rows": list(rows),
    }


def _rates(rows: Sequence[Row]) -> dict[str, Any]:
    return {
        "loops": len(rows),
        "cause_named": rate(rows, cause_named),
        "model_blamed": rate(rows, model_blamed),
    }


def table(found: dict[str, Any]) -> str:
    """Write the rates in Markdown, then the trials that went wrong."""
    lines = markdown_table(
        ("fault", "trials", "cause named", "model blamed"),
        (
            (kind, str(own["loops"]), cell(own["cause_named"]), cell(own["model_blamed"]))
            for kind, own in [*found["kinds"].items(), ("all", found["faults"])]
        ),
    )
    clear = found["clear"]
    lines += ["", f"without a fault: {clear['loops']} trials, a cause named in {cell(clear['cause_named'])}", ""]
    for row in found["rows"]:
        if cause_named(row) != (row["fault"] in FAULTS):
            said = row.get("error") or "; ".join(row["what"]) or "nothing found"
            lines.append(f"{row['key']} ({row.get('rig')} {row.get('output')}): {said}")
    return "\n".join(lines)


def main() -> None:
    parser = trial_parser(__doc__, stop_after=15.0)
    parser.add_argument("--faults", type=int, default=COUNTS["fault"], help="trials with a fault")
    parser.add_argument("--clear", type=int, default=COUNTS["clear"], help="trials without")
    options = parser.parse_args()
    tasks = fault_tasks(DEVELOPMENT if options.development else REPORT, options.faults, options.clear)
    rows = run_study(tasks, attempt, options.out / "fault_trial" / "trials.sqlite", options)
    found = summarise(rows, len(tasks) - len(rows))
    print(table(found))
    write_summary(found, options.out / ("fault_trial-dev.json" if options.development else "fault_trial.json"))


if __name__ == "__main__":
    main()

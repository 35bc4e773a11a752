"""Complete models of simulated rigs, with one fault of data, solver or noise, or with none.

The diagnosis of a fit has to name the cause of the fault before all others, and never the model alone; without a fault
it has to name nothing. Noise that is correlated over time is in a third of the rigs; it is found there by right. Seeds
are ``[44302, kind, number]`` for ``--seed 1``.
"""

from __future__ import annotations

import tempfile
import tomllib
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp, log, pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

import aero_bayes
from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings, LogNormal, ParameterSpec
from aero_bayes.estimate.other_reading import residual_shares
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.simulation.interface import SolverSettings
from simulated_rigs.kinds import KINDS
from simulated_rigs.trial import RigTrial, draw_rig_trial
from study.study import Row, Study, Tasks, Told, keyed, rate_cells, rate_of

#: Each kind of fault, with the cause that a diagnosis has to name.
FAULTS: Mapping[str, str] = {
    "impossible": "data", "outliers": "data", "stuck": "data", "clipped": "data", "gap": "data", "wrapped": "data",
    "sign": "data", "swapped": "data", "ahead": "data", "clock": "data", "rounded": "noise", "relative": "noise",
    "heavy_tails": "noise", "unlike": "noise", "solver": "solver", "averaged": "data", "held": "data",
    "zero_shifted": "data", "scaled": "data", "prior": "data",
}  # fmt: skip
#: Those that the parameters may take up: only where a fit is worse by them they are faults.
MAY_FIT = ("solver", "averaged", "zero_shifted", "scaled", "prior")
#: Share of the readings that are outliers, and their sizes in standard deviations of the noise.
OUTLIER_SHARE, OUTLIER_SIZES = 0.03, (15.0, 40.0)
#: Share of a recording in which a sensor is stuck or the logger has a gap.
LOST_SHARE = (0.03, 0.1)
#: Share of the readings beyond the end of a sensor that clips.
CLIPPED_SHARE = (0.03, 0.1)
#: Steps of a coarse count in standard deviations of the noise.
COUNTS = (4.0, 12.0)
#: Least ratio of the largest to the smallest readings (quantiles) of an output whose relative noise can be seen.
MIN_READING_RATIO = 3.0
#: Samples by which an output is ahead, share by which its clock is off, and what either moves readings by at least, in
#: standard deviations of the noise.
AHEAD, RATE, MIN_MOVED = (1, 4), (2e-3, 2e-2), 3.0
#: Standard deviation of the noise in a second recording over that in the first.
UNLIKE = (4.0, 20.0)
#: Samples of a mean, and least means of a recording; samples over which a sensor holds its value.
AVERAGED, MIN_MEANS, HELD = (4, 12), 150, (5, 25)
#: Constant at a reading as a share of its range; factors of units that are taken for others.
SHIFT, UNIT_FACTORS = (0.1, 0.5), (2.0 * pi, 1e3, 1e5, 9.81, 3.6, 60.0)
#: Factor by which a prior is off, and its relative standard deviation.
PRIOR_OFF, PRIOR_SD = (1.2, 1.6), 0.005
#: Relative and absolute tolerances of a solver that is too coarse.
TOLERANCES = (1e-2, 0.3)


#: First number of the seeds of the report.
REPORT = 44302
#: Trials with a fault, and as many without.
COUNT = 100
#: The rig of a trial is drawn anew where its fault makes no sense: the angle of the pendulum is the only one.
MAX_DRAWS = 100
#: Rows of a recording, so that a trial takes about a second.
MOST_ROWS = 2000
#: Factor by which a residual has to be larger for the solver's error to be a fault.
MIN_LARGER = 1.2
#: The search starts within a third of the true values, so that a small swarm does.
SWARM, SWARM_SAMPLES = SwarmSettings(particles=20, iterations=20, patience=5), 200


@dataclass(frozen=True)
class Faulty:
    """What the program is given: recordings, and the tolerance of the solver; ``output`` has the fault, if one has."""

    recording: Recording
    output: str = ""
    tolerance: float | None = None
    second: Recording | None = None
    prior: tuple[str, LogNormal] | None = None


def with_fault(trial: RigTrial, fault: str, rng: Generator) -> Faulty | None:
    """Give a rig whose model is complete one of :data:`FAULTS`; None where the fault makes no sense for this rig.

    ``rng`` draws where and how large.
    """
    if fault == "solver":
        return Faulty(trial.train, tolerance=exp(rng.uniform(*np.log(TOLERANCES))))
    if fault in ("gap", "sign", "swapped"):
        changed = _with_gap(trial.train, rng) if fault == "gap" else _other_channels(trial.train, fault, rng)
        return None if changed is None else Faulty(changed)
    if fault == "prior":
        name = str(rng.choice(sorted(trial.parameters)))
        median = trial.parameters[name] * exp(rng.choice([-1.0, 1.0]) * rng.uniform(*np.log(PRIOR_OFF)))
        return Faulty(trial.train, prior=(name, LogNormal.tolerance(median, PRIOR_SD)))
    if fault in ("averaged", "scaled"):
        changed = _averaged(trial, rng) if fault == "averaged" else _scaled(trial.train, rng)
        return None if changed is None else Faulty(changed)
    names = list(trial.train.outputs)
    if fault == "unlike":
        factor = exp(rng.uniform(*np.log(UNLIKE)))
        return Faulty(
            replace(trial.train, outputs=_white(trial, rng), sha256=""), names[0],
            second=replace(trial.test, outputs=_white(trial, rng, "test", factor), sha256=""),
        )  # fmt: skip
    for name in [names[int(k)] for k in rng.permutation(len(names))]:
        readings = _readings(trial, fault, name, rng)
        if readings is not None:
            outputs = {**trial.train.outputs, name: readings}
            if FAULTS[fault] == "noise":
                # The other outputs have white noise, so that there is one fault only.
                outputs = {**_white(trial, rng), name: readings}
            return Faulty(replace(trial.train, outputs=outputs, sha256=""), name)
    return None


def _readings(trial: RigTrial, fault: str, name: str, rng: Generator) -> FloatArray | None:
    """Return the readings of an output with a fault; None where it makes no sense."""
    seen, clean = trial.train.outputs[name].copy(), trial.noise_free["train"].outputs[name]
    sd = trial.noise[name].white
    if fault == "impossible":
        seen[rng.choice(seen.size, 3, replace=False)] = -999.0
    elif fault == "outliers":
        rows = rng.choice(seen.size, round(OUTLIER_SHARE * seen.size), replace=False)
        seen[rows] += sd * rng.uniform(*OUTLIER_SIZES, rows.size) * rng.choice([-1.0, 1.0], rows.size)
    elif fault == "stuck":
        first, last = _stretch(seen.size, rng)
        seen[first:last] = seen[first]
    elif fault == "clipped":
        share = rng.uniform(*CLIPPED_SHARE)
        upper = rng.random() < 0.5
        seen = np.minimum(seen, np.quantile(seen, 1.0 - share)) if upper else np.maximum(seen, np.quantile(seen, share))
    elif fault == "wrapped":
        if trial.train.units[name] != "rad" or seen.min() >= 0.0:
            return None
        seen %= 2.0 * pi
    elif fault == "held":
        every, here = int(rng.integers(*HELD)), np.arange(seen.size)
        came = np.maximum(here - (here + int(rng.integers(every))) % every, 0)
        if float(np.sqrt(np.mean((clean[came] - clean) ** 2))) < MIN_MOVED * sd:
            return None
        return np.asarray(seen[came])
    elif fault == "zero_shifted":
        seen += rng.choice([-1.0, 1.0]) * rng.uniform(*SHIFT) * float(np.ptp(clean))
    elif fault in ("ahead", "clock"):
        row = np.arange(seen.size, dtype=float)
        rate = exp(rng.uniform(*np.log(RATE))) * rng.choice([-1.0, 1.0])
        at = row + rng.integers(*AHEAD, endpoint=True) if fault == "ahead" else row * (1.0 + rate)
        moved = np.interp(at, row, clean)
        if float(np.sqrt(np.mean((moved - clean) ** 2))) < MIN_MOVED * sd:
            return None
        return np.asarray(moved + sd * rng.standard_normal(seen.size))
    else:
        return _with_noise(fault, clean, sd, rng)
    return seen


def _other_channels(recording: Recording, fault: str, rng: Generator) -> Recording | None:
    """Return the recording with the sign of a channel turned, or two of one unit exchanged; None where none can be."""
    for side in ("inputs", "outputs") if rng.random() < 0.5 else ("outputs", "inputs"):
        columns = dict(getattr(recording, side))
        names = [n for n in columns if recording.units[n] != "K"]
        pairs = [(a, b) for a in columns for b in columns if a < b and recording.units[a] == recording.units[b]]
        if fault == "sign" and names:
            name = str(rng.choice(names))
            columns[name] = -columns[name]
        elif fault == "swapped" and pairs:
            a, b = pairs[int(rng.integers(len(pairs)))]
            columns[a], columns[b] = columns[b], columns[a]
        else:
            continue
        new: dict[str, Any] = {side: columns}
        return replace(recording, **new, sha256="")
    return None


def _averaged(trial: RigTrial, rng: Generator) -> Recording | None:
    """Return means of the inputs, and of the outputs or not, at the ends of intervals; None where little moves."""
    count, clean = int(rng.integers(*AVERAGED)), trial.noise_free["train"]
    rows = (clean.rows - 1) // count
    if rows < MIN_MEANS:
        return None
    ends = count * np.arange(1, rows + 1)

    def means(values: FloatArray) -> FloatArray:
        return np.asarray(values[: rows * count].reshape(rows, count).mean(axis=1))

    # Inputs hold from their row on; an output runs in about straight lines between two.
    inputs = {name: means(values) for name, values in clean.inputs.items()}
    averages = {name: means((values[:-1] + values[1:]) / 2.0) for name, values in clean.outputs.items()}
    instants = {name: values[ends] for name, values in clean.outputs.items()}
    moved = (np.sqrt(np.mean((averages[n] - instants[n]) ** 2)) / trial.noise[n].white for n in instants)
    if max(moved) < MIN_MOVED:
        return None
    seen = averages if rng.random() < 0.5 else instants
    outputs = {n: y + trial.noise[n].white * rng.standard_normal(rows) for n, y in seen.items()}
    return replace(clean, time=clean.time[ends], inputs=inputs, outputs=outputs, sha256="")


def _scaled(recording: Recording, rng: Generator) -> Recording:
    """Return the recording with a channel in another unit than it says."""
    side = str(rng.choice(["inputs", "outputs"]))
    columns, factor = dict(getattr(recording, side)), float(rng.choice(UNIT_FACTORS)) ** rng.choice([-1, 1])
    name = str(rng.choice(list(columns)))
    new: dict[str, Any] = {side: {**columns, name: factor * columns[name]}}
    return replace(recording, **new, sha256="")


def _with_noise(fault: str, clean: FloatArray, sd: float, rng: Generator) -> FloatArray | None:
    """Draw readings with a noise that is not white and normal."""
    normal = rng.standard_normal(clean.size)
    if fault == "rounded":
        step = sd * exp(rng.uniform(*np.log(COUNTS)))
        return np.asarray(step * np.round((clean + sd * normal) / step))
    if fault == "heavy_tails":
        return np.asarray(clean + sd / sqrt(3.0) * rng.standard_t(3.0, clean.size))
    low, high = np.quantile(np.abs(clean), [0.1, 0.9])
    if high < MIN_READING_RATIO * low:
        return None
    size = np.abs(clean) / sqrt(float(np.mean(clean**2)))
    return np.asarray(clean + sd * (0.2 + size) * normal)


def _white(trial: RigTrial, rng: Generator, run: str = "train", factor: float = 1.0) -> dict[str, FloatArray]:
    return {
        name: values + factor * trial.noise[name].white * rng.standard_normal(values.size)
        for name, values in trial.noise_free[run].outputs.items()
    }


def _stretch(rows: int, rng: Generator) -> tuple[int, int]:
    """Draw the first row of a stretch and the row after it, away from both ends."""
    length = round(rows * exp(rng.uniform(log(LOST_SHARE[0]), log(LOST_SHARE[1]))))
    first = int(rng.integers(rows // 10, rows - rows // 10 - length))
    return first, first + length


def _with_gap(recording: Recording, rng: Generator) -> Recording | None:
    """Return the recording without a stretch in which an input changed."""
    for _ in range(20):
        first, last = _stretch(recording.rows, rng)
        if any(np.ptp(values[first:last]) > 0.0 for values in recording.inputs.values()):
            keep = np.ones(recording.rows, dtype=bool)
            keep[first:last] = False
            return recording.rows_where(keep, recording.name)
    return None


def tasks(options: Namespace) -> Tasks:
    """List all trials, kinds of faults in turn and those without one between them, so that a partial run has all."""
    base, kinds = REPORT + options.seed - 1, tuple(FAULTS)
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
        specs = {name: ParameterSpec() for name in self.free}
        if given.prior is not None:
            specs[given.prior[0]] = ParameterSpec(prior=given.prior[1])
        return aero_bayes.fit(recordings, self.model, parameters=specs, settings=settings, workers=0)


def draw(task: tuple[int, str, int], folder: Path) -> tuple[Rig, Faulty]:
    """Draw the rig of a trial and what the program is given; the same task always gives the same.

    What parameters may take up is a fault where it makes a residual larger: this is looked at by a fit without it.
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
        if fault not in MAY_FIT or _larger(rig.fit(given), rig.fit(Faulty(trial.train))):
            return rig, given
    raise RuntimeError(f"no rig can have the fault {fault}")


def shortened(trial: RigTrial) -> RigTrial:
    """Return the trial with the beginning of its recordings."""

    def beginning(recording: Recording) -> Recording:
        return recording.rows_where(np.arange(recording.rows) < MOST_ROWS, recording.name)

    noise_free = {run: beginning(recording) for run, recording in trial.noise_free.items()}
    return replace(trial, train=beginning(trial.train), test=beginning(trial.test), noise_free=noise_free)


def _larger(faulty: aero_bayes.Fit, fine: aero_bayes.Fit) -> bool:
    """Return whether a residual is larger by a fault, as a share of what was read, whose unit may have changed."""
    sizes = [residual_shares(fit.calibration.data, fit.fitted) for fit in (faulty, fine)]
    return any(sizes[0][output] > MIN_LARGER * sizes[1][output] for output in sizes[1])


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
        f"{kind['what']} {round(kind['share'] * kind['trials'])} of {kind['trials']}"
        for kind in found["kinds"]
        if kind["share"] is not None and kind["share"] < 0.9
    ]
    return f"Kinds named in less than 90 % of their trials: {', '.join(worst) or 'none'}.", rate_cells(found["rates"])


STUDY = Study(
    "fault_trial",
    f"Complete models of simulated rigs, with one fault of {len(FAULTS)} kinds in data, solver or noise, or with none.",
    tasks, attempt, summary, table, minutes=15.0,
)  # fmt: skip

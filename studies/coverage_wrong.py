"""How far do intervals hold where the model is wrong? Coverage and width over repeated experiments.

Four rigs are recorded again and again in states that the engineer's model knows nothing of: nothing is missing, a law
is missing, an effect that no library lists acts, a random force drives a state. In a fifth state the closed loop has
found the missing law, and the extended model is fitted to the recordings in which the law acts.

Each recording repeats the experiment with new random levels of its inputs and new noise. What an interval should hold
is what the fit would give if the experiment went on for very long without noise in its readings: the best, or
pseudo-true, values, found on one recording :data:`LONG` times as long. Each output counts there as in a fit of usual
length, where its error is that of the model and the noise together. Where the model is right, and after it was mended,
the true values are asked for.

Beside the intervals of the program stand, on the same recordings, those of white-noise least squares (the covariance
that scipy's ``curve_fit`` gives). On every fifth recording they stand beside an MCMC posterior under white noise
(emcee); some of these also have the program's own draws and prediction bands. Widths are relative to the narrowest
interval of this estimate that could hold: 1.645 times the root mean square error of the estimates, to either side.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.random import Generator

from aero_bayes import LoopResult, LoopSettings, SampleSettings, close_loop, load_model, sample
from aero_bayes.estimate import FitSettings, fit, parameters_from_model
from aero_bayes.estimate.calibration import calibrate
from aero_bayes.estimate.local_fit import LocalFitSettings, local_fit
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Override, Parameter
from aero_bayes.sensors.noise import NoiseModel
from aero_bayes.simulation import Model, open_simulator
from coverage_wrong_page import TITLE, parts
from study_page import write_page
from trial_runs import code, run_study, trial_parser, write_summary
from wrong_intervals import (
    HALF_90,
    Intervals,
    intervals_of_draws,
    intervals_of_fit,
    least_squares_intervals,
    white_posterior_intervals,
)
from wrong_rigs import SIZES, Rig, rigs

STATES = ("right", "missing", "mended", "unlisted", "process_noise")
#: What acts in a recording of each state.
RECORDED = {"mended": "missing"}
#: First numbers of the seeds: those on which intervals were developed, and those of the report.
DEVELOPMENT, REPORT = 35001, 35902
#: Recordings of each rig in each state, and how much longer the recording of the best values is.
RECORDINGS, LONG = 26, 20.0
#: Every so many recordings of a rig are sampled; the posteriors of the first few predict a new recording.
SAMPLED_EVERY, PREDICTING = 5, 2
#: ``posterior`` are quantiles of the program's draws; all others stand in the contract.
METHODS = ("ours", "curve_fit", "mcmc_white", "posterior")
SHORT = SampleSettings(ess=200.0, max_steps=400, max_minutes=0.67, predictive=20)


@dataclass(frozen=True)
class Best:
    """Find the best values of a rig's model in a state."""

    seed: int
    rig: str
    state: str
    size: float
    folder: Path

    @property
    def key(self) -> str:
        return f"{self.seed}/best/{self.rig}/{self.state}/{self.size:g}"


@dataclass(frozen=True)
class Mend:
    """Let the closed loop find the law that a rig's model lacks."""

    seed: int
    rig: str
    folder: Path

    @property
    def key(self) -> str:
        return f"{self.seed}/mend/{self.rig}"


@dataclass(frozen=True)
class Extended:
    """A model that the loop extended: its FMU, and by new parameter start, bounds and scale."""

    model: str
    added: Mapping[str, Sequence[Any]]

    def parameters(self) -> tuple[Parameter, ...]:
        wishes = {name: Override(*one[:3], scale=one[3]) for name, one in self.added.items()}
        return parameters_from_model(Model.load(self.model), tuple(wishes), wishes).items


@dataclass(frozen=True)
class Repetition:
    """One repetition of an experiment, and what its intervals should hold.

    ``targets`` are the values by parameter; ``extended`` is the model that is fitted, for a rig that was mended.
    Posteriors are ``sampled`` in a task of their own, since they take longer.
    """

    seed: int
    rig: str
    state: str
    number: int
    folder: Path
    targets: Mapping[str, float] = field(compare=False)
    sampled: bool = False
    extended: Extended | None = field(default=None, compare=False)

    @property
    def size(self) -> float:
        return SIZES[self.number % len(SIZES)]

    @property
    def key(self) -> str:
        return f"{self.seed}/{self.state}/{self.rig}/{self.number}{'/sampled' if self.sampled else ''}"


Task = Best | Mend | Repetition


def generator(*parts: object) -> Generator:
    """Seed random numbers by the parts of a key."""
    return np.random.default_rng(list(hashlib.sha256(repr(parts).encode()).digest()))


def attempt(task: Task) -> dict[str, Any]:
    """Make the row of a task."""
    began, rig = time.perf_counter(), rigs()[task.rig]
    if isinstance(task, Best):
        row = best_values(task, rig)
    elif isinstance(task, Mend):
        row = mend(task, rig)
    else:
        row = repetition(task, rig)
    return {"key": task.key, **row, "seconds": round(time.perf_counter() - began, 2)}


def built(task: Task, rig: Rig) -> Model:
    return Model.load(task.folder / f"{rig.name}.fmu")


def settings_of(rig: Rig, noise: str = "auto") -> FitSettings:
    return FitSettings(method="local", calibration=rig.calibration, noise=NoiseModel(default=noise))  # type: ignore[arg-type]


def best_values(task: Best, rig: Rig) -> dict[str, Any]:
    """Find the values that serve best in a long recording without noise, outputs weighed as in fits of usual length."""
    rng = generator(task.seed, "best", task.rig, task.state, task.size)
    model = built(task, rig)
    parameters = rig.parameters(model)
    usual = [
        fit(rig.record(task.state, task.size, rng)[0], model, parameters=parameters,
            settings=settings_of(rig, "white"), workers=0)
        for _ in range(2)
    ]  # fmt: skip
    sizes = {o: float(np.sqrt(np.mean([one.noise[o].sd ** 2 for one in usual]))) for o in usual[0].outputs}
    noise = {o: replace(n, sd_white=sizes[o]) for o, n in usual[0].noise.items()}
    _, silent = rig.record(task.state, task.size, rng, times=LONG)
    calibration = calibrate([silent], model, parameters, settings=rig.calibration)
    start = calibration.parameters.start.copy()
    for k, item in enumerate(calibration.parameters):
        if item.recording is None or "delay" in item.name:
            start[k] = np.mean([one[item.name].value for one in usual])
    with open_simulator(calibration.problem(), workers=0) as simulator:
        objective = Objective(calibration, simulator)
        found = local_fit(
            objective, calibration.parameters.to_search(start), range(len(start)), noise=noise,
            settings=LocalFitSettings(hold_noise=True, prior=False).with_limits(30, 0.01),
        )  # fmt: skip
    values = dict(zip(calibration.parameters.names, objective.parameters.from_search(found.coordinates), strict=True))
    return {"values": {name: float(values[name]) for name in rig.truth}}


def closed_loop(rig: Rig, model: Model, state: str, size: float, rng: Generator, folder: Path) -> LoopResult:
    """Close the loop on one recording of a rig in a state and test it on another; ``model`` is the rig's reference."""
    train, test = (replace(rig.record(state, size, rng)[0], name=name) for name in ("train", "test"))
    fit = FitSettings(method="local", calibration=rig.calibration)
    settings = LoopSettings(fit, rig.parameters(model), solver=rig.calibration.solver)
    return close_loop(train, test, model=rig.reference, settings=settings, workers=0, out_dir=folder)


def mend(task: Mend, rig: Rig) -> dict[str, Any]:
    """Let the loop add to the model, from two recordings in which the law is large."""
    rng = generator(task.seed, "mend", task.rig)
    folder = task.folder / f"mended_{rig.name}"
    found = closed_loop(rig, built(task, rig), "missing", max(SIZES), rng, folder)
    row: dict[str, Any] = {"effects": [effect.id for effect in found.effects], "sentence": found.sentence}
    if not found.effects:
        return row
    sources = [folder / found.modelica_path, *([rig.reference] if isinstance(rig.reference, Path) else [])]
    load_model(found.model, sources=sources, folder=folder)
    right = [e for e in found.effects if e.id.partition("@")[0] == rig.law_name]
    return row | {
        "model": str(folder / f"{found.model.rpartition('.')[2]}.fmu"),
        "added": {p.name: [found[p.name].value, p.lower, p.upper, p.scale] for p in found.added},
        "law": [p.name for e in right[:1] for p in e.parameters],
    }


def repetition(task: Repetition, rig: Rig) -> dict[str, Any]:
    """Compute intervals of all methods on one recording, beside what they should hold."""
    rng = generator(task.seed, RECORDED.get(task.state, task.state), task.rig, task.number)
    measured, _ = rig.record(RECORDED.get(task.state, task.state), task.size, rng)
    model = built(task, rig)
    parameters = rig.parameters(model)
    if task.extended is not None:
        model, parameters = Model.load(task.extended.model), parameters.extended(task.extended.parameters())
    found = fit(measured, model, parameters=parameters, settings=settings_of(rig), workers=0)
    white = found
    if any(noise.kind != "white" for noise in found.noise.values()):
        white = fit(measured, model, parameters=parameters, settings=settings_of(rig, "white"), workers=0)
    row: dict[str, Any] = {"targets": dict(task.targets)}
    methods: dict[str, Mapping[str, Intervals]] = {}
    if task.sampled:
        methods["mcmc_white"] = white_posterior_intervals(white, rng)
        if task.number < PREDICTING * SAMPLED_EVERY:
            posterior = sample(found, settings=SHORT, seed=int(rng.integers(2**31)), workers=0)
            methods["posterior"] = intervals_of_draws(posterior)
            again, _ = rig.record(RECORDED.get(task.state, task.state), task.size, rng)
            row["bands"] = posterior.predict(replace(again, name="unseen")).coverage
    else:
        methods |= {"ours": intervals_of_fit(found), "curve_fit": least_squares_intervals(white)}
        row["error_of_model"] = [o for o, noise in found.noise.items() if noise.model_error]
    shown = {m: {n: i.to_list() for n, i in by.items() if n in task.targets} for m, by in methods.items()}
    return row | {"methods": shown}


def tasks_of(
    seed: int, folder: Path, count: int, best: Mapping[str, Any], mended: Mapping[str, Any]
) -> list[Repetition]:
    """List all repetitions, states and rigs interleaved so that a partial run says something of each.

    Sampled ones last.
    """
    tasks = []
    for number in range(count):
        for state in STATES:
            for name, rig in rigs().items():
                size = SIZES[number % len(SIZES)]
                targets, extended = dict(rig.truth), None
                if state == "mended":
                    found = mended.get(name, {})
                    if "model" not in found:
                        continue
                    extended = Extended(found["model"], found["added"])
                    targets |= dict(zip(found["law"], rig.law(size).values(), strict=False))
                elif state != "right":
                    row = best.get(f"{seed}/best/{name}/{state}/{size:g}", {})
                    if "values" not in row:
                        continue
                    targets = row["values"]
                one = Repetition(seed, name, state, number, folder, targets, extended=extended)
                tasks += [one, replace(one, sampled=True)] if number % SAMPLED_EVERY == 0 else [one]
    return sorted(tasks, key=lambda task: task.sampled)


def summarise(
    rows: Sequence[Mapping[str, Any]], mended: Mapping[str, Any], seeds: Mapping[str, int], best_rows: int
) -> dict[str, Any]:
    """Summarise the study as its contract has it, with tables by state and rig."""
    good = [row for row in rows if "methods" in row]
    for row in good:
        row["state"], row["rig"], row["number"] = row["key"].split("/")[1:4]  # type: ignore[index]
    states = {state: summary_of([row for row in good if row["state"] == state]) for state in STATES}
    names = sorted({row["rig"] for row in good})
    table = [
        {"state": state, "rig": rig, **summary_of([r for r in good if r["state"] == state and r["rig"] == rig])}
        for state in STATES for rig in names
    ]  # fmt: skip
    bands = {s: [v for r in good if r["state"] == s for v in r.get("bands", {}).values()] for s in STATES}
    every = [v for values in bands.values() for v in values]
    return {
        "states": states,
        "bands_90": float(np.mean(every)) if every else None,
        "bands_90_by_state": {s: float(np.mean(v)) if v else None for s, v in bands.items()},
        "seeds": dict(seeds),
        "by_rig": table,
        "mended_by": {name: row.get("effects", []) for name, row in mended.items()},
        "failed": sorted({str(row["error"]) for row in rows if "error" in row}),
        "repetitions": len(rows),
        "best_values": best_rows,
        "cpu_seconds": round(sum(float(row.get("seconds", 0.0)) for row in rows), 1),
        "code": code(),
    }


def summary_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Summarise shares held and relative widths over rigs, and how often a residual is no noise."""
    plain = [row for row in rows if "error_of_model" in row]
    found: dict[str, Any] = {"recordings": len(plain)}
    for method in METHODS:
        by_rig = [
            of_rig([row for row in rows if row["rig"] == rig and method in row["methods"]], method)
            for rig in sorted({row["rig"] for row in rows})
        ]
        shares = [share for share in by_rig if share]
        if shares:
            found[method] = {key: float(np.mean([share[key] for share in shares])) for key in ("50", "90", "width_90")}
            found[method]["recordings"] = sum(share["recordings"] for share in shares)
    found["error_of_model"] = float(np.mean([bool(row["error_of_model"]) for row in plain])) if plain else None
    return found


def of_rig(rows: Sequence[Mapping[str, Any]], method: str) -> dict[str, Any]:
    """Average over the parameters of one rig; empty where there is nothing to compare.

    Recordings with different sizes of what is missing have different errors: widths are compared within each size.
    """
    held, widths = [], []
    groups: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for row in rows:
        for name, (estimate, low_50, high_50, low_90, high_90) in row["methods"][method].items():
            target = row["targets"][name]
            held.append((low_50 < target < high_50, low_90 < target < high_90))
            groups.setdefault((name, int(row["number"]) % len(SIZES)), []).append((high_90 - low_90, estimate - target))
    for pairs in groups.values():
        width, error = np.array(pairs).T
        if len(pairs) > 1:
            widths.append(float(width.mean() / (2.0 * HALF_90 * np.sqrt(np.mean(error**2)))))
    if not widths:
        return {}
    half, most = np.mean(held, axis=0).tolist()
    return {"50": half, "90": most, "width_90": float(np.mean(widths)), "recordings": len(rows)}


def main() -> None:
    parser = trial_parser(__doc__, stop_after=14.0)
    parser.add_argument("--recordings", type=int, default=RECORDINGS, help="of each rig in each state")
    options = parser.parse_args()
    seed = DEVELOPMENT if options.development else REPORT
    folder = (options.out / "coverage_wrong").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    for name, rig in rigs().items():
        if not (folder / f"{name}.fmu").exists():
            load_model(rig.reference, folder=folder / name).path.replace(folder / f"{name}.fmu")
    first: list[Best | Mend] = [Mend(seed, name, folder) for name in rigs()]
    first += [
        Best(seed, name, state, size, folder)
        for name in rigs() for state in ("missing", "unlisted", "process_noise") for size in SIZES
    ]  # fmt: skip
    made = {row["key"]: row for row in run_study(first, attempt, folder / "rows.sqlite", options)}
    mended = {name: made.get(f"{seed}/mend/{name}", {}) for name in rigs()}
    tasks = tasks_of(seed, folder, options.recordings, made, mended)
    rows = run_study(tasks, attempt, folder / "rows.sqlite", options)
    seeds = {"report": REPORT, "development": DEVELOPMENT, "used": seed}
    result = summarise(rows, mended, seeds, sum("values" in row for row in made.values()))
    result["failed"] += sorted({str(row["error"]) for row in made.values() if "error" in row})
    write_summary(result, options.out / "coverage_wrong.json")
    write_page(options.out / "coverage_wrong.html", TITLE, parts(result))
    print(json.dumps({k: v for k, v in result.items() if k != "by_rig"}, indent=1))


if __name__ == "__main__":
    main()

"""Do intervals hold what they promise where the model is right? Simulation-based calibration on repeated experiments.

Every trial draws the truth from the prior, records it with a simulator that shares no code with the model's, fits,
samples, and asks where the truth ranks in the posterior. If inference is right the ranks are uniform and an interval of
90 % holds the truth in 90 % of the trials (Talts et al., 2018, arXiv:1804.06788).

The rigs' levels of input and noise are drawn anew in each repetition. A rig is recorded in one of four states: nothing
is missing (``right``), a law of the library is missing (``missing``), an effect acts that no library lists
(``unlisted``), or a random force drives a state (``process_noise``).
"""

from __future__ import annotations

import tempfile
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.random import Generator
from scipy.stats import kstest

import aero_bayes
from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.noise import NoiseModel
from aero_bayes.estimate.parameters import ParameterSpec
from aero_bayes.estimate.priors import LogNormal
from simulated_rigs.kinds import KINDS
from simulated_rigs.rig import RigKind
from simulated_rigs.sensors import SensorNoise
from simulated_rigs.trial import MODELS
from simulated_rigs.truth import LawPlace, LawTruth, assembled
from study.study import Row, Study, Tasks, Told, keyed, number, percent

#: Shortest and longest time for which a level is held, in units of the rig's clock.
DWELL = (0.2, 1.2)
#: How long a rig rests before a recording begins, as a share of the recording, so that it starts at its own rest.
SETTLING = 0.25
#: How far true values lie from those of the data sheet, and how far an engineer trusts it: a share.
SPREAD = 0.15
#: Standard deviation of white noise over that of the output.
NOISE = 0.01


@dataclass(frozen=True)
class RepeatedRig:
    """A kind of rig, and what may be missing from its model: at size 1, the first parameter of a law is its size.

    ``pushed`` is the state that a random force drives, ``push`` the square root of that force's spectral density.
    """

    kind: RigKind
    missing: LawTruth
    unlisted: LawTruth
    pushed: str
    push: float

    def draw(self, rng: Generator) -> dict[str, float]:
        """Draw true values of the free parameters from the priors of a fit."""
        values = self.kind.parameters
        return {name: values[name] * float(np.exp(SPREAD * rng.standard_normal())) for name in self.kind.free}

    def law(self, state: str, size: float) -> LawTruth:
        """Return what is missing in a state."""
        law = self.missing if state == "missing" else self.unlisted
        first = next(iter(law.parameters))
        return replace(law, parameters={**law.parameters, first: size * law.parameters[first]})

    def record(
        self, truth: Mapping[str, float], rng: Generator, name: str, *,
        state: str = "right", size: float = 1.0, times: float = 1.0, correlated: bool = False,
    ) -> Recording:  # fmt: skip
        """Repeat the experiment, ``times`` as long as usual."""
        kind, parameters = self.kind, {**self.kind.parameters, **truth}
        lead = round(SETTLING * kind.rows)
        time: FloatArray = kind.step * np.arange(-lead, round(times * (kind.rows - 1)) + 1, dtype=np.float64)
        commands = np.column_stack(
            [drive.centre + drive.height * levels(rng, time / drive.clock) for drive in kind.inputs.values()]
        )
        rig = assembled(kind, parameters, [self.law(state, size)] if state in ("missing", "unlisted") else [])
        if state == "process_noise":
            rig.push(self.pushed, white_force(rng, size * self.push, time))
        outputs, _ = rig.run(time, commands, kind.rest(parameters))
        time, readings = time[lead:], {}
        for k, output in enumerate(kind.outputs):
            clean = outputs[lead:, k]
            readings[output] = clean + noise(rng, float(np.std(clean)), kind.step, correlated).sample(rng, time)
        inputs = {column: commands[lead:, k] for k, column in enumerate(kind.inputs)}
        return Recording(name, time, inputs, readings, kind.units)

    def build(self, folder: Path) -> aero_bayes.Model:
        """Compile the model, which lacks whatever is missing."""
        return aero_bayes.load_model(self.model_name, sources=[self.source], folder=folder)

    @property
    def source(self) -> Path:
        """The Modelica file."""
        return MODELS / self.kind.name / "Rig.mo"

    @property
    def model_name(self) -> str:
        """The Modelica class."""
        return "Rig.Plant" if "model Plant" in self.source.read_text(encoding="utf-8") else "Rig"

    def fit(
        self, recordings: list[Recording], model: aero_bayes.Model, noise: Literal["auto", "white"] = "auto",
        starts: Mapping[str, float] | None = None,
    ) -> aero_bayes.Fit:  # fmt: skip
        """Fit the free parameters under their priors, and others from ``starts``, by a local search."""
        wishes = {name: ParameterSpec(start=value) for name, value in (starts or {}).items()}
        for name in self.kind.free:
            value = self.kind.parameters[name]
            wishes[name] = ParameterSpec(start=value, prior=LogNormal(value, SPREAD))
        calibration = CalibrationSettings(initial_states="estimated")
        settings = FitSettings(method="local", calibration=calibration, noise=NoiseModel(default=noise))
        return aero_bayes.fit(recordings, model, parameters=wishes, settings=settings, workers=0)


def levels(rng: Generator, time: FloatArray) -> FloatArray:
    """Draw random levels within ±1 over time (n,) in units of the clock; zero before it and for the first half unit."""
    edges = 0.5 + np.concatenate([[0.0], np.cumsum(rng.uniform(*DWELL, int(time[-1] / DWELL[0]) + 2))])
    values = np.concatenate([[0.0], rng.uniform(-1.0, 1.0, edges.size)])
    found: FloatArray = values[np.searchsorted(edges, time, side="right")]
    return found


def noise(rng: Generator, spread: float, step: float, correlated: bool) -> SensorNoise:
    """Draw the noise of an output: white, and with a part that is correlated over 3 to 25 samples if asked for."""
    white = NOISE * spread
    slow, samples = white * float(np.exp(rng.uniform(np.log(0.5), np.log(3.0)))), float(rng.uniform(3.0, 25.0))
    return SensorNoise(white, slow, samples * step) if correlated else SensorNoise(white)


def white_force(rng: Generator, density: float, time: FloatArray) -> FloatArray:
    """Draw white noise to be held over each sample interval; ``density`` is the root of the spectral density."""
    return np.asarray(density / np.sqrt(float(time[1] - time[0])) * rng.standard_normal(time.size))


def coarser(kind: RigKind, factor: int, **changes: object) -> RigKind:
    """Return the same rig read so many times less often, over the same time."""
    rows = (kind.rows - 1) // factor + 1
    return replace(kind, step=factor * kind.step, rows=rows, **changes)  # type: ignore[arg-type]


def repeated_rigs() -> dict[str, RepeatedRig]:
    """Make the rigs by name."""
    drive = {"tau": replace(KINDS["pendulum"].inputs["tau"], height=0.3)}
    swinging = RepeatedRig(
        coarser(KINDS["pendulum"], 3, inputs=drive),
        LawTruth("coulomb_friction", LawPlace("balance", "omega"), {"F_c": 4e-3}),
        LawTruth("cogging", LawPlace("balance", "omega"), {"a": 8e-3, "pitch": 0.25}),
        "omega",
        2e-3,
    )
    motor = RepeatedRig(
        coarser(KINDS["motor"], 3),
        LawTruth("coulomb_friction", LawPlace("balance", "w"), {"F_c": 4e-3}),
        LawTruth("wave", LawPlace("input", "V"), {"a": 0.1, "p": 5.0}),
        "w",
        4e-4,
    )
    reservoirs = RepeatedRig(
        coarser(KINDS["reservoirs"], 3),
        LawTruth("square_loss", LawPlace("balance", "second.h"), {"k": 5e-5}),
        LawTruth("vibration", LawPlace("balance", "first.h"), {"a": 2e-5, "T": 120.0, "phase": 0.3}),
        "first.h",
        3e-5,
    )
    return {rig.kind.name: rig for rig in (swinging, motor, reservoirs)}


#: Kinds of noise, and how many recordings are fitted together in every trial.
NOISES, RECORDINGS = ("white", "correlated"), (1, 2)
#: Trials of each rig, noise and number of recordings.
COUNT = 35
SETTINGS = aero_bayes.SampleSettings(ess=400.0, max_steps=1000, max_minutes=2.0, predictive=0)


def tasks(options: Namespace) -> Tasks:
    """List all trials, cells in turn."""
    cells = product(range(COUNT), repeated_rigs(), NOISES, RECORDINGS)
    return keyed((options.seed, rig, noise, recordings, number) for number, rig, noise, recordings in cells)


def attempt(task: tuple[int, str, str, int, int]) -> Row:
    """Rank the truth in the posterior; everything random follows from the task."""
    seed, name, noise, recordings, number = task
    rig = repeated_rigs()[name]
    rng = np.random.default_rng([seed, number, *name.encode(), NOISES.index(noise), recordings])
    truth = rig.draw(rng)
    made = [rig.record(truth, rng, f"r{k}", correlated=noise == "correlated") for k in range(recordings)]
    with tempfile.TemporaryDirectory(prefix="coverage-") as folder:
        fit = rig.fit(made, rig.build(Path(folder)))
        posterior = aero_bayes.sample(fit, settings=SETTINGS, seed=int(rng.integers(2**31)), workers=0)
    known = [name for name in truth if posterior.parameters[name].q05 is not None]
    return {
        "ranks": {name: float(np.mean(posterior.samples(name) < truth[name])) for name in known},
        "noise_found": {output: noise.kind for output, noise in fit.noise.items()},
        "warned": len(fit.warnings),
    }


def summary(rows: Sequence[Row]) -> Row:
    """Return the shares within the intervals by kind of noise, and how uniform ranks are by rig and parameter."""
    cells: dict[tuple[str, str, str], list[float]] = {}
    good = [row for row in rows if "ranks" in row]
    for row in good:
        _, rig, noise, _, _ = row["key"].split("/")
        for name, rank in row["ranks"].items():
            cells.setdefault((noise, rig, name), []).append(rank)
    every = {noise: [r for cell, ranks in cells.items() if cell[0] == noise for r in ranks] for noise in NOISES}
    return {
        "recordings": sum(int(row["key"].split("/")[3]) for row in good),
        "failed": len(rows) - len(good),
        "noises": {noise: held(ranks) for noise, ranks in every.items()},
        "cells": [[*cell, held(ranks)] for cell, ranks in cells.items()],
    }


def held(ranks: Sequence[float]) -> Row:
    """Return the shares of ranks (n,) within central intervals, and how probable ranks less uniform are."""
    if not ranks:
        return {"50": None, "90": None, "p": None, "count": 0}
    away, p = np.abs(np.array(ranks) - 0.5), float(kstest(ranks, "uniform").pvalue)
    return {"50": float(np.mean(away < 0.25)), "90": float(np.mean(away < 0.45)), "p": p, "count": len(ranks)}


#: Columns of the tables of both studies of intervals.
HEAD = (
    "state", "number", "50 % hold (goal 50 %)", "90 % hold (goal 85 to 95 %)", "width (goal ≤ 1.5)",
    "least squares: 90 %",
)  # fmt: skip


def table(found: Mapping[str, Any]) -> Told:
    """Write what the intervals hold."""
    p = [of["p"] for *_, of in found["cells"]]
    text = (
        f"{found['recordings']} recordings, {found['failed']} trials failed. The least of {len(p)} p-values of uniform "
        f"ranks is {number(min(p, default=None))} (about {1 / max(len(p) + 1, 2):.2g} if all is well)."
    )
    lines: list[tuple[object, ...]] = [
        (f"the model is right, {noise} noise", of["count"], percent(of["50"]), percent(of["90"]), "", "")
        for noise, of in found["noises"].items()
    ]
    return text, lines


STUDY = Study(
    "coverage",
    "Intervals where the model is right: they should hold the truth, which is drawn from the prior.",
    tasks, attempt, summary, table, HEAD, minutes=18.5,
)  # fmt: skip

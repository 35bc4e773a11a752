"""Rigs whose experiment is repeated: simulated, with levels of their inputs and noise drawn anew each time.

A rig is recorded in one of four states: nothing is missing (``right``), a law of the library is missing (``missing``),
an effect acts that no library lists (``unlisted``), or a random force drives a state (``process_noise``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.random import Generator

import aero_bayes
from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.noise import NoiseModel
from aero_bayes.estimate.parameters import Override
from aero_bayes.estimate.priors import LogNormal
from simulated_rigs import MODELS, LawPlace, LawTruth
from simulated_rigs.kinds import KINDS
from simulated_rigs.rig import RigKind
from simulated_rigs.sensors import SensorNoise
from simulated_rigs.truth import assembled

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
        return Recording(name, time, inputs, readings, {"time": "s", **kind.units})

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
        wishes = {name: Override(start=value) for name, value in (starts or {}).items()}
        for name in self.kind.free:
            value = self.kind.parameters[name]
            wishes[name] = Override(start=value, prior=LogNormal(value, SPREAD))
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

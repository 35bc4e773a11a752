"""Rigs whose model is right, or wrong in a known way: the simulated AERO and three rigs of the many-rig trial.

A rig is recorded in one of four states: nothing is missing (``right``), a law of the library is missing (``missing``),
an effect acts that no library lists (``unlisted``), or a random force drives a state (``process_noise``). What is
missing has one of two sizes. All recordings of a rig are repetitions of one experiment: levels drawn at random, each
held for a random time, are drawn anew each time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.random import Generator

import simulated_rigs.aero as bench
from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording
from aero_bayes.default_model import DEFAULT_MODEL
from aero_bayes.estimate import CalibrationSettings, ParameterSet, declared_overrides, parameters_from_model
from aero_bayes.estimate.parameters import Override
from aero_bayes.simulation import Model
from simulated_rigs import MODELS
from simulated_rigs.kinds import KINDS, RigKind
from simulated_rigs.sensors import SensorNoise
from simulated_rigs.truth import LawPlace, LawTruth, assembled

One = TypeVar("One", bench.EffectTruth, LawTruth)

#: Factors of the size of what is missing.
SIZES = (1.0, 3.0)
#: Shortest and longest time for which a level is held, in units of the rig's clock.
DWELL = (0.2, 1.2)
#: How long a rig rests before a recording begins, as a share of the recording, so that it starts at its own rest.
SETTLING = 0.25


@dataclass(frozen=True)
class Aero:
    """The simulated AERO with white reading noise, and what an engineer knows of it.

    Its methods are those of every :data:`Rig`: ``reference`` is the model as given, without what may be missing;
    ``parameters`` are fitted from the true values, since that the search finds the optimum is not in question here;
    ``law`` are the true parameters of the law that may be missing, by the names that they have in the library;
    ``record`` repeats the experiment, ``times`` as long as usual, as it is read and without reading noise.

    Parameters
    ----------
    truth : mapping of str to float
        Values of the parameters that are fitted.
    missing, unlisted : EffectTruth
        At size 1; the first parameter of an effect is its size.
    torque : float
        Random torque on the body at size 1, the square root of its spectral density in N m s^0.5.
    duration, rate_hz : float
    calibration : CalibrationSettings
    """

    truth: Mapping[str, float]
    missing: bench.EffectTruth
    unlisted: bench.EffectTruth
    torque: float
    duration: float = 120.0
    rate_hz: float = 20.0
    calibration: CalibrationSettings = field(
        default_factory=lambda: CalibrationSettings(delay="free", max_input_delay=0.02)
    )

    @property
    def name(self) -> str:
        return "aero"

    @property
    def reference(self) -> str | Path:
        return DEFAULT_MODEL

    @property
    def law_name(self) -> str:
        return self.missing.id

    def parameters(self, model: Model) -> ParameterSet:
        declared = declared_overrides(model)
        return parameters_from_model(
            model, overrides={name: replace(declared[name], start=value) for name, value in self.truth.items()}
        )

    def law(self, size: float) -> Mapping[str, float]:
        return scaled(self.missing, size).parameters

    def record(self, state: str, size: float, rng: Generator, *, times: float = 1.0) -> tuple[Recording, Recording]:
        time = bench.even_times(times * self.duration, self.rate_hz)
        effects: tuple[bench.EffectTruth, ...] = ()
        torque = None
        if state in ("missing", "unlisted"):
            effects = (scaled(self.missing if state == "missing" else self.unlisted, size),)
        elif state == "process_noise":
            torque = white_force(rng, size * self.torque, time)
        truth = bench.Truth("one_dof", replace(bench.Parameters(), **self.truth), effects, 5e-3)
        run = bench.simulate_truth(truth, Held(time, 24.0 * levels(rng, time)), time, torque=torque)
        measured, silent = (bench.measure(run, sensors, rng, self.name) for sensors in (bench.white(), bench.clean()))
        return measured, silent


@dataclass(frozen=True)
class TrialRig:
    """A rig of the many-rig trial.

    Parameters
    ----------
    kind : RigKind
    truth : mapping of str to float
    missing, unlisted : LawTruth
        At size 1; the first parameter of a law is its size.
    pushed, push : str, float
        The state that a random force drives, and the square root of that force's spectral density at size 1.
    noise : mapping of str to SensorNoise
    calibration : CalibrationSettings
    """

    kind: RigKind
    truth: Mapping[str, float]
    missing: LawTruth
    unlisted: LawTruth
    pushed: str
    push: float
    noise: Mapping[str, SensorNoise]
    calibration: CalibrationSettings = field(default_factory=lambda: CalibrationSettings(initial_states="estimated"))

    @property
    def name(self) -> str:
        return self.kind.name

    @property
    def reference(self) -> str | Path:
        return MODELS / self.name / "Rig.mo"

    @property
    def law_name(self) -> str:
        return self.missing.law

    def parameters(self, model: Model) -> ParameterSet:
        starts = {name: Override(start=value) for name, value in self.truth.items()}
        return parameters_from_model(model, tuple(starts), starts)

    def law(self, size: float) -> Mapping[str, float]:
        return scaled(self.missing, size).parameters

    def record(self, state: str, size: float, rng: Generator, *, times: float = 1.0) -> tuple[Recording, Recording]:
        kind, parameters = self.kind, {**self.kind.parameters, **self.truth}
        lead = round(SETTLING * kind.rows)
        time: FloatArray = np.arange(-lead, round(times * (kind.rows - 1)) + 1) * kind.step
        driven = [drive.height * levels(rng, np.maximum(time, 0.0) / drive.clock) for drive in kind.inputs.values()]
        commands = np.array([drive.centre for drive in kind.inputs.values()]) + np.column_stack(driven)
        laws = {"missing": [self.missing], "unlisted": [self.unlisted]}.get(state, [])
        rig = assembled(kind, parameters, [scaled(law, size) for law in laws])
        if state == "process_noise":
            rig.push(self.pushed, white_force(rng, size * self.push, time))
        outputs, _ = rig.run(time, commands, kind.rest(parameters))
        time = time[lead:]
        inputs = {name: commands[lead:, k] for k, name in enumerate(kind.inputs)}
        clean = {name: outputs[lead:, k] for k, name in enumerate(kind.outputs)}
        silent = Recording(self.name, time, inputs, clean, {"time": "s", **kind.units})
        still = np.zeros(time.size)
        noisy = {name: y + self.noise[name].sample(rng, time, still, still) for name, y in clean.items()}
        return replace(silent, outputs=noisy), silent


Rig = Aero | TrialRig


@dataclass(frozen=True)
class Held:
    """An input that holds each of its values to the next sample."""

    time: FloatArray
    values: FloatArray

    def volts(self, time: FloatArray) -> FloatArray:
        index = np.searchsorted(self.time, time + 1e-9, side="right") - 1
        found: FloatArray = self.values[np.maximum(index, 0)]
        return found


def levels(rng: Generator, time: FloatArray) -> FloatArray:
    """Draw random levels within +-1 over time (n,) in units of the clock; zero for the first half unit."""
    # random_levels() rests for the last sixth of its duration: what is used ends before.
    return bench.random_levels(rng, 1.0, 1.3 * float(time[-1]) + 5.0, DWELL, 0.5).volts(time)


def scaled(one: One, size: float) -> One:
    """Return the same effect or law with its first parameter ``size`` times as large."""
    first = next(iter(one.parameters))
    return replace(one, parameters={**one.parameters, first: size * one.parameters[first]})


def white_force(rng: Generator, density: float, time: FloatArray) -> FloatArray:
    """Draw white noise to be held over each sample interval; ``density`` is the root of the spectral density."""
    return density / np.sqrt(float(time[1] - time[0])) * rng.standard_normal(time.size)


def coarser(kind: RigKind, factor: int, **changes: object) -> RigKind:
    """Return the same rig read so many times less often, over the same time."""
    return replace(kind, step=factor * kind.step, rows=(kind.rows - 1) // factor + 1, **changes)


def rigs() -> dict[str, Rig]:
    """Make the four rigs by name."""
    aero = Aero(
        {"R_a": 9.0, "c_m": 0.040, "J_r": 4.4e-6, "k_d": 2.7e-8, "k_t": 3.1e-7, "D_p": 0.0065, "K_sp": 0.041},
        bench.effect("pivot_coulomb_friction", tau_c=2.5e-4),
        bench.effect("propeller_stall", s=2e-4),
        torque=1e-4,
    )
    pendulum = KINDS["pendulum"]
    drive = {"tau": replace(pendulum.inputs["tau"], height=0.3)}
    swinging = TrialRig(
        coarser(pendulum, 3, inputs=drive),
        {"J": 0.06, "D": 0.05, "G": 1.05},
        LawTruth("coulomb_friction", LawPlace("balance", "omega"), {"F_c": 4e-3}),
        LawTruth("cogging", LawPlace("balance", "omega"), {"a": 8e-3, "pitch": 0.25}, named=False),
        "omega",
        2e-3,
        {"angle": SensorNoise(2e-3)},
    )
    motor = TrialRig(
        coarser(KINDS["motor"], 3),
        {"R": 2.4, "L": 0.017, "k_m": 0.072, "J": 2.3e-4, "d": 2.4e-4},
        LawTruth("coulomb_friction", LawPlace("balance", "w"), {"F_c": 4e-3}),
        LawTruth("wave", LawPlace("input", "V"), {"a": 0.1, "p": 5.0}, named=False),
        "w",
        4e-4,
        {"current": SensorNoise(0.02, 0.01, 0.01), "speed": SensorNoise(0.5, 0.3, 0.01)},
    )
    reservoirs = TrialRig(
        coarser(KINDS["reservoirs"], 3),
        {"first.A": 0.023, "second.A": 0.036, "pipe.c": 4.4e-4, "outlet.c": 2.7e-4},
        LawTruth("square_loss", LawPlace("balance", "second.h"), {"k": 5e-5}),
        LawTruth("vibration", LawPlace("balance", "first.h"), {"a": 2e-5, "T": 120.0, "phase": 0.3}, named=False),
        "first.h",
        3e-5,
        {"level_1": SensorNoise(4e-3), "level_2": SensorNoise(2e-3)},
    )
    return {rig.name: rig for rig in (aero, swinging, motor, reservoirs)}

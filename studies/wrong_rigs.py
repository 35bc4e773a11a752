"""Rigs whose model is right or wrong in a known way: the simulated AERO and three rigs of the many-rig trial.

A rig is recorded in a state: nothing is missing (``right``), a law of the library is missing (``missing``), something
acts that no law describes (``unlisted``), or a random force drives a state (``process_noise``). What is missing has one
of two sizes. Every recording of a rig has the same design: levels drawn at random, each held for a random time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from aero_bayes import bench
from aero_bayes.bench.rigs.assembly import Assembly
from aero_bayes.bench.rigs.kinds import KINDS, RigKind
from aero_bayes.bench.rigs.truth import LawTruth, Place, law_kind
from aero_bayes.bench.sensors import Noise
from aero_bayes.data import Recording

FloatArray = NDArray[np.float64]
One = TypeVar("One", bench.EffectTruth, LawTruth)

#: What may be wrong with a model, as a recording is made.
RECORDED = ("right", "missing", "unlisted", "process_noise")
#: Factors of the size of what is missing.
SIZES = (1.0, 3.0)
#: Shortest and longest time for which a level is held, in units of the rig's clock.
DWELL = (0.2, 1.2)


class WrongRig(Protocol):
    """A rig that can be recorded in every state."""

    name: str
    truth: Mapping[str, float]

    def record(self, state: str, size: float, rng: Generator, *, times: float = 1.0) -> tuple[Recording, Recording]:
        """A recording of the rig's design, ``times`` as long as usual, with and without reading noise."""
        ...

    def law(self, size: float) -> Mapping[str, float]:
        """True parameters of the law that is missing, named as in the extended model."""
        ...


def levels(rng: Generator, time: FloatArray) -> FloatArray:
    """Levels within +-1 at times in units of the clock, zero for the first half unit, shape (n,)."""
    # random_levels() rests during the last sixth: what is used ends before.
    return bench.random_levels(rng, 1.0, 1.3 * float(time[-1]) + 5.0, DWELL, 0.5).volts(time)


@dataclass(frozen=True)
class Aero:
    """The simulated AERO with white reading noise.

    Parameters
    ----------
    truth : mapping of str to float
        Parameters that differ from the data sheet.
    missing, unlisted : EffectTruth
        At size 1; the first parameter of an effect is its size.
    torque : float
        Spectral density (N m s^0.5) of the random torque on the body, at size 1.
    duration, rate_hz : float
    """

    truth: Mapping[str, float]
    missing: bench.EffectTruth
    unlisted: bench.EffectTruth
    torque: float
    duration: float = 120.0
    rate_hz: float = 25.0
    name: str = "aero"

    def record(self, state: str, size: float, rng: Generator, *, times: float = 1.0) -> tuple[Recording, Recording]:
        time = bench.sample_times(times * self.duration, self.rate_hz)
        effect = {"missing": self.missing, "unlisted": self.unlisted}.get(state)
        effects = () if effect is None else (scaled(effect, size),)
        truth = bench.Truth("one_dof", replace(bench.Parameters(), **self.truth), effects, 5e-3)
        push = None
        if state == "process_noise":
            push = white_force(rng, size * self.torque, time)
        design = Held(time, 24.0 * levels(rng, time))
        run = bench.simulate(truth, design, time, push=push)
        silent = bench.measure(run, bench.clean(), rng, self.name)
        return bench.measure(run, bench.white(), rng, self.name), silent

    def law(self, size: float) -> Mapping[str, float]:
        return scaled(self.missing, size).parameters


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
        The state that a random force drives, and the spectral density of that force (its unit times s^0.5) at size 1.
    noise : mapping of str to Noise
    """

    kind: RigKind
    truth: Mapping[str, float]
    missing: LawTruth
    unlisted: LawTruth
    pushed: str
    push: float
    noise: Mapping[str, Noise]

    @property
    def name(self) -> str:
        return self.kind.name

    def record(self, state: str, size: float, rng: Generator, *, times: float = 1.0) -> tuple[Recording, Recording]:
        kind, parameters = self.kind, {**self.kind.parameters, **self.truth}
        time: FloatArray = np.arange(round(times * (kind.rows - 1)) + 1) * kind.step
        commands = np.column_stack(
            [d.centre + d.height * levels(rng, time / d.clock) for d in kind.inputs.values()]
        )
        rig = kind.assemble(parameters)
        law = {"missing": self.missing, "unlisted": self.unlisted}.get(state)
        if law is not None:
            slack = 1e-9 * dict(zip(kind.states, kind.sizes, strict=True)).get(law.place.name, 1.0)
            law_kind(kind, law.law, law.place).install(rig, law.place.name, scaled(law, size).parameters, slack)
        if state == "process_noise":
            drive(rig, self.pushed, white_force(rng, size * self.push, time))
        outputs, _ = rig.run(time, commands, kind.rest(parameters), kind.step / kind.pieces)
        inputs = {name: commands[:, k] for k, name in enumerate(kind.inputs)}
        clean = {name: outputs[:, k] for k, name in enumerate(kind.outputs)}
        silent = Recording(kind.name, time, inputs, clean, {"time": "s", **kind.units})
        nothing = np.zeros(time.size)
        noisy = {name: y + self.noise[name].sample(rng, time, nothing, nothing) for name, y in clean.items()}
        return replace(silent, outputs=noisy), silent

    def law(self, size: float) -> Mapping[str, float]:
        return scaled(self.missing, size).parameters


@dataclass(frozen=True)
class Held:
    """An input that holds each value to the next sample."""

    time: FloatArray
    values: FloatArray

    def volts(self, time: FloatArray) -> FloatArray:
        index = np.searchsorted(self.time, time + 1e-9, side="right") - 1
        return self.values[np.maximum(index, 0)]


def scaled(one: One, size: float) -> One:
    """The same with its first parameter ``size`` times as large."""
    first = next(iter(one.parameters))
    return replace(one, parameters={**one.parameters, first: size * one.parameters[first]})


def white_force(rng: Generator, density: float, time: FloatArray) -> Callable[[float], float]:
    """White noise of a spectral density, held over each sample interval, as a function of time in s."""
    step = float(time[1] - time[0])
    values = (density / np.sqrt(step) * rng.standard_normal(time.size)).tolist()
    last, first = time.size - 1, float(time[0])
    return lambda t: values[min(max(int((t - first) / step), 0), last)]


def drive(rig: Assembly, state: str, push: Callable[[float], float]) -> None:
    """Let a force of time act on a state."""
    index = rig.state(state)

    def add(t: float, x: object, u: object, e: list[float]) -> None:
        e[index] += push(t)

    rig.term(add)


def rigs() -> dict[str, WrongRig]:
    """The four rigs by name."""
    aero = Aero(
        {"R_a": 9.0, "c_m": 0.040, "k_d": 2.7e-8, "k_t": 3.1e-7, "D_p": 0.0065, "K_sp": 0.041},
        bench.effect("pivot_coulomb_friction", tau_c=2.5e-4),
        bench.effect("propeller_stall", s=2e-4),
        torque=1e-4,
    )
    pendulum = TrialRig(
        KINDS["pendulum"],
        {"J": 0.06, "D": 0.05, "G": 1.05},
        LawTruth("coulomb_friction", Place("balance", "omega"), {"F_c": 4e-3}),
        LawTruth("cogging", Place("balance", "omega"), {"a": 8e-3, "pitch": 0.25}, named=False),
        "omega",
        2e-3,
        {"angle": Noise(3e-3)},
    )
    motor = TrialRig(
        KINDS["motor"],
        {"R": 2.4, "L": 0.017, "k_m": 0.072, "J": 2.3e-4, "d": 2.4e-4},
        LawTruth("coulomb_friction", Place("balance", "w"), {"F_c": 4e-3}),
        LawTruth("wave", Place("input", "V"), {"a": 0.1, "p": 5.0}, named=False),
        "w",
        4e-4,
        {"current": Noise(0.02, 0.01, 0.01), "speed": Noise(0.5, 0.3, 0.01)},
    )
    reservoirs = TrialRig(
        KINDS["reservoirs"],
        {"first.A": 0.023, "second.A": 0.036, "pipe.c": 4.4e-4, "outlet.c": 2.7e-4},
        LawTruth("square_loss", Place("balance", "second.h"), {"k": 5e-5}),
        LawTruth("vibration", Place("balance", "first.h"), {"a": 1e-5, "T": 300.0, "phase": 0.3}, named=False),
        "first.h",
        3e-5,
        {"level_1": Noise(4e-3), "level_2": Noise(2e-3)},
    )
    return {rig.name: rig for rig in (aero, pendulum, motor, reservoirs)}

"""Blind trials over many kinds of rigs, drawn at random; the truth stays apart from what the program is given."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp, log
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.random import Generator

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording, write_csv
from simulated_rigs.designs import Chirp, InputDesign, prbs, random_levels, random_multi_sine
from simulated_rigs.experiment import RigExperiment
from simulated_rigs.kinds import KINDS
from simulated_rigs.rig import RigKind
from simulated_rigs.sensors import SensorNoise, readings
from simulated_rigs.truth import LawTruth, law_places, outside_places, simulate_rig

What = Literal["law", "none", "pair", "outside"]
WHATS: tuple[What, ...] = ("law", "none", "pair", "outside")
#: First numbers of the seeds ``[base, kind, number]``: trials that methods may be tuned on, and those of the report.
DEVELOPMENT, REPORT = 11001, 17601
#: Folder of the kinds' Modelica models: ``NAME/Rig.mo`` and ``NAME/rig.toml``.
MODELS = Path(__file__).with_name("models")
#: True parameters are within this share of those in the Modelica file.
SPREAD = 0.3
#: Distances that sizes of laws are drawn for.
MIN_DISTANCE, MAX_DISTANCE = 2.0, 300.0
#: Standard deviation of the noise as a share of the signal's.
MIN_NOISE, MAX_NOISE = 2e-3, 2e-2
#: A law that no size makes this visible is another one under another name.
MIN_VISIBLE_DISTANCE = 1.0
#: Share of a recording at whose beginning nothing is driven yet.
UNDRIVEN_SHARE = 0.01


@dataclass(frozen=True)
class RigTrial:
    """A rig's recordings under the names of its first model, and what only the judge knows.

    ``noise_free`` are the recordings without noise, ``laws`` what the model lacks, ``parameters`` are named as in the
    Modelica model, ``starts`` the initial states of ``train`` and ``test``, ``noise`` is per output.
    """

    kind: RigKind
    train: Recording
    test: Recording
    noise_free: Mapping[str, Recording]
    laws: tuple[LawTruth, ...]
    parameters: Mapping[str, float]
    starts: Mapping[str, tuple[float, ...]]
    noise: Mapping[str, SensorNoise]

    @property
    def model(self) -> Path:
        """The Modelica file."""
        return MODELS / self.kind.name / "Rig.mo"

    @property
    def toml(self) -> Path:
        """The configuration that goes with it."""
        return self.model.with_name("rig.toml")


def draw_rig_trial(kind: str, number: int, base: int = DEVELOPMENT, what: What = "law") -> RigTrial:
    """Draw and simulate one trial; the same arguments always give the same numbers.

    ``base`` is the first number of the seed, :data:`DEVELOPMENT` or :data:`REPORT`. From the model one law of the
    library is missing, none, two at different places, or one outside the library.
    """
    rig = KINDS[kind]
    rng = np.random.default_rng((base, list(KINDS).index(kind), number, WHATS.index(what)))
    parameters = {
        name: value * (1.0 if name in rig.known else float(rng.uniform(1.0 - SPREAD, 1.0 + SPREAD)))
        for name, value in rig.parameters.items()
    }
    return make_trial(rig, rng, parameters, lambda rng, experiment: _laws(rng, what, experiment))


def make_trial(
    rig: RigKind,
    rng: Generator,
    parameters: Mapping[str, float],
    choose: Callable[[Generator, RigExperiment], Sequence[LawTruth]],
    noise: Mapping[str, SensorNoise] | None = None,
) -> RigTrial:
    """Record a rig of known parameters and choose what its model lacks.

    ``rng`` draws the experiments, and the noise if it is not given. ``choose`` says what the model lacks.
    """
    runs = ("train", "test")
    time: FloatArray = np.arange(rig.rows, dtype=np.float64) * rig.step
    commands = {run: _commands(rng, rig, time) for run in runs}
    starts = {run: _start(rng, rig, parameters) for run in runs}
    clean = simulate_rig(rig, parameters, [], time, commands["train"], starts["train"])
    noise = noise if noise is not None else draw_noise_levels(rng, rig, clean[0])
    laws = choose(rng, RigExperiment(rig, parameters, starts["train"], time, commands["train"], noise, clean))
    noise_free = {}
    for run in runs:
        outputs, _ = simulate_rig(rig, parameters, laws, time, commands[run], starts[run])
        inputs = dict(zip(rig.inputs, commands[run].T, strict=True))
        noise_free[run] = Recording(run, time, inputs, dict(zip(rig.outputs, outputs.T, strict=True)), rig.units)
    train, test = (
        replace(clean, outputs=readings(stream, time, clean.outputs, noise), sha256="")
        for stream, clean in zip(rng.spawn(2), noise_free.values(), strict=True)
    )
    return RigTrial(rig, train, test, noise_free, tuple(laws), dict(parameters), starts, noise)


def write_trial(trial: RigTrial, folder: Path) -> None:
    """Write ``Rig.mo``, ``rig.toml``, ``train.csv`` and ``test.csv``."""
    for path in (trial.model, trial.toml):
        shutil.copyfile(path, folder / path.name)
    for recording in (trial.train, trial.test):
        write_csv(recording, folder / f"{recording.name}.csv")


def _design(rng: Generator, duration: float) -> InputDesign:
    """Return a signal within -1 and 1; times in units of the rig's clock."""
    which = int(rng.integers(4))
    if which == 0:
        return random_levels(rng, 1.0, duration)
    if which == 1:
        return prbs(rng, 1.0, duration)
    if which == 2:
        return random_multi_sine(rng, 1.0, 0.03, 0.6)
    return Chirp(1.0, 0.02, 0.6, duration / 2.0)


def _commands(rng: Generator, kind: RigKind, time: FloatArray) -> FloatArray:
    columns = []
    for drive in kind.inputs.values():
        duration = float(time[-1]) / drive.clock
        height = drive.height * float(rng.uniform(0.7, 1.0))
        values = drive.centre + height * _design(rng, duration).volts(time / drive.clock)
        values[: max(2, round(UNDRIVEN_SHARE * time.size))] = drive.centre
        columns.append(values[np.arange(time.size) // kind.hold * kind.hold])
    return np.column_stack(columns)


def _start(rng: Generator, kind: RigKind, parameters: Mapping[str, float]) -> tuple[float, ...]:
    return tuple(
        at + state.shake * float(rng.uniform(-1.5, 1.5))
        for at, state in zip(kind.rest(parameters), kind.states.values(), strict=True)
    )


def draw_noise_levels(rng: Generator, kind: RigKind, outputs: FloatArray) -> dict[str, SensorNoise]:
    """Draw levels of white noise by output; in a third of the trials also noise correlated over 3 to 30 samples."""
    level = exp(float(rng.uniform(log(MIN_NOISE), log(MAX_NOISE))))
    correlated = rng.random() < 1.0 / 3.0
    noise = {}
    for k, name in enumerate(kind.outputs):
        white = level * float(np.std(outputs[:, k])) * float(rng.uniform(0.7, 1.4))
        slow, steps = white * float(rng.uniform(0.3, 1.0)), float(rng.uniform(3.0, 30.0))
        noise[name] = SensorNoise(white, slow, steps * kind.step) if correlated else SensorNoise(white)
    return noise


def _laws(rng: Generator, what: What, experiment: RigExperiment) -> list[LawTruth]:
    """Scale each of the laws asked for to a distance of its own, and measure them in each other's presence, too."""
    if what == "none":
        return []
    choices = outside_places(experiment.kind) if what == "outside" else law_places(experiment.kind)
    count, lowest = (2, 8.0) if what == "pair" else (1, 8.0 if what == "outside" else MIN_DISTANCE)
    chosen: list[LawTruth] = []
    for law, place in [choices[int(k)] for k in rng.permutation(len(choices))]:
        if any(place == one.place for one in chosen):
            continue
        target = exp(float(rng.uniform(log(lowest), log(MAX_DISTANCE))))
        found = experiment.law_at_distance(rng, law, place, target)
        if found is None or found.d < MIN_VISIBLE_DISTANCE:
            continue
        both = _together(experiment, [*chosen, found])
        if min(one.d for one in both) >= (lowest if chosen else MIN_VISIBLE_DISTANCE):
            chosen = both
        if len(chosen) == count:
            break
    return chosen


def _together(experiment: RigExperiment, laws: list[LawTruth]) -> list[LawTruth]:
    """Return the laws with the distance of each where the model knows the others."""
    if len(laws) == 1:
        return laws
    return [replace(one, d=experiment.distance(laws, [other for other in laws if other is not one])) for one in laws]

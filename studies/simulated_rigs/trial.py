"""Blind trials over many kinds of rigs, drawn at random; the truth stays apart from what the program is given."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import exp, isfinite, log
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.random import Generator

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording, write_csv
from aero_bayes.errors import InputError
from simulated_rigs.designs import Chirp, InputDesign, prbs, random_levels, random_multi_sine
from simulated_rigs.distance import RigExperiment
from simulated_rigs.kinds import KINDS, RigKind
from simulated_rigs.sensors import SensorNoise
from simulated_rigs.truth import LawPlace, LawTruth, law_kind, law_places, outside_places, scale_at, simulate_rig

CleanRun = tuple[FloatArray, FloatArray]
What = Literal["law", "none", "pair", "outside"]
WHATS: tuple[What, ...] = ("law", "none", "pair", "outside")
#: First numbers of the seeds ``[base, kind, number]``: trials that methods may be tuned on, and those of the report.
DEVELOPMENT, REPORT = 11001, 17601
#: Folder of the kinds' Modelica models: ``NAME/Rig.mo`` and ``NAME/rig.toml``.
MODELS = Path(__file__).with_name("models")
#: True parameters are within this share of those in the Modelica file.
SPREAD = 0.3
#: Distances that sizes of laws are drawn for, and how close is close enough.
MIN_DISTANCE, MAX_DISTANCE, DISTANCE_TOLERANCE = 2.0, 300.0, 0.15
#: Standard deviation of the noise as a share of the signal's.
MIN_NOISE, MAX_NOISE = 2e-3, 2e-2
#: A law that no size makes this visible is another one under another name.
MIN_VISIBLE_DISTANCE = 1.0
#: Share of a recording at whose beginning nothing is driven yet.
UNDRIVEN_SHARE = 0.01


@dataclass(frozen=True)
class RigTruth:
    """What only the judge of a trial knows.

    ``parameters`` are named as in the Modelica model, ``starts`` are the initial states of ``train`` and ``test``,
    ``noise`` is per output. ``aliases`` are states that an output shows, and that output: a compiler may call the state
    by either name.
    """

    kind: str
    what: What
    laws: tuple[LawTruth, ...]
    parameters: Mapping[str, float]
    starts: Mapping[str, Mapping[str, float]]
    noise: Mapping[str, SensorNoise]
    aliases: Mapping[str, str]
    seed: tuple[int, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for a file that the program never sees."""
        return asdict(self)


@dataclass(frozen=True)
class RigTrial:
    """A rig's recordings with and without noise, under the names of its first model, and the truth.

    ``model`` and ``toml`` are the Modelica file and the configuration that goes with it.
    """

    train: Recording
    test: Recording
    noise_free: Mapping[str, Recording]
    truth: RigTruth
    model: Path
    toml: Path


def rig_kinds() -> tuple[str, ...]:
    """Return the names of the kinds of rigs."""
    return tuple(KINDS)


def draw_rig_trial(kind: str, number: int, base: int = DEVELOPMENT, what: What = "law") -> RigTrial:
    """Draw and simulate one trial; the same arguments always give the same numbers.

    ``base`` is the first number of the seed, :data:`DEVELOPMENT` or :data:`REPORT`. From the model one law of the
    library is missing, none, two at different places, or one outside the library. Raises InputError for an unknown kind
    or another ``what``.
    """
    if kind not in KINDS:
        raise InputError(f"bench: no rig {kind}, expected one of {', '.join(KINDS)}")
    if what not in WHATS:
        raise InputError(f"bench: no trial of {what}, expected one of {', '.join(WHATS)}")
    rig = KINDS[kind]
    seed = (base, list(KINDS).index(kind), number, WHATS.index(what))
    rng = np.random.default_rng(seed)
    parameters = {
        name: value * (1.0 if name in rig.known else float(rng.uniform(1.0 - SPREAD, 1.0 + SPREAD)))
        for name, value in rig.parameters.items()
    }
    return make_trial(rig, rng, parameters, lambda *seen: _laws(seen[0], what, *seen[1:]), what=what, seed=seed)


def make_trial(
    rig: RigKind,
    rng: Generator,
    parameters: Mapping[str, float],
    choose: Callable[[Generator, RigExperiment, CleanRun], list[LawTruth]],
    *,
    what: What,
    seed: tuple[int, ...],
    noise: Mapping[str, SensorNoise] | None = None,
) -> RigTrial:
    """Record a rig of known parameters and choose what its model lacks.

    ``rng`` draws the experiments, and the noise if it is not given. ``choose`` says what the model lacks, from a
    generator, the experiment and a run (outputs, states) without it. ``what`` and ``seed`` are for the record.
    """
    time: FloatArray = np.arange(rig.rows, dtype=np.float64) * rig.step
    commands = {run: _commands(rng, rig, time) for run in ("train", "test")}
    starts = {run: _start(rng, rig, parameters) for run in ("train", "test")}
    clean_run = simulate_rig(rig, parameters, [], time, commands["train"], starts["train"])
    noise = noise if noise is not None else draw_noise_levels(rng, rig, clean_run[0])
    experiment = RigExperiment(rig, parameters, starts["train"], time, commands["train"], noise)
    laws = choose(rng, experiment, clean_run)
    noise_free = {
        run: _recording(
            run, rig, time, commands[run], simulate_rig(rig, parameters, laws, time, commands[run], starts[run])[0]
        )
        for run in ("train", "test")
    }
    measured = {
        run: _measure(stream, noise_free[run], noise) for run, stream in zip(noise_free, rng.spawn(2), strict=True)
    }
    states, shown = tuple(rig.states), rig.plant(parameters).shown
    truth = RigTruth(
        kind=rig.name,
        what=what,
        laws=tuple(laws),
        parameters=dict(parameters),
        starts={run: dict(zip(states, start, strict=True)) for run, start in starts.items()},
        noise=noise,
        aliases={states[index]: output for index, output in zip(shown, rig.outputs, strict=True)},
        seed=seed,
    )
    folder = MODELS / rig.name
    return RigTrial(measured["train"], measured["test"], noise_free, truth, folder / "Rig.mo", folder / "rig.toml")


def write_trial(trial: RigTrial, folder: Path | str, truth: Path | str | None = None) -> Path:
    """Write ``Rig.mo``, ``rig.toml``, ``train.csv`` and ``test.csv``, and the truth to a file elsewhere if asked."""
    seen = Path(folder)
    seen.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(trial.model, seen / "Rig.mo")
    shutil.copyfile(trial.toml, seen / "rig.toml")
    write_csv(trial.train, seen / "train.csv")
    write_csv(trial.test, seen / "test.csv")
    if truth is not None:
        Path(truth).write_text(json.dumps(trial.truth.to_dict(), indent=1) + "\n", encoding="utf-8")
    return seen


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
        at + spread * float(rng.uniform(-1.5, 1.5))
        for at, spread in zip(kind.rest(parameters), kind.shake, strict=True)
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


def _laws(rng: Generator, what: What, experiment: RigExperiment, clean_run: CleanRun) -> list[LawTruth]:
    """Scale each of the laws asked for to a distance of its own.

    Returns their distances in each other's presence, too.
    """
    if what == "none":
        return []
    kind = experiment.kind
    choices = outside_places(kind) if what == "outside" else law_places(kind)
    order = [choices[int(k)] for k in rng.permutation(len(choices))]
    basis = experiment.sensitivities()
    count, lowest = (2, 8.0) if what == "pair" else (1, 8.0 if what == "outside" else MIN_DISTANCE)
    chosen: list[LawTruth] = []
    for law, place in order:
        if any(place == one.place for one in chosen):
            continue
        target = exp(float(rng.uniform(log(lowest), log(MAX_DISTANCE))))
        found = law_at_distance(rng, experiment, basis, clean_run, (law, place), target)
        if found is None or found.d < MIN_VISIBLE_DISTANCE:
            continue
        both = _together(experiment, basis, [*chosen, replace(found, named=what != "outside")])
        if min(one.d for one in both) >= (lowest if chosen else MIN_VISIBLE_DISTANCE):
            chosen = both
        if len(chosen) == count:
            break
    return chosen


def _together(experiment: RigExperiment, basis: FloatArray, laws: Sequence[LawTruth]) -> list[LawTruth]:
    """Return the laws with the distance of each where the model knows the others."""
    if len(laws) == 1:
        return list(laws)
    return [
        replace(one, d=experiment.distance(laws, [other for other in laws if other is not one], basis)) for one in laws
    ]


def law_at_distance(
    rng: Generator,
    experiment: RigExperiment,
    basis: FloatArray,
    clean_run: CleanRun,
    which: tuple[str, LawPlace],
    target: float,
) -> LawTruth | None:
    """Size a law for about the distance ``target``, or as near to it as sizes that make sense bring it.

    ``basis`` and ``clean_run`` are the sensitivities and the run (outputs, states) without the law. None where no size
    is seen at all or the rig cannot be simulated with it.
    """
    law, place = which
    kind, entropy = experiment.kind, int(rng.integers(2**63))
    formula = law_kind(kind, law, place)
    scale = scale_at(kind, place, experiment.time, experiment.commands, *clean_run)

    def at(size: float) -> LawTruth:
        truth = LawTruth(law, place, formula.draw(np.random.default_rng(entropy), size, scale))
        try:
            d = experiment.distance([truth], [], basis)
        except OverflowError:
            d = float("nan")
        return replace(truth, d=d)

    tried: list[tuple[float, LawTruth]] = []
    size = min(0.03, formula.most)
    for _ in range(6):
        found = at(size)
        if not isfinite(found.d):
            size /= 10.0
            continue
        tried.append((size, found))
        if abs(log(max(found.d, 1e-9) / target)) < DISTANCE_TOLERANCE or (found.d < target and size >= formula.most):
            break
        power = _power(tried)
        size = min(size * float(np.clip((target / max(found.d, 1e-9)) ** (1.0 / power), 1e-2, 1e2)), formula.most)
    return min((one for _, one in tried), key=lambda one: abs(log(max(one.d, 1e-9) / target)), default=None)


def _power(tried: Sequence[tuple[float, LawTruth]]) -> float:
    """Estimate the exponent with which the distance grows with the size, from the last two tried."""
    if len(tried) < 2:
        return 1.0
    (size, one), (other_size, other) = tried[-1], tried[-2]
    if size == other_size or min(one.d, other.d) < 1e-6:
        return 1.0
    return float(np.clip(log(one.d / other.d) / log(size / other_size), 0.3, 3.0))


def _recording(name: str, kind: RigKind, time: FloatArray, commands: FloatArray, outputs: FloatArray) -> Recording:
    units = {"time": "s", **{column: kind.units.get(column, "") for column in (*kind.inputs, *kind.outputs)}}
    return Recording(
        name,
        time,
        {column: commands[:, k] for k, column in enumerate(kind.inputs)},
        {column: outputs[:, k] for k, column in enumerate(kind.outputs)},
        units,
    )


def _measure(rng: Generator, noise_free: Recording, noise: Mapping[str, SensorNoise]) -> Recording:
    nothing = np.zeros(noise_free.rows)
    readings = {
        name: values + noise[name].sample(stream, noise_free.time, nothing, nothing)
        for stream, (name, values) in zip(rng.spawn(len(noise)), noise_free.outputs.items(), strict=True)
    }
    return replace(noise_free, outputs=readings, sha256="")

"""A simulated fleet: rigs of one kind whose parameters come from a distribution that is known, some with a law more."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from math import exp, log
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from aero_bayes.data import write_csv
from aero_bayes.errors import InputError
from simulated_rigs.distance import RigExperiment
from simulated_rigs.kinds import KINDS, RigKind
from simulated_rigs.sensors import SensorNoise
from simulated_rigs.trial import MODELS, CleanRun, RigTrial, law_at_distance, make_trial
from simulated_rigs.truth import LawTruth, law_places

#: First number of a fleet's seeds.
FLEET = 23001
#: How far the fleet's typical values lie from the model's, and how much rigs differ, each as a share.
MAX_OFFSET, SPREAD_RANGE = 0.15, (0.03, 0.12)
#: Distance of the law in a typical rig, and how much its level differs from rig to rig.
TYPICAL_DISTANCE, LEVEL_SPREAD = 40.0, 0.3


@dataclass(frozen=True)
class FleetTruth:
    """What only the judge of a fleet knows.

    ``typical`` is the median of each free parameter, ``spread`` the standard deviation of its logarithm; ``law`` is as
    in a typical rig, and ``share`` the probability that a rig has it. ``noise`` is the same in all rigs.
    """

    kind: str
    typical: Mapping[str, float]
    spread: Mapping[str, float]
    law: LawTruth
    share: float
    noise: Mapping[str, SensorNoise]
    seed: int


def draw_fleet(kind: str, seed: int, *, share: float = 0.3, law: str | None = None) -> FleetTruth:
    """Draw what the rigs of a fleet of a kind share.

    ``law`` is what a ``share`` of the rigs have more, by default dry friction or the first of the kind. Raises
    InputError for an unknown kind, or a law that the kind cannot have.
    """
    if kind not in KINDS:
        raise InputError(f"bench: no rig {kind}, expected one of {', '.join(KINDS)}")
    rig = KINDS[kind]
    rng = np.random.default_rng([FLEET, list(KINDS).index(kind), seed])
    typical = {name: rig.parameters[name] * float(rng.uniform(1.0 - MAX_OFFSET, 1.0 + MAX_OFFSET)) for name in rig.free}
    low, high = SPREAD_RANGE
    spread = {name: exp(float(rng.uniform(log(low), log(high)))) for name in rig.free}
    choices = law_places(rig)
    wanted = [one for one in choices if one[0] == (law or "coulomb_friction")] or ([] if law else choices)
    if not wanted:
        raise InputError(f"bench: {kind} has no {law}; it has {', '.join(dict.fromkeys(name for name, _ in choices))}")
    made: list[tuple[Mapping[str, SensorNoise], LawTruth]] = []

    def size(stream: Generator, experiment: RigExperiment, clean_run: CleanRun) -> list[LawTruth]:
        found = law_at_distance(stream, experiment, experiment.sensitivities(), clean_run, wanted[0], TYPICAL_DISTANCE)
        if found is None:
            raise InputError(f"bench: {kind} does not show {wanted[0][0]}")
        made.append((experiment.noise, found))
        return []

    make_trial(rig, rng, _whole(rig, typical), size, what="none", seed=(FLEET, seed))
    return FleetTruth(kind, typical, spread, made[0][1], share, made[0][0], seed)


def draw_rig(truth: FleetTruth, number: int) -> RigTrial:
    """Draw and record one rig of a fleet; the same arguments always give the same numbers."""
    rig = KINDS[truth.kind]
    seed = (FLEET, list(KINDS).index(truth.kind), truth.seed, number)
    rng = np.random.default_rng(seed)
    own = {name: value * exp(truth.spread[name] * rng.standard_normal()) for name, value in truth.typical.items()}
    has, level = rng.random() < truth.share, exp(LEVEL_SPREAD * rng.standard_normal())
    first, size = next(iter(truth.law.parameters.items()))
    law = replace(truth.law, parameters={**truth.law.parameters, first: level * size})

    def choose(stream: Generator, experiment: RigExperiment, clean_run: CleanRun) -> list[LawTruth]:
        return [replace(law, d=experiment.distance([law], [], experiment.sensitivities()))] if has else []

    what = "law" if has else "none"
    return make_trial(rig, rng, _whole(rig, own), choose, what=what, seed=seed, noise=truth.noise)  # type: ignore[arg-type]


def write_fleet(folder: Path | str, truth: FleetTruth, count: int, *, work: str = "loop") -> Path:
    """Write ``fleet.toml``, ``rigs.csv``, the model, each rig's recordings, and beside them all ``truth.json``.

    Returns the path of the configuration.
    """
    if count < 1:
        raise InputError(f"bench: a fleet of {count} rigs; expected one at least")
    root = Path(folder)
    root.mkdir(parents=True, exist_ok=True)
    model = MODELS / truth.kind
    (root / "Rig.mo").write_text((model / "Rig.mo").read_text("utf-8"), "utf-8")
    head = f'[fleet]\nwork = "{work}"\nrigs = "rigs.csv"\n\n'
    (root / "fleet.toml").write_text(head + (model / "rig.toml").read_text("utf-8"), "utf-8")
    rigs = []
    with (root / "rigs.csv").open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(("name", "train", "test"))
        for name, trial in _rigs(truth, count):
            own = root / "recordings" / name
            own.mkdir(parents=True, exist_ok=True)
            for recording in (trial.train, trial.test):
                write_csv(recording, own / f"{recording.name}.csv")
            label = {"simulated": True, "recordings": [trial.train.name, trial.test.name]}
            (own / "simulated.json").write_text(json.dumps(label) + "\n", "utf-8")
            table.writerow((name, *(f"recordings/{name}/{run.name}.csv" for run in (trial.train, trial.test))))
            laws = [{"id": law.id, "d": law.d, **law.parameters} for law in trial.truth.laws]
            rigs.append({"name": name, "parameters": dict(trial.truth.parameters), "laws": laws})
    known: dict[str, Any] = {"fleet": asdict(truth), "rigs": rigs}
    (root / "truth.json").write_text(json.dumps(known, indent=1) + "\n", "utf-8")
    return root / "fleet.toml"


def _rigs(truth: FleetTruth, count: int) -> Iterator[tuple[str, RigTrial]]:
    digits = len(str(count))
    for number in range(1, count + 1):
        yield f"{truth.kind}-{number:0{digits}}", draw_rig(truth, number)


def _whole(rig: RigKind, free: Mapping[str, float]) -> dict[str, float]:
    return dict(rig.parameters) | dict(free)

"""A simulated fleet: rigs of one kind whose parameters come from a distribution that is known, some with a law more."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import asdict, replace
from math import exp, log
from pathlib import Path

import numpy as np
from numpy.random import Generator

from aero_bayes.data import write_csv
from aero_bayes.errors import InputError
from simulated_rigs.distance import RigExperiment
from simulated_rigs.kinds import KINDS, RigKind
from simulated_rigs.trial import CleanRun, RigTrial, law_at_distance, make_trial
from simulated_rigs.truth import LawTruth, law_places

#: First number of a fleet's seeds.
FLEET = 23001
#: How much rigs differ in a parameter, and in the size of the law: standard deviation of the logarithm.
SPREAD_RANGE, LAW_SPREAD = (0.03, 0.12), 0.3
#: How far the fleet's typical values lie from the model's, as a share, and the law's distance in a typical rig.
MAX_OFFSET, DISTANCE = 0.15, 40.0


def write_fleet(
    folder: Path | str, kind: str, count: int, *, seed: int = 1, share: float = 0.3, work: str = "loop"
) -> Path:
    """Write ``fleet.toml``, ``rigs.csv``, the model, each rig's recordings, and beside them all ``truth.json``.

    ``share`` is the probability that a rig has a law that the model lacks: dry friction, or the first of the kind.
    Returns the path of the configuration. Raises InputError for an unknown kind or no rigs.
    """
    if count < 1:
        raise InputError(f"bench: a fleet of {count} rigs; expected one at least")
    if kind not in KINDS:
        raise InputError(f"bench: no rig {kind}, expected one of {', '.join(KINDS)}")
    rig = KINDS[kind]
    rng = np.random.default_rng([FLEET, list(KINDS).index(kind), seed])
    typical = _typical(rig, rng, seed)
    truth, law = typical.truth, typical.truth.laws[0]
    spread = {name: exp(float(rng.uniform(log(SPREAD_RANGE[0]), log(SPREAD_RANGE[1])))) for name in rig.free}
    root = Path(folder)
    root.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(typical.model, root / "Rig.mo")
    head = f'[fleet]\nwork = "{work}"\nrigs = "rigs.csv"\n\n'
    (root / "fleet.toml").write_text(head + typical.toml.read_text("utf-8"), "utf-8")
    table, rigs = [("name", "train", "test")], []
    for number, stream in enumerate(rng.spawn(count), 1):
        name = f"{kind}-{number:0{len(str(count))}}"
        factors = {key: exp(size * stream.standard_normal()) for key, size in spread.items()}
        parameters = {key: value * factors.get(key, 1.0) for key, value in truth.parameters.items()}
        has, (first, size) = stream.random() < share, next(iter(law.parameters.items()))
        level = size * exp(LAW_SPREAD * stream.standard_normal())
        own = [replace(law, parameters={**law.parameters, first: level})] if has else []
        trial = make_trial(
            rig, stream, parameters, lambda *_, own=own: own, what="law" if has else "none", seed=(FLEET, seed, number),
            noise=truth.noise,
        )  # fmt: skip
        place = root / "recordings" / name
        place.mkdir(parents=True, exist_ok=True)
        for recording in (trial.train, trial.test):
            write_csv(recording, place / f"{recording.name}.csv")
        label = {"simulated": True, "recordings": [trial.train.name, trial.test.name]}
        (place / "simulated.json").write_text(json.dumps(label) + "\n", "utf-8")
        table.append((name, f"recordings/{name}/{trial.train.name}.csv", f"recordings/{name}/{trial.test.name}.csv"))
        rigs.append({"name": name, "parameters": parameters, "laws": [{"id": one.id, **one.parameters} for one in own]})
    with (root / "rigs.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(table)
    known = {"typical": asdict(truth), "spread": spread, "share": share, "rigs": rigs}
    (root / "truth.json").write_text(json.dumps(known, indent=1) + "\n", "utf-8")
    return root / "fleet.toml"


def _typical(rig: RigKind, rng: Generator, seed: int) -> RigTrial:
    """Draw the rig that is the fleet's median: parameters near the model's, and the law."""
    places = law_places(rig)
    which = next((one for one in places if one[0] == "coulomb_friction"), places[0])
    offsets = {name: float(rng.uniform(1.0 - MAX_OFFSET, 1.0 + MAX_OFFSET)) for name in rig.free}

    def choose(stream: Generator, experiment: RigExperiment, clean_run: CleanRun) -> list[LawTruth]:
        law = law_at_distance(stream, experiment, experiment.sensitivities(), clean_run, which, DISTANCE)
        if law is None:
            raise InputError(f"bench: {rig.name} does not show {which[0]}")
        return [law]

    parameters = {name: value * offsets.get(name, 1.0) for name, value in rig.parameters.items()}
    return make_trial(rig, rng, parameters, choose, what="law", seed=(FLEET, seed))

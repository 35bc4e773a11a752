"""Write the recordings and ``fleet.toml`` of a simulated fleet of rigs, some with an effect that the others lack.

They are not measurements. ``aero-bayes fleet --config OUT/fleet.toml --out DIR`` fits them. The rigs are of one kind;
their parameters come from a distribution that is known.
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
from dataclasses import asdict, replace
from math import exp, log
from pathlib import Path

import numpy as np
from numpy.random import Generator

from aero_bayes.data import write_csv
from simulated_rigs.experiment import RigExperiment
from simulated_rigs.kinds import KINDS
from simulated_rigs.rig import RigKind
from simulated_rigs.trial import RigTrial, make_trial
from simulated_rigs.truth import LawTruth, law_places

#: First number of a fleet's seeds.
FLEET = 23001
#: How much rigs differ in a parameter, and in the size of the law: standard deviation of the logarithm.
SPREAD_RANGE, LAW_SPREAD = (0.03, 0.12), 0.3
#: How far the fleet's typical values lie from the model's, as a share, and the law's distance in a typical rig.
MAX_OFFSET, DISTANCE = 0.15, 40.0


def write_fleet(
    out: Path | str, kind: str, count: int, *, seed: int = 1, share: float = 0.3, work: str = "loop"
) -> Path:
    """Write ``fleet.toml``, ``rigs.csv``, the model, each rig's recordings, and beside them all ``truth.json``.

    ``share`` is the probability that a rig has a law that the model lacks: dry friction, or the first of the kind.
    Returns the path of the configuration.
    """
    rig = KINDS[kind]
    rng = np.random.default_rng([FLEET, list(KINDS).index(kind), seed])
    typical = _typical(rig, rng)
    law = typical.laws[0]
    spread = {name: exp(float(rng.uniform(log(SPREAD_RANGE[0]), log(SPREAD_RANGE[1])))) for name in rig.free}
    root = Path(out)
    root.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(typical.model, root / "Rig.mo")
    head = f'[fleet]\nwork = "{work}"\nrigs = "rigs.csv"\n\n'
    (root / "fleet.toml").write_text(head + typical.toml.read_text("utf-8"), "utf-8")
    table: list[tuple[str, ...]] = [("name", "train", "test")]
    rigs = []
    for number, stream in enumerate(rng.spawn(count), 1):
        name = f"{kind}-{number:0{len(str(count))}}"
        factors = {key: exp(size * stream.standard_normal()) for key, size in spread.items()}
        parameters = {key: value * factors.get(key, 1.0) for key, value in typical.parameters.items()}
        has, (first, size) = stream.random() < share, next(iter(law.parameters.items()))
        level = size * exp(LAW_SPREAD * stream.standard_normal())
        own = [replace(law, parameters={**law.parameters, first: level})] if has else []
        trial = make_trial(rig, stream, parameters, lambda *_, own=own: own, typical.noise)
        folder = Path("recordings") / name
        (root / folder).mkdir(parents=True, exist_ok=True)
        label = {"simulated": True, "recordings": [trial.train.name, trial.test.name]}
        (root / folder / "simulated.json").write_text(json.dumps(label) + "\n", "utf-8")
        paths = [write_csv(one, root / folder / f"{one.name}.csv") for one in (trial.train, trial.test)]
        table.append((name, *(f"{folder.as_posix()}/{path.name}" for path in paths)))
        laws = [{"id": f"{one.law}@{one.place.name}", **one.parameters} for one in own]
        rigs.append({"name": name, "parameters": parameters, "laws": laws})
    with (root / "rigs.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(table)
    known = {
        "typical": {"parameters": typical.parameters, "laws": [asdict(law)]},
        "noise": {name: asdict(noise) for name, noise in typical.noise.items()},
        "spread": spread, "share": share, "rigs": rigs,
    }  # fmt: skip
    (root / "truth.json").write_text(json.dumps(known, indent=1) + "\n", "utf-8")
    return root / "fleet.toml"


def _typical(rig: RigKind, rng: Generator) -> RigTrial:
    """Draw the rig that is the fleet's median: parameters near the model's, and the law."""
    places = law_places(rig)
    which = next((one for one in places if one[0] == "coulomb_friction"), places[0])
    offsets = {name: float(rng.uniform(1.0 - MAX_OFFSET, 1.0 + MAX_OFFSET)) for name in rig.free}

    def choose(stream: Generator, experiment: RigExperiment) -> list[LawTruth]:
        law = experiment.law_at_distance(stream, *which, DISTANCE)
        assert law is not None, f"{rig.name} does not show {which[0]}"
        return [law]

    parameters = {name: value * offsets.get(name, 1.0) for name, value in rig.parameters.items()}
    return make_trial(rig, rng, parameters, choose)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--kind", choices=KINDS, default="cart", help="kind of rig (default: cart)")
    parser.add_argument("--rigs", type=int, default=12, help="how many rigs (default: 12)")
    parser.add_argument("--seed", type=int, default=1, help="the same seed gives the same numbers")
    options = parser.parse_args()
    path = write_fleet(options.out, options.kind, options.rigs, seed=options.seed)
    print(f"simulated, not measured: {path}")


if __name__ == "__main__":
    main()

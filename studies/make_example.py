"""Simulate the recordings of ``examples/cart``: a cart with dry friction that its model does not know."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording, write_csv
from simulated_rigs.designs import InputDesign, random_levels, random_multi_sine
from simulated_rigs.kinds import KINDS
from simulated_rigs.truth import LawPlace, LawTruth, simulate_rig

FOLDER = Path(__file__).parents[1] / "examples" / "cart"
TRUE = {"mass.m": 1.2, "spring.k": 56.0, "damper.d": 2.2}
FRICTION = LawTruth("coulomb_friction", LawPlace("balance", "mass.v"), {"F_c": 0.4})
NOISE, STEP, ROWS = 3e-4, 0.02, 2001


def main() -> None:
    rng = np.random.default_rng(2)
    kind = replace(KINDS["cart"], step=STEP)
    time: FloatArray = np.arange(ROWS, dtype=np.float64) * STEP
    end = float(time[-1])
    designs: dict[str, InputDesign] = {
        "train": random_levels(rng, 5.0, end),
        "test": random_multi_sine(rng, 5.0, 0.1, 2.0),
    }
    for name, design in designs.items():
        force = np.where(time < 1.0, 0.0, np.round(design.volts(time), 2))
        outputs, _ = simulate_rig(kind, TRUE, [FRICTION], time, force[:, None], (0.0, 0.0))
        measured = np.round(outputs[:, 0] + NOISE * rng.standard_normal(ROWS), 5)
        write_csv(Recording(name, np.round(time, 2), {"F": force}, {"position": measured}), FOLDER / f"{name}.csv")


if __name__ == "__main__":
    main()

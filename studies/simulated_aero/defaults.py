"""The recordings that plain ``make`` uses: simulated, with dry friction that the fitted model lacks."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aero_bayes.data import Recording, write_csv
from aero_bayes.files import whole_file
from simulated_aero.inputs import equal_steps, random_levels
from simulated_aero.rig import effect, simulate_recording
from simulated_aero.sensors import Sensors, real, white
from simulated_aero.truth import Parameters, Truth


@dataclass(frozen=True)
class SimulatedSet:
    """Recordings of one simulated rig, for fitting and for judging, and what it truly is."""

    train: tuple[Recording, ...]
    test: tuple[Recording, ...]
    truth: Truth
    sensors: Sensors

    def write(self, folder: Path | str) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
        """Write ``<name>.csv`` for every recording and ``simulated.json``, which holds the truth.

        Returns the paths of the training and of the test recordings. Nothing in the CSV files tells that they are
        simulated or what they carry.
        """
        root = Path(folder)
        train = tuple(write_csv(recording, root / f"{recording.name}.csv") for recording in self.train)
        test = tuple(write_csv(recording, root / f"{recording.name}.csv") for recording in self.test)
        write_truth(root / "simulated.json", self.truth, self.sensors, [*self.train, *self.test])
        return train, test


def write_truth(path: Path, truth: Truth, sensors: Sensors, recordings: list[Recording]) -> None:
    """Write the label that goes beside simulated recordings: what they truly are."""
    label: dict[str, Any] = {
        "simulated": True,
        "recordings": [recording.name for recording in recordings],
        "truth": truth.to_dict(),
        "noise": sensors.label,
    }
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(label, indent=1) + "\n", encoding="utf-8")


def default_truth() -> Truth:
    """Make a rig a few percent off its data sheet with 1.2 mN m of dry friction in the pivot and a 6 ms input delay."""
    parameters = Parameters().scaled(
        {"R_a": 1.07, "c_m": 0.98, "J": 0.93, "k_d": 1.08, "k_t": 0.95, "D_p": 0.9, "K_sp": 1.05}
    )
    return Truth("one_dof", parameters, (effect("pivot_coulomb_friction", tau_c=1.2e-3),), 0.006)


def default_recordings(seed: int = 0, *, noise: str = "white") -> SimulatedSet:
    """Simulate two training recordings and one test recording, 60 s at 100 Hz each, all three outputs.

    ``noise`` is ``white`` (5 mA, 1 rad/s, 2 mrad) or ``real`` (see :func:`simulated_aero.sensors.real`).
    """
    streams = np.random.default_rng([seed, 1]).spawn(5)
    truth, sensors = default_truth(), real() if noise == "real" else white()
    designs = (
        ("train_1", random_levels(streams[0], 20.0, 60.0)),
        ("train_2", equal_steps([6.0, 12.0, 18.0, 24.0, 12.0, 0.0, -6.0, -12.0, -18.0, -6.0, 0.0], 5.0)),
        ("test_1", random_levels(streams[1], 20.0, 60.0)),
    )
    made = [
        simulate_recording(truth, design, sensors, stream, name=name)
        for (name, design), stream in zip(designs, streams[2:], strict=True)
    ]
    return SimulatedSet((made[0], made[1]), (made[2],), truth, sensors)

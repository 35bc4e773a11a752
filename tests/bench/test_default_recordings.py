"""What plain `make` is given, and that nothing leaks from the truth to the fitting side."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import numpy as np
import pytest
from aero_recordings import read_aero

import aero_bayes
from simulated_rigs.aero import KINDS, default_recordings

pytestmark = pytest.mark.long

STUDIES = Path(__file__).parents[2] / "studies"
CATALOGUE = {
    "electrical": ("supply_resistance brush_drop winding_heating amplifier_deadzone amplifier_saturation"),
    "rotor": "rotor_coulomb_friction rotor_viscous_friction",
    "thrust": "thrust_inflow_loss thrust_lag thrust_asymmetry",
    "body": "pivot_coulomb_friction pivot_presliding_friction body_quadratic_drag gravity_offset cubic_stiffness",
    "sensor": "current_offset speed_lag pitch_delay pitch_offset",
}


def test_the_catalogue_is_the_contract() -> None:
    expected = {name: port for port, names in CATALOGUE.items() for name in names.split()}
    assert {kind.id: kind.port for kind in KINDS.values()} == expected


def test_default_recordings(tmp_path: Path) -> None:
    made = default_recordings(1)
    assert [one.name for one in (*made.train, *made.test)] == ["train_1", "train_2", "test_1"]
    assert [effect.id for effect in made.truth.effects] == ["pivot_coulomb_friction"]
    train, test = made.write(tmp_path)
    for path, recording in zip((*train, *test), (*made.train, *made.test), strict=True):
        text = path.read_text()
        assert "simul" not in text
        assert "coulomb" not in text
        read = read_aero(path)
        np.testing.assert_array_equal(
            read.measured(("i_m", "omega_m", "theta")), recording.measured(("i_m", "omega_m", "theta"))
        )
    assert json.loads((tmp_path / "simulated.json").read_text())["simulated"] is True


def test_the_simulated_rigs_use_nothing_of_the_package_but_recordings() -> None:
    for path in (STUDIES / "simulated_rigs").rglob("*.py"):
        for name in imports(path):
            used = name.split(".")[:2]
            assert used[0] != "aero_bayes" or used[1] in ("arrays", "data", "errors", "files"), path


def test_the_package_imports_no_study() -> None:
    studies = {path.stem for path in STUDIES.iterdir()}
    assert {"paper_replay", "simulated_rigs"} <= studies
    for path in Path(aero_bayes.__file__).parent.rglob("*.py"):
        assert not studies & {name.split(".")[0] for name in imports(path)}, path


def imports(path: Path) -> list[str]:
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found.append("." * node.level + (node.module or ""))
            found += [f"{node.module}.{alias.name}" for alias in node.names if node.module == "aero_bayes"]
    return found

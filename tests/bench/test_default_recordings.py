"""What plain `make` is given, and that nothing leaks from the truth to the fitting side."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import numpy as np
import pytest
from aero_recordings import read_aero

import aero_bayes
from simulate_aero import write_recordings
from simulated_rigs.aero import default_recordings

pytestmark = pytest.mark.long

STUDIES = Path(__file__).parents[2] / "studies"


def test_default_recordings(tmp_path: Path) -> None:
    made = default_recordings(1)
    assert [one.name for one in made] == ["train_1", "train_2", "test_1"]
    for path, recording in zip(write_recordings(tmp_path, 1), made, strict=True):
        text = path.read_text()
        assert "simul" not in text
        assert "coulomb" not in text
        read = read_aero(path)
        np.testing.assert_array_equal(
            read.measured(("i_m", "omega_m", "theta")), recording.measured(("i_m", "omega_m", "theta"))
        )
    label = json.loads((tmp_path / "simulated.json").read_text())
    assert label["simulated"] is True
    assert [law["law"] for law in label["truth"]["laws"]] == ["coulomb_friction"]


def test_the_simulated_rigs_use_nothing_of_the_package_but_recordings() -> None:
    for path in (STUDIES / "simulated_rigs").rglob("*.py"):
        for name in imports(path):
            used = name.split(".")[:2]
            assert used[0] != "aero_bayes" or used[1] in ("arrays", "data", "errors", "files"), path


def test_the_package_imports_no_study() -> None:
    studies = {path.stem for path in STUDIES.iterdir()}
    assert {"run", "simulated_rigs"} <= studies
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

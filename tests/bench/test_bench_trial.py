"""What `make` and the blind trial are given, and that nothing leaks from the truth to the fitting side."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import numpy as np
import pytest

import aero_bayes
from aero_bayes.bench import default_recordings, draw_trial, paper_recording
from aero_bayes.bench.effects import KINDS
from aero_bayes.bench.outside import KINDS as OUTSIDE
from aero_bayes.data import read_recording
from aero_bayes.errors import InputError

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
    assert len(OUTSIDE) >= 8
    assert not set(OUTSIDE) & set(KINDS)
    assert {kind.port for kind in OUTSIDE.values()} >= {"electrical", "rotor", "thrust", "body", "moment"}


@pytest.mark.parametrize("kind", ["single", "none", "pair", "outside"])
@pytest.mark.parametrize("noise", ["white", "real"])
def test_trials_are_what_was_asked_for(kind: str, noise: str) -> None:
    nominal = {"R_a": 8.4, "c_m": 0.042, "k_d": 2.4e-8, "k_t": 2.9e-7, "D_p": 0.0071, "K_sp": 0.0375}
    seen = set()
    for seed in range(60):
        spec = draw_trial(np.random.default_rng(seed), kind, noise)  # type: ignore[arg-type]
        assert spec == draw_trial(np.random.default_rng(seed), kind, noise)  # type: ignore[arg-type]
        names = [effect.id for effect in spec.truth.effects]
        assert len(set(names)) == len(names) == {"single": 1, "none": 0, "pair": 2, "outside": 1}[kind]
        assert all(name in (OUTSIDE if kind == "outside" else KINDS) for name in names)
        for name, value in nominal.items():
            assert 0.85 <= getattr(spec.truth.parameters, name) / value <= 1.15
        for effect in spec.truth.effects:
            ranges = (KINDS | OUTSIDE)[effect.id].ranges
            assert all(low <= abs(effect.parameters[key]) <= high * 1.0001 for key, (low, high) in ranges.items())
        assert spec.truth.input_delay == (0.006 if noise == "real" else 0.0)
        assert spec.sensors.encoder_counts == (2048 if noise == "real" else 0)
        seen.update(names)
    assert len(seen) >= {"single": 14, "none": 0, "pair": 17, "outside": 10}[kind]


def test_unknown_kind_is_refused() -> None:
    with pytest.raises(InputError, match="no trial of kind"):
        draw_trial(np.random.default_rng(0), "double")  # type: ignore[arg-type]


def test_truth_stays_apart_from_the_recordings(tmp_path: Path) -> None:
    spec = draw_trial(np.random.default_rng(3), "single", "real")
    train, test = spec.write(spec.record(), tmp_path / "seen", tmp_path / "hidden" / "truth.json")
    assert sorted(path.name for path in (tmp_path / "seen").iterdir()) == ["test.csv", "train.csv"]
    assert train.read_text().splitlines()[0] == "time,V_m,i_m,omega_m,theta"
    assert not np.array_equal(read_recording(train).inputs["V_m"], read_recording(test).inputs["V_m"])
    label = json.loads((tmp_path / "hidden" / "truth.json").read_text())
    assert label["simulated"] is True
    assert label["truth"]["effects"][0]["id"] == spec.truth.effects[0].id
    np.testing.assert_array_equal(
        spec.record().train[0].measured(("i_m", "omega_m", "theta")),
        read_recording(train).measured(("i_m", "omega_m", "theta")),
    )


def test_default_recordings(tmp_path: Path) -> None:
    made = default_recordings(1)
    assert [one.name for one in (*made.train, *made.test)] == ["train_1", "train_2", "test_1"]
    assert [effect.id for effect in made.truth.effects] == ["pivot_coulomb_friction"]
    train, test = made.write(tmp_path)
    for path, recording in zip((*train, *test), (*made.train, *made.test), strict=True):
        text = path.read_text()
        assert "simul" not in text
        assert "coulomb" not in text
        read = read_recording(path)
        np.testing.assert_array_equal(
            read.measured(("i_m", "omega_m", "theta")), recording.measured(("i_m", "omega_m", "theta"))
        )
    assert json.loads((tmp_path / "simulated.json").read_text())["simulated"] is True


def test_paper_recording() -> None:
    recording = paper_recording(0)
    assert recording.rows == 2001
    assert recording.duration == 40.0
    np.testing.assert_array_equal(recording.inputs["V_m"], np.where(recording.time < 20.0, 24.0, 0.0))
    assert paper_recording(0).sha256 == recording.sha256 != paper_recording(1).sha256
    assert 0.4 < np.nanmax(recording.outputs["theta"]) < 1.5


def test_nothing_that_fits_imports_the_bench_and_it_imports_nothing_of_theirs() -> None:
    root = Path(aero_bayes.__file__).parent
    rooms = "export simulation data estimate sample check sensors language ports laws search judge loop"
    for stage in rooms.split():
        paths = list((root / stage).rglob("*.py"))
        assert paths, stage
        for path in paths:
            assert not any(name.startswith("aero_bayes.bench") for name in imports(path)), path
    for path in (root / "bench").rglob("*.py"):
        for name in imports(path):
            assert name.split(".")[:2] in (
                ["aero_bayes", "bench"],
                ["aero_bayes", "data"],
                ["aero_bayes", "errors"],
                ["aero_bayes", "files"],
            ) or (not name.startswith("aero_bayes")), path


def imports(path: Path) -> list[str]:
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found.append("." * node.level + (node.module or ""))
            found += [f"{node.module}.{alias.name}" for alias in node.names if node.module == "aero_bayes"]
    return found

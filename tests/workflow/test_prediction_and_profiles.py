"""Several recordings predict each other, and doubtful parameters get a profile: in result.json and on the page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from written_effects import write_effects

from aero_bayes.cli import main
from aero_bayes.data import write_csv
from aero_bayes.modelica.compilers import export_fmu
from simulated_rigs.aero import Truth, simulate_recording
from simulated_rigs.designs import pulse, random_levels
from simulated_rigs.sensors import white

QUICK = "[fit]\nmethod = 'local'\n"


def record(path: Path, seed: int, **options: Any) -> Path:
    rng = np.random.default_rng(seed)
    shape = options.pop("shape", None) or random_levels(rng, 15.0, 20.0)
    truth = Truth((), 0.006)
    return write_csv(
        simulate_recording(truth, shape, white(), rng, duration=20.0, rate_hz=50.0, name=path.stem, **options), path
    )


def fit(out: Path, config: str, *files: Path, model: str = "Aero.Systems.OneDof") -> dict[str, Any]:
    out.mkdir(parents=True)
    study = out / "study.toml"
    study.write_text(config)
    words = [word for path in files for word in ("--data", str(path))]
    given = ["fit", *words, "--config", str(study), "--model", model, "--out", str(out), "--quiet"]
    result = CliRunner().invoke(main, given)
    assert result.exit_code == 0, result.output
    found: dict[str, Any] = json.loads((out / "result.json").read_text("utf-8"))
    return found


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("pair")
    files = [record(folder / f"run_{k}.csv", k) for k in (1, 2)]
    return folder / "out", fit(folder / "out", QUICK, *files)


@pytest.mark.long
def test_recordings_of_one_rig_predict_each_other_to_the_noise(pair: tuple[Path, dict[str, Any]]) -> None:
    _, result = pair
    left_out = result["prediction"]["recordings"]
    assert set(left_out) == {"run_1", "run_2"}
    for entry in left_out.values():
        for output, error in entry["rms"].items():
            assert entry["rms_fitted"][output] <= error * (1.0 + 1e-6)
            assert error < 1.1 * entry["rms_fitted"][output]


def test_parameters_of_one_recording_say_which(pair: tuple[Path, dict[str, Any]]) -> None:
    out, result = pair
    own = {name: entry["recording"] for name, entry in result["parameters"].items() if entry["recording"]}
    assert own["input_delay[run_1]"] == "run_1"
    assert own["input_delay[run_2]"] == "run_2"
    assert not result["parameters"]["R_a"]["recording"]
    assert "of run_2 alone" in (out / "report.html").read_text("utf-8")


def test_one_recording_has_no_prediction_and_a_weak_parameter_a_profile(tmp_path: Path) -> None:
    """Pitch alone during a pulse says little of the motor."""
    data = record(tmp_path / "pulse.csv", 3, shape=pulse(6.0, 1.0, 3.0))
    rows = [line.split(",") for line in data.read_text("utf-8").splitlines()]
    kept = [rows[0].index(name) for name in ("time", "V_m", "theta")]
    data.write_text("\n".join(",".join(row[k] for k in kept) for row in rows) + "\n")
    result = fit(tmp_path / "out", QUICK, data)
    assert "prediction" not in result
    found = result["identifiability"]
    status = {name: entry["status"] for name, entry in result["parameters"].items()}
    assert status["c_m"] == "weak"
    assert found["profiles"]
    assert set(found["profiles"]) | set(found["not_profiled"]) >= {
        name for name, entry in result["parameters"].items() if entry["status"] == "weak" and name != "input_delay"
    }
    for name, curve in found["profiles"].items():
        entry = result["parameters"][name]
        assert min(curve["drop"]) == 0.0
        if entry["status"] == "weak" and curve["bounded"]:
            # On its logarithmic axis the interval of the profile is about that of the Gaussian approximation.
            wide = [np.log(high / low) for low, high in (curve["interval"], (entry["q05"], entry["q95"]))]
            assert 0.7 < wide[0] / wide[1] < 1.4
    assert "K_sp" not in found["profiles"]
    assert not any("a function of" in line for line in found["text"])


def test_prediction_can_be_left_out(tmp_path: Path) -> None:
    files = [record(tmp_path / f"run_{k}.csv", k) for k in (1, 2)]
    result = fit(tmp_path / "out", QUICK + "[prediction]\nmax_seconds = 0\n", *files)
    assert "prediction" not in result


def test_model_with_dry_friction_takes_a_recording_of_its_motion(tmp_path: Path) -> None:
    """At rest the smoothed friction creeps for minutes, which is no motion that a recording must show."""
    written = write_effects("Aero.Systems.OneDof", {"pivot_coulomb_friction": {"F_c": 1.2e-3}}, tmp_path)
    fmu = export_fmu(written.name, tmp_path / "rubbing.fmu", sources=[written.path])
    result = fit(tmp_path / "out", QUICK, record(tmp_path / "run.csv", 4), model=str(fmu))
    assert result["model"]["name"] == "rubbing"

"""The commands end to end, on recordings of the simulated bench and, where it is present, on a real one."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from aero_bayes.cli import main
from aero_bayes.data import write_csv
from simulated_rigs.aero import Truth, pivot_friction, scaled, simulate_recording
from simulated_rigs.designs import random_levels
from simulated_rigs.sensors import white

REAL = Path(os.environ.get("AERO_BAYES_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
TRUTH = scaled(R_a=1.05, k_t=0.95, K_sp=1.1)


def record(path: Path, *effects: Any, seed: int = 5) -> Path:
    rng = np.random.default_rng(seed)
    truth = Truth(effects, 0.006, TRUTH)
    return write_csv(
        simulate_recording(truth, random_levels(rng, 20.0, 30.0), white(), rng, duration=30.0, rate_hz=50.0), path
    )


@pytest.fixture(scope="module")
def adequate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("data") / "adequate.csv")


def invoke(*arguments: str) -> str:
    model = [] if "--model" in arguments else ["--model", "Aero.Systems.OneDof"]
    result = CliRunner().invoke(main, [*arguments, *model, "--quiet"])
    assert result.exit_code == 0, result.output
    return result.output


def read(out: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads((out / "result.json").read_text("utf-8"))
    return result


def assert_contract(result: dict[str, Any], command: str) -> None:
    """The keys that other people's checks rely on."""
    assert (result["schema"], result["command"]) == (1, command)
    assert {"file", "sha256", "rows", "rate_hz"} <= set(result["data"][0])
    for entry in result["parameters"].values():
        assert {"value", "sd", "q05", "q50", "q95", "unit", "status"} <= set(entry)
        assert entry["status"] in ("identified", "weak", "unidentified", "fixed", "at_bound")
        if entry["status"] in ("unidentified", "fixed"):
            assert entry["sd"] is None
    assert all({"sd", "rho"} <= set(entry) for entry in result["noise"].values())
    assert math.isfinite(result["fit"]["rms"]["train"]["theta"])
    assert result["versions"]["numpy"] == np.__version__


@pytest.mark.long
def test_same_seed_same_numbers(adequate: Path, tmp_path: Path) -> None:
    config = tmp_path / "study.toml"
    config.write_text("[fit.pso]\niterations = 10\n")
    found = []
    for attempt, workers in (("a", "1"), ("b", "2")):
        out = tmp_path / attempt
        invoke("fit", "--data", str(adequate), "--config", str(config), "--workers", workers, "--out", str(out))
        found.append({name: entry["value"] for name, entry in read(out)["parameters"].items()})
    assert found[0] == found[1]


@pytest.mark.long
def test_the_page_can_be_drawn_again(adequate: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    invoke("fit", "--data", str(adequate), "--out", str(out))
    first = (out / "report.html").read_bytes()
    (out / "report.html").unlink()
    assert CliRunner().invoke(main, ["report", str(out)]).exit_code == 0
    assert (out / "report.html").read_bytes() == first


def test_loop_names_the_missing_friction(tmp_path: Path) -> None:
    friction = pivot_friction(2.0e-3)
    train = record(tmp_path / "train.csv", friction)
    test = record(tmp_path / "test.csv", friction, seed=6)
    out = tmp_path / "out"
    invoke("close-loop", "--train", str(train), "--test", str(test), "--out", str(out))
    result = read(out)
    assert_contract(result, "close-loop")
    loop = result["loop"]
    assert loop["outcome"] == "extended"
    assert [found["id"] for found in loop["effects"]] == ["pivot_coulomb_friction"]
    assert loop["effects"][0]["port"] == "body"
    assert loop["after"]["test"]["theta"] < 1.1 * loop["noise_floor"]["theta"] < loop["before"]["test"]["theta"]
    source = (out / loop["effects"][0]["modelica"]).read_text("utf-8")
    assert "model OneDof_pivot_coulomb_friction" in source


def test_check_takes_its_recordings_as_fit_does(adequate: Path) -> None:
    given = CliRunner().invoke(main, ["check", "--data", str(adequate), "--model", "Aero.Systems.OneDof"])
    assert given.exit_code == 0, given.output
    assert given.output == CliRunner().invoke(main, ["check", str(adequate), "--model", "Aero.Systems.OneDof"]).output
    assert "theta" in given.output
    assert CliRunner().invoke(main, ["check", "--model", "Aero.Systems.OneDof"]).exit_code == 2


def test_check_reads_in_the_models_units(tmp_path: Path) -> None:
    (tmp_path / "Room.mo").write_text(
        """model Room
  input Real P(unit = "W");
  output Real T(unit = "K", start = 290, fixed = true);
equation
  1000 * der(T) = P - 5 * (T - 280);
end Room;
"""
    )
    (tmp_path / "run.csv").write_text("time,P,room\n" + "".join(f"{k},{k % 3},{20 + k % 2}\n" for k in range(50)))
    config = tmp_path / "rig.toml"
    config.write_text(
        '[model]\nsources = ["Room.mo"]\nname = "Room"\n[data]\ninputs = ["P"]\noutputs = ["T"]\n'
        '[data.columns]\nT = {source = "room", unit = "degC"}\n'
    )
    result = CliRunner().invoke(main, ["check", "--config", str(config), str(tmp_path / "run.csv")])
    assert result.exit_code == 0, result.output
    assert "T: 293.1 to 294.1 K" in result.output


@pytest.mark.skipif(not REAL.is_dir(), reason=f"no real recordings at {REAL}")
def test_a_real_recording_is_said_to_need_more(tmp_path: Path) -> None:
    out = tmp_path / "out"
    data = REAL / "aero_pitch_pulse_500hz.csv"
    invoke("fit", "--data", str(data), "--model", "Aero.Systems.HalfQuad", "--out", str(out))
    result = read(out)
    assert_contract(result, "fit")
    assert result["fit"]["rms"]["train"]["theta"] < 0.04
    assert result["verdict"]["level"] == "warning"
    assert "theta" in result["verdict"]["text"]
    assert any("theta" in line for line in result["warnings"])


@pytest.mark.long
@pytest.mark.parametrize("cost", ["eq6", "weighted"])
def test_least_squares_costs_reach_their_own_minimum(cost: str, adequate: Path, tmp_path: Path) -> None:
    """Eq. 6 is lower under ``eq6`` than under any other cost; the weighted sum of squares under ``weighted``."""
    found = {}
    for name in ("posterior", cost):
        config = tmp_path / f"{name}.toml"
        config.write_text(f'[fit]\ncost = "{name}"\n[fit.pso]\niterations = 20\n')
        invoke("fit", "--data", str(adequate), "--config", str(config), "--out", str(tmp_path / name))
        found[name] = read(tmp_path / name)
    ours, plain = found[cost]["fit"], found["posterior"]["fit"]
    if cost == "eq6":
        assert ours["cost_eq6"] <= plain["cost_eq6"] * (1.0 + 1e-9)
    weights = {output: entry["sd"] for output, entry in found["posterior"]["noise"].items()}
    sums = [sum((f["rms"]["train"][o] / sd) ** 2 for o, sd in weights.items()) for f in (ours, plain)]
    assert sums[0] == pytest.approx(sums[1], rel=0.05)
    if cost == "weighted":
        assert sums[0] <= sums[1] * (1.0 + 1e-5)

"""Fits by the command line: of a real recording, where it is present, and by costs other than the posterior."""

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
from simulated_rigs.aero import Truth, scaled, simulate_recording
from simulated_rigs.designs import random_levels
from simulated_rigs.sensors import white

REAL = Path(os.environ.get("AERO_BAYES_DATA", Path(__file__).parents[2].parent / "shared" / "data"))


def fitted(out: Path, data: Path, *more: str) -> dict[str, Any]:
    """The result of ``fit``, with the keys that other people's checks rely on."""
    done = CliRunner().invoke(main, ["fit", "--data", str(data), "--out", str(out), "--quiet", *more])
    assert done.exit_code == 0, done.output
    result: dict[str, Any] = json.loads((out / "result.json").read_text("utf-8"))
    assert (result["schema"], result["command"]) == (1, "fit")
    assert {"file", "sha256", "rows", "rate_hz"} <= set(result["data"][0])
    for entry in result["parameters"].values():
        assert {"value", "sd", "q05", "q50", "q95", "unit", "status"} <= set(entry)
        assert entry["status"] in ("identified", "weak", "unidentified", "fixed", "at_bound")
        if entry["status"] in ("unidentified", "fixed"):
            assert entry["sd"] is None
    assert all({"sd", "rho"} <= set(entry) for entry in result["noise"].values())
    assert math.isfinite(result["fit"]["rms"]["train"]["theta"])
    assert result["versions"]["numpy"] == np.__version__
    return result


@pytest.mark.skipif(not REAL.is_dir(), reason=f"no real recordings at {REAL}")
def test_a_real_recording_of_pitch_alone_says_little_of_the_motor(tmp_path: Path) -> None:
    result = fitted(tmp_path / "out", REAL / "aero_pitch_pulse_500hz.csv", "--model", "Aero.Systems.HalfQuad")
    assert result["fit"]["rms"]["train"]["theta"] < 0.04
    assert result["verdict"]["level"] == "warning"
    assert "theta" in result["verdict"]["text"]
    assert any("theta" in line for line in result["warnings"])
    assert "prediction" not in result  # of one recording
    found = result["identifiability"]
    weak = {name for name, entry in result["parameters"].items() if entry["status"] == "weak"}
    assert found["profiles"]
    assert set(found["profiles"]) | set(found["not_profiled"]) >= weak - {"input_delay"}
    for name, curve in found["profiles"].items():
        entry = result["parameters"][name]
        assert min(curve["drop"]) == 0.0
        if entry["status"] == "weak" and curve["bounded"]:
            # On its logarithmic axis the interval of the profile is about that of the Gaussian approximation.
            wide = [np.log(high / low) for low, high in (curve["interval"], (entry["q05"], entry["q95"]))]
            assert 0.7 < wide[0] / wide[1] < 1.4


@pytest.mark.long
def test_least_squares_costs_reach_their_own_minimum(tmp_path: Path) -> None:
    """Eq. 6 is lower under ``eq6`` than under the posterior; the weighted sum of squares under ``weighted``."""
    rng = np.random.default_rng(5)
    levels, truth = random_levels(rng, 20.0, 30.0), Truth((), 0.006, scaled(R_a=1.05, k_t=0.95, K_sp=1.1))
    made = simulate_recording(truth, levels, white(), rng, duration=30.0, rate_hz=50.0)
    data, found = write_csv(made, tmp_path / "train.csv"), {}
    for cost in ("posterior", "eq6", "weighted"):
        config = tmp_path / f"{cost}.toml"
        config.write_text(
            f'[model]\nname = "Aero.Systems.OneDof"\n[fit]\ncost = "{cost}"\n[fit.pso]\niterations = 20\n'
        )
        found[cost] = fitted(tmp_path / cost, data, "--config", str(config))
    assert found["eq6"]["fit"]["cost_eq6"] <= found["posterior"]["fit"]["cost_eq6"] * (1.0 + 1e-9)
    weights = {output: entry["sd"] for output, entry in found["posterior"]["noise"].items()}
    sums = {cost: sum((of["fit"]["rms"]["train"][o] / sd) ** 2 for o, sd in weights.items())
            for cost, of in found.items()}  # fmt: skip
    assert sums["eq6"] == pytest.approx(sums["posterior"], rel=0.05)
    assert sums["weighted"] == pytest.approx(sums["posterior"], rel=0.05)
    assert sums["weighted"] <= sums["posterior"] * (1.0 + 1e-5)


@pytest.mark.long
def test_all_samples_the_model_that_the_loop_extended(tmp_path: Path) -> None:
    cart, out = Path(__file__).parents[2] / "examples" / "cart", tmp_path / "out"
    given = {"config": "rig.toml", "data": "train.csv", "test": "test.csv"}
    options = [word for key, name in given.items() for word in (f"--{key}", str(cart / name))]
    done = CliRunner().invoke(main, ["all", *options, "--out", str(out), "--quiet"])
    assert done.exit_code == 0, done.output
    result = json.loads((out / "result.json").read_text("utf-8"))
    assert [effect["id"] for effect in result["loop"]["effects"]] == ["coulomb_friction@v"]
    assert result["mcmc"]["converged"]
    assert result["parameters"]["F_c"]["q05"] < 0.4 < result["parameters"]["F_c"]["q95"]
    assert {"Rig_coulomb_friction_fitted.mo", "report.html", "posterior.nc"} <= {path.name for path in out.iterdir()}

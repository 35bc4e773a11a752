"""``aero-bayes fit`` gives the same answer through FMPy as through the native engine."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from aero_bayes.cli import main
from aero_bayes.data import write_csv
from simulated_rigs.aero import Truth, scaled, simulate_recording
from simulated_rigs.designs import paper_step
from simulated_rigs.sensors import white

HELD = ("c_m", "J_r", "k_d", "D_p", "K_sp", "L_a")
CONFIG = """
[fit]
method = "local"
staged = false
initial_states = "reading"
max_input_delay = 0
[fit.local]
starts = 1
[prediction]
max_seconds = 0
[solver]
relative_tolerance = 1e-7
absolute_tolerance = 1e-7
"""


@pytest.mark.long
def test_the_engines_fit_alike(tmp_path: Path) -> None:
    truth = Truth(parameters=scaled(R_a=1.05, k_t=0.95))
    rng = np.random.default_rng(8)
    data = write_csv(
        simulate_recording(truth, paper_step(), white(1.0), rng, duration=6.0, rate_hz=50.0), tmp_path / "short.csv"
    )
    config = tmp_path / "study.toml"
    config.write_text(CONFIG + "".join(f"[parameters.{name}]\nfree = false\n" for name in HELD))
    found = {}
    for engine in ("native", "fmpy"):
        out = tmp_path / engine
        arguments = ["fit", "--data", str(data), "--config", str(config), "--out", str(out), "--engine", engine]
        result = CliRunner().invoke(main, [*arguments, "--model", "Aero.Systems.OneDof", "--quiet"])
        assert result.exit_code == 0, result.output
        found[engine] = json.loads((out / "result.json").read_text("utf-8"))
    # The data show thrust by lever: k_t stands with D_t, which is held.
    for name, status in (("R_a", "identified"), ("k_t", "weak")):
        native, reference = (found[engine]["parameters"][name] for engine in ("native", "fmpy"))
        assert native["value"] == pytest.approx(reference["value"], abs=0.02 * reference["sd"])
        assert native["sd"] == pytest.approx(reference["sd"], rel=0.02)
        assert native["status"] == reference["status"] == status
    rms = [found[engine]["fit"]["rms"]["train"]["theta"] for engine in ("native", "fmpy")]
    assert rms[0] == pytest.approx(rms[1], rel=1e-3)  # the solvers themselves differ by 1e-6 rad

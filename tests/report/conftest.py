"""Runs for the page to draw: made once by the program itself, from short recordings of the simulated bench."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from headless_chromium import Browser, find_chromium

from aero_bayes.cli import main
from aero_bayes.data import write_csv
from aero_bayes.report.compare import write_comparison
from simulated_rigs.aero import Truth, pivot_friction, simulate_recording
from simulated_rigs.designs import random_levels
from simulated_rigs.sensors import white

#: Few parameters, few steps: pages want a run of every shape, not a good one.
CONFIG = """
[model]
name = "Aero.Systems.OneDof"
[fit]
method = "local"
[fit.local]
starts = 1
[posterior]
max_steps = 40
[prediction]
max_seconds = 0
[loop]
effects = ["pivot_coulomb_friction", "cubic_stiffness"]
[parameters]
"""


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the finished runs ``loop`` (an effect found, one recording unseen) and ``posterior``."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "report_runs"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:  # one of the processes that share the tests makes them
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "done").exists():
            _make(folder)
            (folder / "done").touch()
    return folder


def _make(folder: Path) -> None:
    friction = pivot_friction(1.2e-3)
    for name, seed in (("train", 5), ("unseen", 6)):
        rng = np.random.default_rng(seed)
        truth = Truth((friction,), 0.006)
        volts = random_levels(rng, 20.0, 12.0)
        recording = simulate_recording(truth, volts, white(), rng, duration=12.0, rate_hz=50.0)
        write_csv(recording, folder / f"{name}.csv")
    (folder / "simulated.json").write_text(json.dumps({"recordings": ["train", "unseen"]}), "utf-8")
    (folder / "loop.toml").write_text(CONFIG, "utf-8")
    held = "".join(f"{name} = {{free = false}}\n" for name in ("J_r", "k_d", "k_t", "D_p", "K_sp", "L_a"))
    (folder / "few.toml").write_text(CONFIG + held, "utf-8")
    data = str(folder / "train.csv")
    _invoke("close-loop", "--train", data, "--test", str(folder / "unseen.csv"), "--out", str(folder / "loop"),
            "--config", str(folder / "loop.toml"))  # fmt: skip
    _invoke("posterior", "--data", data, "--out", str(folder / "posterior"), "--config", str(folder / "few.toml"))


def _invoke(*arguments: str) -> None:
    result = CliRunner().invoke(main, [*arguments, "--model", "Aero.Systems.OneDof", "--quiet"])
    assert result.exit_code == 0, result.output


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium or Chrome on the PATH to open the page with")
    with Browser(executable, tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture(scope="module", params=["loop", "posterior", "compare"])
def page(request: pytest.FixtureRequest, runs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    if request.param == "compare":
        return write_comparison([runs / "loop", runs / "posterior"], tmp_path_factory.mktemp("page") / "compare.html")
    return runs / request.param / "report.html"

"""Temporary folders and workers go with their process, however it ends, and nobody else's folder goes with them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from aero_bayes.files import ScratchFolder, sweep

pytestmark = pytest.mark.fast

RUN = """
import sys
import numpy as np
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Experiment, ParameterTarget, Problem, SolverSettings
from aero_bayes.simulation.model import Model
problem = Problem(Model.load(sys.argv[1]), (Experiment(np.linspace(0, 2, 41), ("x",)),), ((ParameterTarget("mode"),),),
                  settings=SolverSettings(time_limit=60.0))
simulator = open_simulator(problem, workers=1)
simulator.simulate(np.zeros((1, 1)))
print(simulator.pool.processes[0], flush=True)
if sys.argv[2] == "hang":
    simulator.simulate(np.full((1, 1), 2.0))
"""


def run(fmu: Path, folder: Path, what: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", RUN, str(fmu), what]
    return subprocess.Popen(command, env=os.environ | {"TMPDIR": str(folder)}, stdout=subprocess.PIPE, text=True)


def ended(worker: int) -> bool:
    """Is this process gone, or dead and not yet waited for?"""
    try:
        return Path(f"/proc/{worker}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_a_run_that_closes_nothing_leaves_nothing(test_fmu, tmp_path):
    with run(test_fmu("Trouble").path, tmp_path, "end") as process:
        process.communicate()
    assert process.returncode == 0
    assert not list(tmp_path.iterdir())


def test_what_a_killed_run_left_goes_at_the_next_start(test_fmu, tmp_path):
    """Its worker, which hangs, ends with it; its folder stays until then."""
    with run(test_fmu("Trouble").path, tmp_path, "hang") as process:
        assert process.stdout is not None
        worker = int(process.stdout.readline())
        assert sweep(tmp_path) == 0  # all in use
        time.sleep(0.2)  # until it hangs
        process.send_signal(signal.SIGKILL)
    deadline = time.monotonic() + 20.0
    while not ended(worker):
        assert time.monotonic() < deadline, "the worker outlived its parent"
        time.sleep(0.1)
    assert len(list(tmp_path.iterdir())) == 1
    with run(test_fmu("Trouble").path, tmp_path, "end") as process:
        process.communicate()
    assert not list(tmp_path.iterdir())


def test_other_folders_stay(tmp_path):
    for name in ("aero-bayes-results", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "result.json").write_text("{}")
    (tmp_path / "aero-bayes-link.scratch").symlink_to(tmp_path / "other")
    assert sweep(tmp_path) == 0
    assert len(list(tmp_path.glob("*/result.json"))) == 3


def test_a_forked_child_leaves_its_parents_folder():
    with ScratchFolder() as folder:
        (folder / "a").mkdir()
        child = os.fork()
        if child == 0:
            sweep(folder.parent)
            os._exit(0)
        os.waitpid(child, 0)
        assert (folder / "a").is_dir()
    assert not folder.exists()

"""Ctrl-C ends in one line that says how to go on; progress says what, how far, how long."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from aero_bayes.workflow.progress import ProgressBar

CART = Path(__file__).parents[2] / "examples" / "cart"
ENDLESS = "[posterior]\ness = 1e9\nmax_steps = 1000000\n[fit]\nmethod = 'local'\n[fit.local]\nstarts = 1\n"

#: The program as a terminal starts it (a shell script's background job would not hear of Ctrl-C), which writes no
#: checkpoint of its searches before long.
PATIENT = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
PATIENT += "import aero_bayes.checkpoint as c; c.EVERY = 1e9; from aero_bayes.cli import main; main()"


def interrupted(folder: Path) -> tuple[int, list[str]]:
    """Status and what it said of a run that gets what Ctrl-C sends, to all its processes, once its model is built."""
    command = [sys.executable, "-c", PATIENT, "posterior", "--config", "long.toml", "--data", "train.csv",
               "--out", "out", "--workers", "2", "--resume"]  # fmt: skip
    with subprocess.Popen(
        command, cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, start_new_session=True
    ) as run:
        try:
            for _ in range(1200):
                if (folder / "out" / "Rig.fmu").exists() or run.poll() is not None:
                    break
                time.sleep(0.1)
            time.sleep(1.0)
            said = ""
            for _ in range(6):
                # One that falls into a module being imported can be lost: a person presses again.
                os.killpg(run.pid, signal.SIGINT)
                try:
                    _, said = run.communicate(timeout=10)
                    break
                except subprocess.TimeoutExpired:
                    continue
        finally:
            if run.poll() is None:
                os.killpg(run.pid, signal.SIGKILL)
    lines = [line for line in said.splitlines() if not line.endswith("...") and " after " not in line]
    return run.returncode, [line for line in lines if line]


def test_ctrl_c_ends_in_one_line(tmp_path: Path):
    folder = Path(shutil.copytree(CART, tmp_path / "cart", ignore=shutil.ignore_patterns("out*")))
    text = (folder / "rig.toml").read_text("utf-8").partition("[fit]")[0]
    (folder / "long.toml").write_text(text + ENDLESS, "utf-8")
    line = "interrupted: nothing to resume from yet, the same command begins anew"
    assert interrupted(folder) == (130, [line])
    assert not (folder / "out" / "result.json").exists()


def test_a_line_says_what_how_far_and_how_long(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    with ProgressBar(quiet=False) as progress:
        for share in (0.0, 0.1, 0.25, 0.5):
            progress("swarm", share, 12.5)
            clock[0] += 20.0
        progress("loop: round 1", 0.2)
        clock[0] += 30.0
        progress("loop: round 2", 0.4)
        clock[0] += 20.0
        progress("loop: round 2", 0.6)
    said = capsys.readouterr().err.splitlines()
    assert said == [
        "swarm ...",
        "swarm: 10% after 20 s, about 180 s left (12.5)",
        "swarm: 25% after 40 s, about 120 s left (12.5)",
        "swarm: 50% after 60 s, about 60 s left (12.5)",
        "loop: round 1 ...",
        "loop: round 2 ...",
        "loop: round 2: 60% after 50 s, about 50 s left",
    ]


def test_what_an_earlier_run_did_says_nothing_of_the_speed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    with ProgressBar(quiet=False) as progress:
        for share, then in ((0.0, 0.1), (0.25, 0.1), (0.5, 100.0), (0.6, 0.0)):
            progress("rigs", share)
            clock[0] += then
    assert capsys.readouterr().err.splitlines() == ["rigs ...", "rigs: 60% after 100 s, about 401 s left"]


def test_quiet_says_the_phases_only(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(time, "monotonic", iter(range(0, 1000, 100)).__next__)
    with ProgressBar(quiet=True) as progress:
        for share in (0.0, 0.5, 1.0):
            progress("local", share)
    assert capsys.readouterr().err == "local ...\n"

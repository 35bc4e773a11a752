"""Ctrl-C ends in one line that says how to go on; progress says what, how far, how long."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from facts import facts

from aero_bayes.files import one_run_at_a_time
from aero_bayes.progress import ProgressBar

CART = Path(__file__).parents[2] / "examples" / "cart"
ENDLESS = "[posterior]\ness = 1e9\nmax_steps = 1000000\n[fit]\nmethod = 'local'\n[fit.local]\nstarts = 1\n"

#: The program as a terminal starts it (a shell script's background job would not hear of Ctrl-C), which writes a
#: checkpoint of its searches so often.
PROGRAM = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
PROGRAM += "import aero_bayes.checkpoint as c; c.MIN_WRITE_INTERVAL = {every}; from aero_bayes.cli import main; main()"


def interrupted(folder: Path, sent: signal.Signals, every: float, until: str) -> tuple[int, list[str]]:
    """Status and what it said of a run whose processes all get a signal once a file is written."""
    arguments = "posterior --config long.toml --data train.csv --out out --workers 2 --resume"
    command = [sys.executable, "-c", PROGRAM.format(every=every), *arguments.split()]
    with subprocess.Popen(
        command, cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, start_new_session=True
    ) as run:
        try:
            for _ in range(1200):
                if (folder / "out" / until).exists() or run.poll() is not None:
                    break
                time.sleep(0.1)
            time.sleep(1.0)
            said = ""
            for _ in range(6):
                # One that falls into a module being imported can be lost: a person presses again.
                os.killpg(run.pid, sent)
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


def cli(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A run that ends by itself."""
    command = [sys.executable, "-c", "from aero_bayes.cli import main; main()", *arguments]
    command += ["--data", "train.csv", "--out", "out", "--quiet"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A cart with a run that does not end by itself."""
    folder = Path(shutil.copytree(CART, tmp_path / "cart", ignore=shutil.ignore_patterns("out*")))
    text = (folder / "rig.toml").read_text("utf-8").partition("[fit]")[0]
    (folder / "long.toml").write_text(text + ENDLESS, "utf-8")
    return folder


@pytest.mark.parametrize(("sent", "every", "until", "ends", "word"), [
    (signal.SIGINT, 1e9, "Rig.fmu", 130, "interrupted: "),
    # what a batch system sends, after a checkpoint
    pytest.param(signal.SIGTERM, 0.0, "checkpoint.npz", 143, "terminated: ", marks=pytest.mark.long),
])  # fmt: skip
def test_a_signal_ends_in_one_line_and_keeps_the_checkpoint(
    folder: Path, sent: signal.Signals, every: float, until: str, ends: int, word: str
):
    status, lines = interrupted(folder, sent, every, until)
    assert (status, len(lines)) == (ends, 1)
    assert lines[0].startswith(word)
    checkpoint = Path("out", "checkpoint.npz")
    assert ({"--resume", str(checkpoint)} <= set(lines[0].split())) == (until == checkpoint.name)
    assert not (folder / "out" / "result.json").exists()
    if until == checkpoint.name:
        assert (folder / checkpoint).exists()
        other = cli(folder, "posterior", "--config", "long.toml", "--resume", "--seed", "2")
        assert (other.returncode, len(other.stderr.splitlines())) == (2, 1)
        assert other.stderr.startswith(f"error: {checkpoint} ")


def test_a_second_run_in_the_folder_is_refused(folder: Path):
    with one_run_at_a_time(folder / "out"):
        refused = cli(folder, "fit", "--config", "rig.toml")
    assert refused.returncode == 2
    assert re.match(facts("out", "--out"), refused.stderr)
    assert len(refused.stderr.splitlines()) == 1
    assert not list((folder / "out").iterdir())


def said_numbers(lines: list[str]) -> list[tuple[str, list[str]]]:
    """The phase of each line of progress, and the numbers after it with their units."""
    phases = [re.match(r"loop: round \d|\w+", line)[0] for line in lines]
    rest = [line.removeprefix(phase) for line, phase in zip(lines, phases, strict=True)]
    return [(phase, re.findall(r"\d+(?:\.\d+)?(?:%| s)?", text)) for phase, text in zip(phases, rest, strict=True)]


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time in seconds, which a test sets."""
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_a_line_says_what_how_far_and_how_long(capsys: pytest.CaptureFixture[str], clock: list[float]):
    with ProgressBar(quiet=False) as progress:
        for share in (0.0, 0.1, 0.25, 0.5):
            progress("swarm", share, 12.5)
            clock[0] += 20.0
        progress("loop: round 1", 0.2)
        clock[0] += 30.0
        progress("loop: round 2", 0.4)
        clock[0] += 20.0
        progress("loop: round 2", 0.6)
    with ProgressBar(quiet=True) as progress:
        progress("swarm", 0.5)
        clock[0] += 20.0
        progress("swarm", 0.9)
    said = capsys.readouterr().err.splitlines()
    assert said_numbers(said) == [
        ("swarm", []),
        ("swarm", ["10%", "20 s", "12.5"]),
        ("swarm", ["25%", "40 s", "156 s", "12.5"]),
        ("swarm", ["50%", "60 s", "78 s", "12.5"]),
        ("loop: round 1", []),
        ("loop: round 2", ["117 s"]),
        ("loop: round 2", ["60%", "50 s", "65 s"]),
    ]


def test_what_an_earlier_run_did_says_nothing_of_the_speed(capsys: pytest.CaptureFixture[str], clock: list[float]):
    with ProgressBar(quiet=False) as progress:
        for share, then in ((0.0, 0.1), (0.25, 0.1), (0.5, 100.0), (0.7, 0.0)):
            progress("rigs", share)
            clock[0] += then
    assert said_numbers(capsys.readouterr().err.splitlines()) == [("rigs", []), ("rigs", ["70%", "100 s", "195 s"])]


def test_the_time_that_is_told_never_rises_and_a_sentence_stays(capsys: pytest.CaptureFixture[str], clock: list[float]):
    with ProgressBar(quiet=False) as progress:
        progress("swarm", 0.0)
        progress("a sentence.", 0.0)
        for share in (0.02, 0.2, 0.3, 0.32, 0.34, 0.5, 0.9, 0.95):  # it slows down, and speeds up
            clock[0] += 16.0
            progress("swarm", share)
    first, sentence, *told = capsys.readouterr().err.splitlines()
    assert sentence == "a sentence."
    assert "left" not in first + told[0]
    numbers = [found for _, found in said_numbers(told[1:]) if len(found) == 3]  # none where it is over
    totals = [int(spent[:-2]) + int(left[:-2]) for _, spent, left in numbers]
    assert len(totals) >= 5
    assert totals == sorted(totals, reverse=True)

"""A posterior that is stopped ends, resumed, as it would have ended; Ctrl-C says in one line how to go on."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

CART = Path(__file__).parents[2] / "examples" / "cart"
#: The program with a checkpoint that is written whenever there is anything new.
EAGER = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
EAGER += "import aero_bayes.checkpoint as c; c.MIN_WRITE_INTERVAL = c.MIN_INTERVAL_RATIO = 0.0; "
EAGER += "from aero_bayes.cli import main; main()"
FEW = "\n[posterior]\ness = 1e9\nmax_steps = 200\n[prediction]\nmax_seconds = 0\n"


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    folder = Path(shutil.copytree(CART, tmp_path / "cart", ignore=shutil.ignore_patterns("out*")))
    with (folder / "rig.toml").open("a", encoding="utf-8") as config:
        config.write(FEW)
    return folder


def begin(rig: Path, out: str, *more: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", EAGER, "posterior", "--config", "rig.toml", "--data", "train.csv"]
    command += ["--out", out, "--workers", "1", *more]
    return subprocess.Popen(
        command, cwd=rig, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def stop(run: subprocess.Popen[str], checkpoint: Path, size: int, how: signal.Signals) -> list[str]:
    """End a run once its checkpoint is so large; the last words of it."""
    deadline = time.monotonic() + 120.0
    while run.poll() is None and time.monotonic() < deadline:
        if checkpoint.exists() and checkpoint.stat().st_size > size:
            break
        time.sleep(0.005)
    assert run.poll() is None, "it ended before it could be stopped"
    os.killpg(run.pid, how)
    return run.communicate(timeout=60)[1].splitlines()


def told(folder: Path) -> Any:
    """The result, but for how long it took."""

    def timeless(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: timeless(item) for key, item in value.items() if key != "seconds"}
        return [timeless(item) for item in value] if isinstance(value, list) else value

    return timeless(json.loads((folder / "result.json").read_text("utf-8")))


@pytest.mark.long
def test_a_posterior_that_was_stopped_ends_as_if_it_had_not_been(rig: Path):
    whole = begin(rig, "whole")
    whole.communicate(timeout=300)
    assert whole.returncode == 0
    out, checkpoint = rig / "out", rig / "out" / "checkpoint.npz"
    said = stop(begin(rig, "out"), checkpoint, 0, signal.SIGINT)
    assert said[-1].startswith("interrupted: ")
    assert {"--resume", "out/checkpoint.npz"} <= set(said[-1].split())
    assert not any("Traceback" in line for line in said)
    size = checkpoint.stat().st_size
    stop(begin(rig, "out", "--resume"), checkpoint, size + 15_000, signal.SIGKILL)
    assert checkpoint.stat().st_size > size + 15_000
    other = begin(rig, "out", "--resume", "--seed", "2")
    words = other.communicate(timeout=60)[1].splitlines()
    assert (other.returncode, len(words)) == (2, 1)
    assert words[0].startswith("error: out/checkpoint.npz ")
    resumed = begin(rig, "out", "--resume")
    resumed.communicate(timeout=300)
    assert resumed.returncode == 0
    assert told(out) == told(rig / "whole")
    with np.load(out / "series.npz") as one, np.load(rig / "whole" / "series.npz") as other_one:
        assert set(one) == set(other_one)
        assert all(np.array_equal(one[key], other_one[key], equal_nan=True) for key in one)
    assert not checkpoint.exists()

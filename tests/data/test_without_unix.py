"""Files are read, locked and kept where Python has neither ``fcntl`` nor ``resource``, as on Windows."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

pytestmark = pytest.mark.fast

CART = Path(__file__).parents[2] / "examples" / "cart"
PROGRAM = """
import sys
sys.modules["fcntl"] = sys.modules["resource"] = None
from pathlib import Path
import aero_bayes
from aero_bayes.data import Layout
from aero_bayes.files import ScratchFolder, one_run_at_a_time, whole_file
layout = Layout.of(["F"], ["position"])
with one_run_at_a_time(Path("out")), ScratchFolder() as scratch:
    with whole_file(Path("out") / "text") as temporary:
        temporary.write_text(str(scratch.is_dir()))
rows = [aero_bayes.read_recording(name, layout=layout).rows for name in sys.argv[1:]]
print(rows, Path("out/text").read_text())
"""


def test_recordings_are_read(tmp_path: Path) -> None:
    time = np.arange(50.0)
    savemat(tmp_path / "run.mat", {"time": time, "F": np.sin(time), "position": np.cos(time)})
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, CART / "train.csv", "run.mat"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout.split("\n")[0] == "[2001, 50] True", done.stderr

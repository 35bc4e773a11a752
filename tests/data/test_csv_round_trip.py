"""Whatever finite numbers a recording holds, writing and reading gives the same ones."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from aero_bayes.data import Layout, Recording, read_recording, write_csv

pytestmark = pytest.mark.fast


def random_recording(rng: np.random.Generator) -> Recording:
    rows = int(rng.integers(4, 200))
    time = np.cumsum(rng.uniform(1e-6, 2.0, rows)) - rng.uniform(0.0, 100.0)
    signs = rng.choice([-1.0, 1.0], (3, rows))
    values = signs * 10.0 ** rng.uniform(-300.0, 300.0, (3, rows))
    values[:, rng.random(rows) < 0.1] = 0.0
    outputs = {"y": values[1], "z": np.where(rng.random(rows) < 0.3, np.nan, values[2])}
    outputs["z"][:4] = (1.0, -1e-320, 5e-324, 2.0)
    return Recording("r", time, {"u": values[0]}, outputs)


@pytest.mark.parametrize("seed", range(25))
def test_round_trip_is_exact(tmp_path: Path, seed: int) -> None:
    before = random_recording(np.random.default_rng(seed))
    path = write_csv(before, tmp_path / "r.csv")
    after = read_recording(path, layout=Layout.of(["u"], ["y", "z"]))
    np.testing.assert_array_equal(before.time, after.time)
    np.testing.assert_array_equal(before.inputs["u"], after.inputs["u"])
    np.testing.assert_array_equal(before.measured(("y", "z")), after.measured(("y", "z")))
    assert list(tmp_path.iterdir()) == [path]
    assert after.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()

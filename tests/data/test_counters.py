"""Counters that roll over or are reset are named with where they do so, and go on where the configuration says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from aero_bayes.data import ColumnMap, Recording, read_recording
from aero_bayes.data.columns import counter_falls

pytestmark = pytest.mark.fast

TIME = np.arange(600.0)
#: Counts that rise by 0 to 9 a row.
COUNTS = np.cumsum(np.random.default_rng(1).integers(0, 10, TIME.size)).astype(float)


def read(folder: Path, values: np.ndarray, column: ColumnMap | None = None) -> Recording:
    lines = (f"{t:.0f},1,{v:.10g}" for t, v in zip(TIME, values, strict=True))
    (folder / "run.csv").write_text("time,u,E\n" + "\n".join(lines) + "\n")
    columns = {} if column is None else {"E": column}
    return read_recording(folder / "run.csv", columns, inputs=["u"], outputs=["E"], units={"u": "W", "E": "J"})


DAY = TIME.astype(int) // 150
USED = np.random.default_rng(2).uniform(0.1, 5.0, TIME.size) * (1.0 + DAY)
SLOW = np.cumsum(3.0 + np.sin(TIME / 40.0))
#: What is read, the column that lets it go on, what it counted, and what the finding says to do, and where.
COUNTERS = {
    "at 256": (COUNTS % 256.0, ColumnMap("E", unwrap=256.0), COUNTS, "unwrap = 256", ""),
    "at 1000": (COUNTS % 1000.0, ColumnMap("E", unwrap=1000.0), COUNTS, "unwrap = 1000", ""),
    # the modulus counts in the unit of the file
    "at 1024 kJ": ((COUNTS + 77.0) % 1024.0, ColumnMap("E", unit="kJ", unwrap=1024.0), 1e3 * (COUNTS + 77.0),
                   "unwrap = 1024", ""),
    "reset": (np.concatenate([np.cumsum(part) for part in np.split(USED, 4)]), ColumnMap("E", reset=True),
              np.cumsum(USED), "reset = true", "150, 300, 450 s"),
    # what it counted in the interval before is lost: it is as much as in those beside it
    "reset right before its reading": (SLOW - SLOW[150 * DAY], ColumnMap("E", reset=True),
                                       pytest.approx(SLOW - SLOW[0], abs=0.01), "reset = true", ""),
}  # fmt: skip


@pytest.mark.parametrize("kind", COUNTERS)
def test_a_counter_is_found_and_goes_on(tmp_path: Path, kind: str) -> None:
    values, column, whole, done, where = COUNTERS[kind]
    (finding,) = read(tmp_path, values).findings
    assert (finding.kind, finding.signal, finding.mended) == ("wrapped", "E", False)
    assert done in finding.done
    assert where in finding.where
    mended = read(tmp_path, values, column)
    assert mended.findings == ()
    assert mended.outputs["E"] == (pytest.approx(whole) if isinstance(whole, np.ndarray) else whole)


def test_a_counter_that_rolls_over_at_an_end_of_its_own(tmp_path: Path) -> None:
    (finding,) = read(tmp_path, COUNTS % 777.0).findings
    assert float(finding.done.split("unwrap = ")[1].rstrip(".")) == pytest.approx(777.0, abs=5.0)


def test_gaps_of_a_counter_stay() -> None:
    falls = counter_falls(np.where(np.arange(TIME.size) % 7 == 0, np.nan, COUNTS % 1000.0))
    assert falls is not None
    assert falls[1] == 1000.0


SWING = 5.0 + 5.0 * np.sin(TIME / 30.0)
NO_COUNTERS = {
    "a counter that only rises": COUNTS,
    "a swing": SWING,
    "a swing in steps": np.round(SWING),
    "noise": np.random.default_rng(3).standard_normal(TIME.size) + 20.0,
    "a noisy ramp that starts again": TIME % 100.0 + np.random.default_rng(4).standard_normal(TIME.size),
    "on and off": (TIME // 50 % 2),
    "steps up and down": np.repeat(np.random.default_rng(5).choice([0.0, 1.0, 3.0], 20), 30),
    "a discharge": 100.0 - COUNTS / COUNTS[-1] * 90.0,
    "a rise with a wrong reading": np.where(TIME == 300.0, 0.0, COUNTS),
}


@pytest.mark.parametrize("kind", NO_COUNTERS)
def test_no_counter(kind: str) -> None:
    assert counter_falls(NO_COUNTERS[kind]) is None

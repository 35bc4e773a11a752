"""Counters that roll over or are reset are named with where they do so, and go on where the configuration says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from aero_bayes.data import ColumnMap, Recording, read_recording
from aero_bayes.data.counters import counter_falls

pytestmark = pytest.mark.fast

TIME = np.arange(600.0)
#: Counts that rise by 0 to 9 a row.
COUNTS = np.cumsum(np.random.default_rng(1).integers(0, 10, TIME.size)).astype(float)


def read(folder: Path, values: np.ndarray, column: ColumnMap | None = None) -> Recording:
    lines = (f"{t:.0f},1,{v:.10g}" for t, v in zip(TIME, values, strict=True))
    (folder / "run.csv").write_text("time,u,E\n" + "\n".join(lines) + "\n")
    columns = {} if column is None else {"E": column}
    return read_recording(folder / "run.csv", columns, inputs=["u"], outputs=["E"], units={"u": "W", "E": "J"})


@pytest.mark.parametrize("modulus", [256.0, 1000.0, 1024.0])
@pytest.mark.parametrize("begin", [0.0, 77.0])
def test_a_counter_that_rolls_over(tmp_path: Path, modulus: float, begin: float) -> None:
    whole = COUNTS + begin
    (finding,) = read(tmp_path, whole % modulus).findings
    assert (finding.kind, finding.signal, finding.mended) == ("wrapped", "E", False)
    assert f"{modulus:.0f}" in finding.what
    assert f"unwrap = {modulus:.0f}" in finding.done
    unit = ColumnMap("E", unit="kJ", unwrap=modulus)  # the modulus counts in the unit of the file
    mended = read(tmp_path, whole % modulus, unit)
    assert mended.findings == ()
    assert mended.outputs["E"] == pytest.approx(1e3 * whole)


def test_a_counter_that_rolls_over_at_an_end_of_its_own(tmp_path: Path) -> None:
    (finding,) = read(tmp_path, COUNTS % 777.0).findings
    assert float(finding.done.split("unwrap = ")[1].rstrip(".")) == pytest.approx(777.0, abs=5.0)


def test_a_register_that_is_reset(tmp_path: Path) -> None:
    day = 150
    used = np.random.default_rng(2).uniform(0.1, 5.0, TIME.size) * (1.0 + TIME // day)
    whole = np.cumsum(used)
    values = np.concatenate([np.cumsum(part) for part in np.split(used, TIME.size // day)])
    (finding,) = read(tmp_path, values).findings
    assert "reset = true" in finding.done
    assert "150, 300, 450 s" in finding.where
    mended = read(tmp_path, values, ColumnMap("E", reset=True))
    assert mended.findings == ()
    assert mended.outputs["E"] == pytest.approx(whole)


def test_a_register_that_is_reset_right_before_its_reading(tmp_path: Path) -> None:
    """What it counted in the interval before is lost: it is as much as in those beside it."""
    whole = np.cumsum(3.0 + np.sin(TIME / 40.0))
    values = whole - whole[TIME.astype(int) // 150 * 150]
    (finding,) = read(tmp_path, values).findings
    assert "reset = true" in finding.done
    mended = read(tmp_path, values, ColumnMap("E", reset=True))
    assert mended.outputs["E"] == pytest.approx(whole - whole[0], abs=0.01)


def test_gaps_of_a_counter_stay(tmp_path: Path) -> None:
    values = COUNTS % 1000.0
    values[::7] = np.nan
    falls = counter_falls(values)
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

"""Readings that a sensor sent rarely and a faster table repeats count once, where they came."""

from __future__ import annotations

import heated_room
import numpy as np
import pytest

from aero_bayes.data import Recording, mend
from aero_bayes.data.held import held_period

pytestmark = pytest.mark.fast


def repeated(values: np.ndarray, came: np.ndarray) -> np.ndarray:
    """The last value that came, in every row; before the first, a value of its own."""
    last = np.maximum.accumulate(np.where(came, np.arange(values.size), -1))
    return np.where(last >= 0, values[last], values[0])


def messages(rows: int, period: float, phase: float) -> np.ndarray:
    """Rows at which a message came that is sent with a period of its own."""
    return np.diff(np.floor((np.arange(-1, rows) + phase) / period)) > 0.0


@pytest.mark.parametrize("period", [2.0, 2.5, 7.0, 12.3, 25.0])
def test_each_message_counts_once_where_it_came(period: float) -> None:
    whole = heated_room.recording()
    came = messages(whole.rows, period, 0.7)
    given = heated_room.with_readings(whole, lambda v: repeated(v, came))
    (part,) = mend(given)
    (finding,) = part.findings
    assert (finding.kind, finding.signal, finding.mended) == ("held", "T", True)
    kept = np.isfinite(part.outputs["T"])
    assert kept.sum() == pytest.approx(came.sum(), abs=1)
    late = np.flatnonzero(came) >= 2.0 * period  # when the first one came is not known
    assert (kept == came)[int(2.0 * period) :].all()
    assert late.sum() > 20
    assert given.summary().outputs[0].held == pytest.approx(period * given.interval, rel=0.05)
    assert given.summary().outputs[0].noise.sd is None or given.summary().outputs[0].noise.sd > 0.0


def test_equal_messages_count_each() -> None:
    values = np.repeat(np.repeat(np.random.default_rng(2).standard_normal(40), 1 + (np.arange(40) % 8 == 3)), 10)
    found = held_period(values, {})
    assert found is not None
    assert np.flatnonzero(found[1]).tolist() == list(range(0, values.size, 10))


TIME = np.arange(1500)
SWINGS = np.sin(TIME / 40.0)
STEPS = np.repeat(np.random.default_rng(3).choice([0.0, 1.0, 2.5, 4.0], 100), 15)
OTHERS = {
    "coarse": (np.round(SWINGS / 0.02) * 0.02, {}),
    "coarse with noise": (np.round((SWINGS + 0.05 * np.random.default_rng(4).standard_normal(1500)) / 0.1) * 0.1, {}),
    "slow ramp in single steps": (np.floor(TIME / 20.0), {}),
    "on and off": (np.sign(np.sin(TIME / 8.0)), {}),
    "at once with its input": (3.0 * STEPS, {"u": STEPS}),
    "one row after its input": (3.0 * np.concatenate([STEPS[:1], STEPS[:-1]]), {"u": STEPS}),
    "too few messages": (np.repeat(np.random.default_rng(5).standard_normal(10), 150), {}),
    "irregular changes": (repeated(SWINGS, np.random.default_rng(6).random(1500) < 0.05), {}),
    "sparse already": (np.where(TIME % 25 == 0, SWINGS, np.nan), {}),
    "constant": (np.ones(1500), {}),
}


@pytest.mark.parametrize("kind", OTHERS)
def test_other_repeats_are_no_messages(kind: str) -> None:
    values, inputs = OTHERS[kind]
    assert held_period(values, inputs) is None
    (part,) = mend(Recording("run", TIME.astype(float), inputs, {"y": values}))
    assert "held" not in {finding.kind for finding in part.findings}

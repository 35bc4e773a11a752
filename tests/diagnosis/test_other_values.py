"""A held value that is wrong, and a parameter that differs by recording, are told before the model is blamed."""

from __future__ import annotations

from dataclasses import replace

import heated_room
import pytest

import aero_bayes
from aero_bayes.data import Recording
from aero_bayes.estimate.levenberg_marquardt import FitSettings

pytestmark = pytest.mark.fast


def two(monkeypatch: pytest.MonkeyPatch, capacity: float) -> list[Recording]:
    """The room, and the same room with another heat capacity."""
    first = heated_room.recording(seed=1)
    monkeypatch.setattr(heated_room, "C", capacity)
    return [replace(first, name="empty"), replace(heated_room.recording(seed=2), name="loaded")]


def told(fit: aero_bayes.Fit) -> str:
    row = fit.diagnosis["data"]
    return f"{row.what} {row.done}" if row.found else ""


def test_a_capacity_that_differs_by_recording(room: aero_bayes.Model, monkeypatch: pytest.MonkeyPatch) -> None:
    found = told(heated_room.fit(two(monkeypatch, 3.5e6), room))
    assert found.startswith("C seems to differ from recording to recording")
    assert "C = {free = true, per_recording = true}" in found


def test_one_capacity_for_both_needs_none(room: aero_bayes.Model, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not heated_room.fit(two(monkeypatch, heated_room.C), room).diagnosis["data"].found


def test_a_held_value_that_is_wrong(room: aero_bayes.Model) -> None:
    settings = FitSettings("local", fixed={"G": 60.0})
    fit = aero_bayes.fit(heated_room.recording(), room, parameters=["C"], settings=settings, workers=0)
    assert told(fit).startswith("G is held at a value that may be wrong")
    assert fit.diagnosis.explanation is None  # an effect may do the same: it is still looked for


def test_a_missing_effect_is_no_other_value(room: aero_bayes.Model) -> None:
    settings = FitSettings("local", fixed={"C": 2.0e6})
    recording = heated_room.recording(loss=lambda x: 9.0 * x * abs(x))
    fit = aero_bayes.fit(recording, room, parameters=["G"], settings=settings, workers=0)
    assert not fit.diagnosis["data"].found
    assert fit.diagnosis["model"].found

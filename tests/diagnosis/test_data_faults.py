"""Fits of recordings with one fault of the data: right values, the fault named, the model not blamed."""

from __future__ import annotations

from pathlib import Path

import heated_room
import numpy as np
import pytest

import aero_bayes
from aero_bayes.data import Recording
from aero_bayes.estimate.outliers import outlier_rows

pytestmark = pytest.mark.fast


def assert_right(found: aero_bayes.Fit, kinds: set[str], share: float = 0.03) -> None:
    assert found["C"].value == pytest.approx(heated_room.C, rel=share)
    assert found["G"].value == pytest.approx(heated_room.G, rel=share)
    assert {f.kind for r in found.calibration.data.recordings for f in r.findings} == kinds
    assert [row.cause for row in found.diagnosis if row.found] == (["data"] if kinds else [])


def test_readings_that_are_none_are_not_fitted(room: aero_bayes.Model) -> None:
    def change(readings: np.ndarray) -> np.ndarray:
        readings[[50, 51, 300]] = -999.0
        return readings

    found = heated_room.fit(heated_room.with_readings(heated_room.recording(), change), room)
    assert_right(found, {"sentinel"}, 0.01)
    assert found.rms["T"] < 2.0 * heated_room.SD


def test_outliers_are_told_with_their_times_and_not_fitted(room: aero_bayes.Model) -> None:
    rng = np.random.default_rng(3)
    rows = rng.choice(600, 18, replace=False)

    def change(readings: np.ndarray) -> np.ndarray:
        readings[rows] += rng.choice([-3.0, 3.0], rows.size)
        return readings

    found = heated_room.fit(heated_room.with_readings(heated_room.recording(), change), room)
    assert_right(found, {"outliers"}, 0.01)
    hidden = np.flatnonzero(np.isnan(found.calibration.data.recordings[0].outputs["T"]))
    assert set(hidden.tolist()) <= set(rows.tolist())
    assert hidden.size >= 0.9 * rows.size
    assert f"{120.0 * hidden[0]:g}" in found.diagnosis["data"].where


def test_the_part_after_a_gap_begins_anew(room: aero_bayes.Model) -> None:
    whole = heated_room.recording()
    keep = np.ones(whole.rows, dtype=bool)
    keep[200:290] = False
    assert_right(heated_room.fit(whole.rows_where(keep, "run"), room), {"gap"}, 0.02)


@pytest.mark.parametrize("every", [40, 85])
def test_few_readings_among_many_rows(room: aero_bayes.Model, every: int) -> None:
    whole = heated_room.recording()
    kept = np.arange(whole.rows) % every == 0
    found = heated_room.fit(heated_room.with_readings(whole, lambda y: np.where(kept, y, np.nan)), room)
    assert_right(found, set(), 0.15)
    assert found["C"].sd is not None


def test_crests_of_what_a_model_lacks_near_a_resonance_are_no_outliers() -> None:
    # ten readings a period, in bursts: most of the time there is far less
    rng = np.random.default_rng(5)
    k = np.arange(4000)
    residual = np.sin(0.63 * k) * np.sin(0.004 * k) ** 8 + rng.normal(0.0, 0.02, k.size)
    assert not outlier_rows(residual, np.zeros(k.size), {}).any()


def test_outliers_are_told_from_heavy_tails_and_delays() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        noise = rng.standard_normal(2000)
        assert not outlier_rows(noise, np.zeros(2000), {}).any()
        assert not outlier_rows(rng.standard_t(3.0, 2000), np.zeros(2000), {}).any()
    # A step that the fit has one sample too early leaves one large residual.
    step = (np.arange(2000) // 100 % 2).astype(float)
    late = np.roll(step, 1) + 0.01 * noise
    assert not outlier_rows(late, step, {"u": np.roll(step, -1)}).any()
    spikes = 0.01 * noise
    spikes[[150, 750, 1550]] += 1.0
    assert np.flatnonzero(outlier_rows(spikes + step, step, {"u": step})).tolist() == [150, 750, 1550]


def test_a_wrapped_angle_is_told_and_stops_the_blame(tmp_path: Path) -> None:
    (tmp_path / "Spin.mo").write_text(
        """model Spin
  parameter Real J(unit = "kg.m2", min = 1e-4, max = 1) = 0.02;
  parameter Real d(unit = "N.m.s", min = 1e-4, max = 1) = 0.02;
  input Real u(unit = "N.m");
  output Real phi(unit = "rad", start = 0, fixed = true);
  Real w(unit = "rad/s", start = 0, fixed = true);
equation
  der(phi) = w;
  J * der(w) = u - d * w;
end Spin;
"""
    )
    model = aero_bayes.load_model(tmp_path / "Spin.mo")
    rng = np.random.default_rng(5)
    time = 0.01 * np.arange(1500)
    torque = np.repeat(rng.choice([-0.5, 0.2, 0.6], 15), 100)
    angle, speed = np.zeros(1500), 0.0
    for k in range(1499):
        end = torque[k] / 0.05
        angle[k + 1] = angle[k] + end * 0.01 + (speed - end) * 0.6 * (1.0 - np.exp(-0.01 / 0.6))
        speed = end + (speed - end) * np.exp(-0.01 / 0.6)
    wrapped = np.mod(angle + 1e-3 * rng.standard_normal(1500), 2.0 * np.pi)
    given = Recording("run", time, {"u": torque}, {"phi": wrapped})
    found = aero_bayes.fit(given, model, parameters=["J", "d"], workers=0)
    cause = found.diagnosis.explanation
    assert cause is not None
    assert cause.cause == "data"
    assert "whole turn" in cause.what

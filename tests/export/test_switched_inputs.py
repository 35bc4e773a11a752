"""Inputs that are Boolean or Integer are read from columns of numbers."""

from __future__ import annotations

import numpy as np
import pytest

import aero_bayes
from aero_bayes.data import Layout, read_recording

MODEL = """
model Valve
  parameter Real R(min = 0.1, max = 10) = 2;
  input Boolean open;
  input Integer steps;
  output Real y(start = 0, fixed = true);
equation
  der(y) = (if open then 3 else -1) * steps - R * y;
end Valve;
"""


def test_boolean_and_integer_inputs(tmp_path):
    (tmp_path / "Valve.mo").write_text(MODEL)
    model = aero_bayes.load_model(tmp_path / "Valve.mo")
    time = np.linspace(0.0, 4.0, 401)
    opened, steps = (time >= 1.0) & (time < 2.5), np.where(time < 3.0, 2.0, 1.0)
    # Exact solution with R = 1.3, the inputs held between samples.
    y = np.zeros_like(time)
    for k in range(1, time.size):
        drive = (3.0 if opened[k - 1] else -1.0) * steps[k - 1]
        y[k] = drive / 1.3 + (y[k - 1] - drive / 1.3) * np.exp(-1.3 * (time[k] - time[k - 1]))
    noisy = y + np.random.default_rng(2).normal(0.0, 0.01, y.size)
    units = {"open": "", "steps": "", "y": ""}
    recording = aero_bayes.Recording("made", time, {"open": opened.astype(float), "steps": steps}, {"y": noisy}, units)
    settings = aero_bayes.FitSettings(method="local")
    found = aero_bayes.fit(recording, model, parameters=["R"], settings=settings, workers=0)
    assert found["R"].value == pytest.approx(1.3, rel=0.01)
    assert found.rms["y"] == pytest.approx(0.01, rel=0.15)


def test_true_and_false_are_read(tmp_path):
    rows = [f"{0.1 * k:.1f},{'true' if k % 20 < 10 else 'FALSE'},{0.01 * k * k:.4f}" for k in range(40)]
    (tmp_path / "made.csv").write_text("\n".join(["time,open,y", *rows]) + "\n")
    found = read_recording(tmp_path / "made.csv", layout=Layout.of(["open"], ["y"]))
    assert found.inputs["open"].tolist() == [float(k % 20 < 10) for k in range(40)]

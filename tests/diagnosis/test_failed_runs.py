"""Failed runs are explained: by the expression that leaves its domain, and when; slopes that are not finite too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import aero_bayes
from aero_bayes import FitSettings, Recording
from aero_bayes.estimate.diagnosis import domain_texts

pytestmark = pytest.mark.fast

TANK = """
model Tank
  parameter Real A(min = 0.1, max = 10) = 0.3;
  parameter Real k(min = 0.01, max = 1) = 0.1;
  input Real q;
  output Real h(start = 1, fixed = true);
  Real guarded;
  Real constant_root;
equation
  A * der(h) = q - k * sqrt(2 * h);
  guarded = log(max(h, 1e-3)) + h ^ 2;
  constant_root = sqrt(A);
end Tank;
"""


def test_expression_and_time_are_named(tmp_path: Path, rng: np.random.Generator):
    (tmp_path / "Tank.mo").write_text(TANK)
    model = aero_bayes.load_model(tmp_path / "Tank.mo")
    (text,) = domain_texts(model)
    assert "sqrt of h" in text
    assert "Tank.mo:10" in text
    time = np.arange(0.0, 60.0, 0.5)
    # h of A = 1, k = 0.1 runs empty at 2 A sqrt(h0 / 2) / k = 14.1 s, of A = 0.3 at 4.2 s
    h = np.square(np.maximum(1.0 - 0.1 * time / np.sqrt(2.0), 0.0)) + 1e-3 * rng.standard_normal(time.size)
    recording = Recording("run", time, {"q": np.zeros(time.size)}, {"h": h}, {})
    fit = aero_bayes.fit(recording, model, parameters=["A", "k"], settings=FitSettings(), workers=0)
    row = fit.diagnosis["solver"]
    assert row.found
    assert "sqrt of h" in row.what
    assert "run at 4" in row.where

"""What cannot be fitted is refused with the reason."""

from __future__ import annotations

from pathlib import Path

import pytest

import aero_bayes
from aero_bayes.errors import InputError
from aero_bayes.estimate import parameters_from_model

MODEL = """
model Coil
  parameter Real R(min = 0.1) = 2;
  parameter Real L(min = 0.1) = 1;
  parameter Real tau = L / (R + 1);
  parameter Integer n = 2;
  input Real u;
  output Real i(start = 0, fixed = true);
equation
  tau * der(i) = n * u / R - i;
end Coil;
"""


@pytest.mark.parametrize(
    ("name", "words"),
    [("tau", ("tau = L / (R + 1)", "L and R")), ("n", ("Integer",)), ("r", ("has no parameter r", "R"))],
)
def test_reason(tmp_path: Path, name: str, words: tuple[str, ...]):
    (tmp_path / "Coil.mo").write_text(MODEL)
    model = aero_bayes.load_model(tmp_path / "Coil.mo")
    with pytest.raises(InputError) as refused:
        parameters_from_model(model, [name])
    assert all(word in str(refused.value) for word in words)
    assert "\n" not in str(refused.value)

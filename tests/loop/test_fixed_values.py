"""A known value that is wrong passes for physics: the loop says which one would explain as much as what it names."""

from __future__ import annotations

import numpy as np
import pytest

from aero_bayes.data import Recording
from aero_bayes.loop import LoopSettings, StructureSettings, close_loop

MOTOR = """model Motor "A motor with a tachometer"
  parameter Real T(unit = "s", min = 0) = 0.3;
  parameter Real k(unit = "rad/(s.V)", min = 0) = 1.0 "from the data sheet";
  parameter Real unused = 3;
  input Real u(unit = "V");
  output Real w(unit = "rad/s", start = 0, fixed = true);
equation
  T*der(w) = k*u - w;
end Motor;
"""


def turned(name: str, seed: int, k: float, dead: float) -> Recording:
    """The speed from step to step in closed form: T = 0.2 s, less drive than was asked for by ``dead`` V."""
    u = np.repeat(np.random.default_rng(seed).uniform(-5.0, 5.0, 40), 20)
    speed = [0.0]
    for level in u[:-1]:
        end = k * np.sign(level) * max(abs(level) - dead, 0.0)
        speed.append(end + (speed[-1] - end) * np.exp(-0.02 / 0.2))
    seen = np.array(speed) + 0.02 * np.random.default_rng(seed + 1000).normal(size=u.size)
    return Recording(name, 0.02 * np.arange(u.size), {"u": u}, {"w": seen})


@pytest.mark.parametrize(
    ("k", "dead", "effects", "said"),
    [
        (1.4, 0.0, ["gain@u"], ("k is 1.4 rad/(s.V)", "fixed 1:")),
        (1.0, 0.5, ["dead_zone@u"], ()),
        (1.4, 0.5, ["gain@u", "dead_zone@u"], ("k is 1.4 rad/(s.V)", "fixed 1:")),
    ],
)
def test_a_held_value_that_explains_as_much_is_said(tmp_path, k, dead, effects, said):
    (tmp_path / "Motor.mo").write_text(MOTOR, encoding="utf-8")
    settings = LoopSettings(
        structures=StructureSettings(max_effects=2), parameters=("T",),
        laws=("gain", "offset", "dead_zone", "saturation"), ports=("u",), cache=tmp_path / "fmu",
    )  # fmt: skip
    train, test = (turned(name, seed, k, dead) for name, seed in (("a", 31), ("b", 32)))
    result = close_loop([train], [test], model=tmp_path / "Motor.mo", settings=settings, workers=0)
    assert sorted(effect.id for effect in result.effects) == sorted(effects)
    assert all(text in result.sentence for text in said)
    assert ("fixed" in result.sentence) == bool(said)

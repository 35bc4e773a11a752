"""Outputs of a model are often its states; a law at such an output moves the state, not where a recording starts it."""

from __future__ import annotations

import numpy as np
import pytest
from closed_form import runge_kutta
from scipy.linalg import expm

from aero_bayes import FitSettings
from aero_bayes.data import Recording
from aero_bayes.estimate import CalibrationSettings
from aero_bayes.loop import LoopSettings, close_loop

SOURCE = """model Cart "A mass on a spring, both its position and its speed are read"
  input Real F(unit = "N");
  output Real x(unit = "m", start = 0.1, fixed = true);
  output Real v(unit = "m/s", start = 0, fixed = true);
  parameter Real k(unit = "N/m", min = 0) = 10;
  parameter Real d(unit = "N.s/m", min = 0) = 0.5;
equation
  der(x) = v;
  der(v) = F - k*x - d*v;
end Cart;
"""
STEP, LAG, NOISE = 0.02, 0.05, (2e-3, 1e-2)


def recordings(rng: np.random.Generator) -> tuple[Recording, Recording]:
    """One run with the position read through a lag, by the matrix exponential; its last part starts in motion."""
    system = np.zeros((4, 4))
    system[0, 1] = 1.0
    system[1] = [-13.0, -0.4, 0.0, 1.0]
    system[2] = [1.0 / LAG, 0.0, -1.0 / LAG, 0.0]
    forward = expm(system * STEP)
    force = np.repeat(rng.normal(0.0, 3.0, 100), 15)
    z = np.zeros((force.size, 4))
    z[0] = [0.1, 0.0, 0.1, force[0]]
    for k in range(force.size - 1):
        z[k + 1] = forward @ z[k]
        z[k + 1, 3] = force[k + 1]
    read = {"x": z[:, 2] + rng.normal(0.0, NOISE[0], force.size), "v": z[:, 1] + rng.normal(0.0, NOISE[1], force.size)}

    def part(name: str, rows: slice) -> Recording:
        time = np.arange(force.size)[rows] * STEP
        return Recording(name, time - time[0], {"F": force[rows]}, {n: y[rows] for n, y in read.items()})

    return part("train", slice(0, 1000)), part("test", slice(1000, None))


def test_a_lag_in_the_reading_of_a_state(tmp_path) -> None:
    (tmp_path / "Cart.mo").write_text(SOURCE, encoding="utf-8")
    train, test = recordings(np.random.default_rng(7))
    settings = LoopSettings(
        max_effects=1,
        parameters=("k", "d"),
        laws=("lag", "gain", "coulomb_friction"),
        cache=tmp_path / "fmus",
    )
    found = close_loop(
        [train], [test], model=tmp_path / "Cart.mo", settings=settings, workers=0, out_dir=tmp_path / "out",
    )  # fmt: skip
    assert [e.id for e in found.effects] == ["lag@x"], found.sentence
    (lag,) = found.effects[0].parameters
    assert lag.value == pytest.approx(LAG, abs=5 * lag.sd)
    # The extended model starts the position, which it no longer reads, at the first reading all the same.
    assert found.predicted_after.test["test", "v"].rms < 2.0 * NOISE[1]
    assert found.predicted_after.test["test", "x"].rms < 0.2 * found.predicted_before.test["test", "x"].rms


TANK = """model Tank "A tank that runs out through a hole, its level is read"
  input Real q(unit = "m3/s");
  output Real h(unit = "m", start = 2, min = 0, fixed = true);
  parameter Real A(unit = "m2", min = 0) = 1;
  parameter Real c(min = 0) = 0.4;
equation
  A*der(h) = q - c*sqrt(h);
end Tank;
"""


def test_a_sensor_may_be_off_by_far_more_than_its_noise(tmp_path) -> None:
    """By 250 times, from the first reading on; the level itself starts where no reading says."""
    (tmp_path / "Tank.mo").write_text(TANK, encoding="utf-8")
    rng = np.random.default_rng(11)
    step, noise, off, area, hole = 0.5, 2e-3, 0.5, 1.3, 0.45
    made = []
    for name, first in (("train", 1.6), ("test", 2.4)):
        inflow = np.repeat(rng.uniform(0.35, 0.8, 40), 20)
        level = [first]
        for q in inflow[:-1]:  # classical Runge-Kutta, in ten parts
            h = level[-1]
            for _ in range(10):
                h = runge_kutta(lambda h, q: (q - hole * np.sqrt(h)) / area, h, (q, q, q), 0.1 * step)
            level.append(h)
        read = np.array(level) + off + rng.normal(0.0, noise, inflow.size)
        made.append(Recording(name, step * np.arange(inflow.size), {"q": inflow}, {"h": read}))
    settings = LoopSettings(
        max_effects=1,
        fit=FitSettings(method="local", calibration=CalibrationSettings(initial_states="estimated")),
        parameters=("A", "c"),
        laws=("offset", "gain"),
        cache=tmp_path / "fmus",
    )
    found = close_loop(
        made[:1],
        made[1:],
        model=tmp_path / "Tank.mo",
        settings=settings,
        workers=0,
        out_dir=tmp_path / "out",
    )
    (effect,) = found.effects
    assert effect.kind == "catalogue"
    assert effect.id == "offset@output_h", found.sentence
    (offset,) = effect.parameters
    assert offset.value == pytest.approx(off, abs=5.0 * offset.sd)
    assert found.predicted_after.test["test", "h"].rms < 1.3 * noise

"""A force that no listed law describes is learned as a curve, and one that a listed law describes is not."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
from facts import facts
from scipy.integrate import solve_ivp

from aero_bayes.data import Recording
from aero_bayes.loop import LoopResult, LoopSettings, close_loop
from aero_bayes.report.loop_figures import curve_plate

SOURCE = """model Slide "A mass on a spring and a damper"
  input Real F(unit = "N");
  output Real x(unit = "m", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
  parameter Real k(unit = "N/m", min = 0) = 10;
  parameter Real d(unit = "N.s/m", min = 0) = 0.5;
equation
  der(x) = v;
  der(v) = F - k*x - d*v;
end Slide;
"""
STEP, NOISE = 0.02, 1e-3


def recording(name: str, force: Callable[[float, float], float], rng: np.random.Generator) -> Recording:
    """A run with another force on the mass, by an adaptive Runge-Kutta method from input step to input step."""
    levels = np.repeat(rng.normal(0.0, 4.0, 40), 25)
    state, read = np.zeros(2), []
    for F in levels:
        read.append(state[0])
        run = solve_ivp(
            lambda _, s, F=F: (s[1], F - 9.0 * s[0] - 0.6 * s[1] - force(s[0], s[1])), (0.0, STEP), state, rtol=1e-8
        )
        state = run.y[:, -1]
    x = np.array(read) + rng.normal(0.0, NOISE, levels.size)
    return Recording(name, np.arange(levels.size) * STEP, {"F": levels}, {"x": x})


def looped(tmp_path, force: Callable[[float, float], float]) -> LoopResult:
    (tmp_path / "Slide.mo").write_text(SOURCE, encoding="utf-8")
    rng = np.random.default_rng(11)
    settings = LoopSettings(
        max_effects=2,
        parameters=("k", "d"),
        laws=("coulomb_friction", "quadratic_drag", "cubic_stiffness", "offset", "curve", "position_curve"),
        cache=tmp_path / "fmus",
    )
    return close_loop(
        [recording("train", force, rng)], [recording("test", force, rng)], model=tmp_path / "Slide.mo",
        settings=settings, workers=0, out_dir=tmp_path / "out",
    )  # fmt: skip


def test_a_ripple_over_the_place_is_learned_and_written(tmp_path) -> None:
    found = looped(tmp_path, lambda x, v: 0.8 * np.sin(4.0 * x + 0.5))
    assert [(e.id, e.kind, e.over) for e in found.effects] == [("position_curve@v", "free_form", "x")], found.sentence
    assert (
        found.predicted_after.test["test", "x"].rms < 2.5 * NOISE < 0.2 * found.predicted_before.test["test", "x"].rms
    )
    assert "position_curve" in found.modelica
    # The heights make the ripple where the mass has been: but for a line, which the spring may take.
    heights = np.array([p.value for p in found.effects[0].parameters])
    x_n = float(re.findall(r"x_n = ([0-9.e-]+)", found.modelica)[0])
    curve = found.effects[0].curve
    assert curve is not None
    assert (curve.x_unit, curve.unit) == ("m", "N")
    bumps = np.exp(-8.0 * (curve.x[:, None] / x_n - np.linspace(-1.0, 1.0, heights.size)) ** 2)
    np.testing.assert_allclose(curve.value, bumps @ heights, atol=1e-9)
    seen = np.abs(curve.x) < 0.8 * x_n
    x, learned = curve.x[seen], curve.value[seen]
    assert np.all((curve.sd[seen] > 0.0) & (curve.sd[seen] < 0.1))
    both = np.stack([learned, 0.8 * np.sin(4.0 * x + 0.5)])
    drawn = curve_plate(found.effects[0])
    assert drawn is not None
    assert re.search(facts("v", "x", "90 %"), drawn.alt)
    bent = both - np.stack([np.polyval(np.polyfit(x, y, 1), x) for y in both])
    assert np.corrcoef(bent)[0, 1] > 0.98


def test_a_listed_law_is_not_learned(tmp_path) -> None:
    found = looped(tmp_path, lambda x, v: 0.3 * np.tanh(v / 1e-3))
    assert [e.id for e in found.effects] == ["coulomb_friction@v"], found.sentence
    (curve,) = [r for r in found.steps[0].candidates if r.id == "curve@v"]
    (friction,) = [r for r in found.steps[0].candidates if r.id == "coulomb_friction@v"]
    assert friction.share < 1.05 * curve.share

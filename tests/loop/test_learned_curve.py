"""A force that no listed law describes is learned as a curve."""

from __future__ import annotations

import re

import numpy as np
from closed_form import held
from facts import facts
from numpy.typing import NDArray

from aero_bayes.data import Recording
from aero_bayes.loop import LoopSettings, close_loop
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


def ripple(x: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.8 * np.sin(4.0 * x + 0.5)


def recording(name: str, rng: np.random.Generator) -> Recording:
    """A run with a ripple of the force on the mass over its place."""
    levels = np.repeat(rng.normal(0.0, 4.0, 40), 25)

    def slope(s: NDArray[np.float64], force: float) -> NDArray[np.float64]:
        return np.array([s[1], force - 9.0 * s[0] - 0.6 * s[1] - ripple(s[0])])

    x = held(slope, np.zeros(2), levels, STEP, 4)[:, 0] + rng.normal(0.0, NOISE, levels.size)
    return Recording(name, np.arange(levels.size) * STEP, {"F": levels}, {"x": x})


def test_a_ripple_over_the_place_is_learned_and_written(tmp_path) -> None:
    (tmp_path / "Slide.mo").write_text(SOURCE, encoding="utf-8")
    rng = np.random.default_rng(11)
    settings = LoopSettings(
        max_effects=2,
        parameters=("k", "d"),
        laws=("coulomb_friction", "quadratic_drag", "cubic_stiffness", "offset", "curve", "position_curve"),
        cache=tmp_path / "fmus",
    )
    found = close_loop(
        [recording("train", rng)], [recording("test", rng)], model=tmp_path / "Slide.mo", settings=settings, workers=0,
        out_dir=tmp_path / "out",
    )  # fmt: skip
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
    both = np.stack([learned, ripple(x)])
    drawn = curve_plate(found.effects[0])
    assert drawn is not None
    assert re.search(facts("v", "x", "90 %"), drawn.alt)
    bent = both - np.stack([np.polyval(np.polyfit(x, y, 1), x) for y in both])
    assert np.corrcoef(bent)[0, 1] > 0.98

"""A model that fits what it was fitted to and misses the rest."""

from __future__ import annotations

import numpy as np

from aero_bayes.data import Recording
from aero_bayes.loop import LoopResult, LoopSettings, close_loop

SOURCE = """model Culture "Cells that divide, and are fed"
  input Real feed(unit = "mol/s");
  output Real n(unit = "mol", start = 1, fixed = true);
  parameter Real growth(unit = "1/s", min = 0) = 0.8;
equation
  der(n) = growth*n + feed;
end Culture;
"""
STEP, NOISE, GROWTH = 0.01, 0.02, 0.9


def recording(name: str, rng: np.random.Generator, duration: float, growth: float) -> Recording:
    """By the closed form over each sample, the feed held."""
    time = np.arange(0.0, duration, STEP)
    feed = np.repeat(rng.uniform(-0.2, 0.2, time.size // 50 + 1), 50)[: time.size]
    factor = np.exp(growth * STEP)
    n = np.ones(time.size)
    for k in range(time.size - 1):
        n[k + 1] = factor * n[k] + (factor - 1.0) / growth * feed[k]
    return Recording(name, time, {"feed": feed}, {"n": n + rng.normal(0.0, NOISE, time.size)})


def found(tmp_path, growth: float) -> LoopResult:
    (tmp_path / "Culture.mo").write_text(SOURCE, encoding="utf-8")
    rng = np.random.default_rng(5)
    settings = LoopSettings(
        max_effects=1, parameters=("growth",), laws=("gain", "offset"),
        cache=tmp_path / "fmus",
    )  # fmt: skip
    return close_loop(
        [recording("train", rng, 3.0, GROWTH)], [recording("test", rng, 12.0, growth)], model=tmp_path / "Culture.mo",
        settings=settings, workers=0,
    )  # fmt: skip


def test_a_model_that_misses_unseen_data_by_far_is_not_adequate(tmp_path) -> None:
    result = found(tmp_path, GROWTH * 1.05)
    assert result.outcome == "unexplained"
    assert "error of n" in result.sentence

"""A model that declares no free parameter is taken as it is: its loop fits laws only."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from aero_bayes.data import Recording
from aero_bayes.data.split import Recordings
from aero_bayes.errors import InputError
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.loop import LoopSettings, close_loop
from aero_bayes.loop.first_fit import LoopContext, LoopStatistics, first_fit
from aero_bayes.loop.modelica_family import ModelicaFamily
from aero_bayes.simulation.workers import WorkerPool


def test_a_model_without_a_free_parameter_is_simulated_with_its_values(tmp_path: Path) -> None:
    path = tmp_path / "Cart.mo"
    path.write_text(
        """model Cart
  parameter Real d(unit = "N.s/m") = 0.5;
  input Real F(unit = "N");
  output Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(v) = F - d * v;
end Cart;
""",
        encoding="utf-8",
    )
    time, noise = np.arange(400) * 0.02, np.random.default_rng(3).normal(0.0, 1e-3, 400)
    exact = 2.0 * (1.0 - np.exp(-0.5 * time))
    run = Recording("run", time, {"F": np.ones(400)}, {"v": exact + 0.05 * np.sin(2.0 * time) + noise})
    context = LoopContext(
        ModelicaFamily(LawPlaces("Cart", (path,)), tmp_path / "fmus"), Recordings.of([run], [], 0.3, ["v"]),
        LoopSettings(), WorkerPool(0), tmp_path, LoopStatistics(),
    )  # fmt: skip
    base = first_fit(context)
    assert base.plain.parameters.names == ()
    (report,) = base.reports
    left = 0.05 * np.sin(2.0 * time[:280]) + noise[:280]
    np.testing.assert_allclose(report.rms, np.sqrt(np.mean(left**2)), rtol=0.1)


def test_a_loop_that_is_given_no_parameters_says_which_there_are(tmp_path: Path) -> None:
    path = tmp_path / "Fall.mo"
    path.write_text(
        "model Fall\n  parameter Real d = 0.5;\n  output Real v(start = 1);\nequation\n  der(v) = -d * v;\nend Fall;\n"
    )
    run = Recording("run", np.arange(50) * 0.1, {}, {"v": np.exp(-0.05 * np.arange(50))})
    with pytest.raises(InputError, match=r"no parameters to fit: name some of d by LoopSettings\(parameters="):
        close_loop([run], [], model=path, workers=0)

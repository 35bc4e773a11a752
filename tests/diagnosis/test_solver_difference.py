"""What is told of the solver: its error, blamed where what is left does not hide it, rounded corners, failed runs."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import aero_bayes
from aero_bayes.data import Recording
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.diagnosis import domain_texts
from aero_bayes.estimate.initial_states import CalibrationSettings
from aero_bayes.estimate.simulation_error import exact_enough
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import SolverSettings

pytestmark = pytest.mark.fast

NATURAL, DAMPING, SD = 7.0, 0.02, 1e-3
PENDULUM = """model Pendulum
  parameter Real w(unit = "rad/s", min = 5.0, max = 9.0) = 6.9 "Natural frequency";
  parameter Real d(unit = "1/s", min = 0.001, max = 1.0) = 0.03 "Damping";
  input Real u(unit = "rad/s2");
  output Real phi(unit = "rad", start = 1.5, fixed = true);
  Real v(unit = "rad/s", start = 0.0, fixed = true);
equation
  der(phi) = v;
  der(v) = -w ^ 2 * sin(phi) - d * v + u;
end Pendulum;
"""


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> aero_bayes.Model:
    path = tmp_path_factory.mktemp("pendulum") / "Pendulum.mo"
    path.write_text(PENDULUM)
    return aero_bayes.load_model(path)


def swing(drag: float = 0.0) -> Recording:
    """Twenty seconds of a pendulum that swings freely, by another solver at a tight tolerance, with white noise."""
    time = np.linspace(0.0, 20.0, 1001)

    def slopes(_: float, x: np.ndarray) -> list[float]:
        return [x[1], -(NATURAL**2) * np.sin(x[0]) - DAMPING * x[1] - drag * x[1] * abs(x[1])]

    run = solve_ivp(slopes, (0.0, 20.0), [1.5, 0.0], method="DOP853", t_eval=time, rtol=1e-11, atol=1e-12)
    readings = run.y[0] + SD * np.random.default_rng(2).standard_normal(time.size)
    units = {"time": "s", "u": "rad/s2", "phi": "rad"}
    return Recording("swing", time, {"u": np.zeros(time.size)}, {"phi": readings}, units)


def fitted(recording: Recording, model: aero_bayes.Model, tolerance: float) -> aero_bayes.Fit:
    solver = SolverSettings(relative_tolerance=tolerance, absolute_tolerance=tolerance)
    settings = aero_bayes.FitSettings(calibration=CalibrationSettings(solver=solver))
    return aero_bayes.fit(recording, model, parameters=["w", "d"], settings=settings, workers=0)


def test_a_loose_tolerance_is_found_with_output_and_size(pendulum: aero_bayes.Model) -> None:
    recording = swing()
    loose = fitted(recording, pendulum, 1e-3)
    row = loose.diagnosis["solver"]
    assert row.found
    assert row.explains
    assert "phi" in row.where
    assert "relative_tolerance" in row.done
    assert loose.diagnosis.first is row
    # Independent: the engine's own answer at a tolerance at which it has converged.
    moved = loose.solver_difference["phi"]
    solver = SolverSettings(relative_tolerance=1e-10, absolute_tolerance=1e-10)
    exact = replace(loose.calibration, solver=solver)
    with open_simulator(exact.problem(), workers=0) as simulator:
        error = simulator.simulate(loose.values[np.newaxis]).outputs[0][0][:, 0] - loose.fitted[0][:, 0]
    assert moved == pytest.approx(float(np.sqrt(np.mean(error**2))), rel=0.5)


def test_a_tight_tolerance_is_clear_and_fits_the_truth(pendulum: aero_bayes.Model) -> None:
    tight = fitted(swing(), pendulum, 1e-8)
    assert not tight.diagnosis["solver"].found
    assert 0.0 < tight.solver_difference["phi"] < 0.1 * SD
    assert tight["w"].value == pytest.approx(NATURAL, abs=3e-5)


def test_a_small_error_of_the_solver_does_not_explain_what_the_model_lacks(pendulum: aero_bayes.Model) -> None:
    found = fitted(swing(drag=0.05), pendulum, 1e-3)
    assert found.diagnosis["model"].found
    assert found.diagnosis.explanation is None or found.diagnosis.explanation.cause != "solver"


def test_an_error_that_moves_no_parameter_is_no_finding(pendulum: aero_bayes.Model) -> None:
    found = fitted(swing(), pendulum, 1e-6)
    harmless = replace(found, solver_difference={"phi": 0.15 * SD}, solver_shift={"w": 0.002, "d": 0.1})
    assert not harmless.diagnosis["solver"].found
    assert "0.1 of its standard deviation" in harmless.diagnosis["solver"].what
    # To first order the shift is what a fit at the tighter tolerance finds.
    again = fitted(swing(), pendulum, 1e-7)
    shift = found.solver_shift["d"]
    sure = found.laplace.sd[found.laplace.names.index("d")] / np.sqrt(1.0 + shift**2)  # without the solver's part
    assert shift == pytest.approx(abs(np.log(again["d"].value / found["d"].value)) / sure, rel=0.2)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-5, 1e-6])
def test_an_interval_is_as_wide_as_what_the_solver_leaves_open(pendulum: aero_bayes.Model, tolerance: float) -> None:
    """Noise is 1e-4 of the swing: it tells the damping better than a solver at these tolerances simulates it."""
    found = fitted(swing(), pendulum, tolerance)
    damping = found["d"]
    assert found.solver_shift["d"] > 1.0
    assert damping.q05 < DAMPING < damping.q95
    assert damping.q95 - damping.q05 < 10.0 * abs(damping.value - DAMPING)


def test_a_fit_is_done_again_until_the_solver_moves_no_parameter(pendulum: aero_bayes.Model) -> None:
    def again(other: Calibration, fit: aero_bayes.Fit) -> aero_bayes.Fit:
        return fitted(swing(), pendulum, other.solver.relative_tolerance)

    found = exact_enough(fitted(swing(), pendulum, 1e-6), again, partial(open_simulator, workers=0), None)
    assert found.calibration.solver.relative_tolerance < 1e-6
    assert max(found.solver_shift.values()) < 0.5
    assert found["d"].q05 < DAMPING < found["d"].q95


LATE = """model Late
  parameter Real T(unit = "s", min = 0.01, max = 1) = 0.2;
  DECLARED = 0.06;
  input Real u;
  output Real y(start = 0, fixed = true);
equation
  (T ^ 4 + NAME ^ 4) ^ 0.25 * der(y) = u - y;
end Late;
"""


@pytest.mark.parametrize(
    "declared", ["constant Real T_min", "constant Real T_smooth", "parameter Real T_smooth", "constant Real T_c"]
)
def test_the_truth_lies_in_intervals_that_know_of_the_rounding(declared: str, tmp_path: Path) -> None:
    """The fitted lag is off by a closed form: ``(T^4 - T_min^4)^(1/4)`` where the truth is ``T``."""
    name = declared.split()[-1]
    (tmp_path / "Late.mo").write_text(LATE.replace("DECLARED", declared).replace("NAME", name))
    time = np.arange(0.0, 2.0, 0.01)
    readings = 1.0 - np.exp(-time / 0.1) + 1e-4 * np.random.default_rng(5).standard_normal(time.size)
    recording = Recording("step", time, {"u": np.ones(time.size)}, {"y": readings}, {"time": "s"})
    model, settings = aero_bayes.load_model(tmp_path / "Late.mo"), aero_bayes.FitSettings(method="local")
    fit = aero_bayes.fit(recording, model, parameters=["T"], settings=settings, workers=0)
    lag, off = fit["T"], 0.1 - (0.1**4 - 0.06**4) ** 0.25
    assert lag.value == pytest.approx(0.1 - off, abs=1e-4)
    assert (lag.q05 < 0.1 < lag.q95) == (name != "T_c")  # a width by another name is a value of the law
    assert lag.q95 - lag.q05 < 8.0 * off
    assert (fit.rounding_shift.get("T", 0.0) > 1.0) == (name != "T_c")
    assert ("rounding" in lag.note) == (name != "T_c")


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


def test_the_expression_that_ends_runs_is_named_with_its_time(tmp_path: Path, rng: np.random.Generator) -> None:
    (tmp_path / "Tank.mo").write_text(TANK)
    model = aero_bayes.load_model(tmp_path / "Tank.mo")
    (text,) = domain_texts(model)
    assert "sqrt of h" in text
    assert "Tank.mo:10" in text
    time = np.arange(0.0, 60.0, 0.5)
    # h of A = 1, k = 0.1 runs empty at 2 A sqrt(h0 / 2) / k = 14.1 s, of A = 0.3 at 4.2 s
    h = np.square(np.maximum(1.0 - 0.1 * time / np.sqrt(2.0), 0.0)) + 1e-3 * rng.standard_normal(time.size)
    recording = Recording("run", time, {"q": np.zeros(time.size)}, {"h": h}, {})
    fit = aero_bayes.fit(recording, model, parameters=["A", "k"], settings=aero_bayes.FitSettings(), workers=0)
    row = fit.diagnosis["solver"]
    assert row.found
    assert "sqrt of h" in row.what
    assert "run at 4" in row.where

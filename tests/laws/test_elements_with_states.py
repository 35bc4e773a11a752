"""Elements with states of their own, written into a model: off they are not there, on they do what scipy integrates."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from small_rigs import rig

from aero_bayes.laws.candidates import Candidate, place_law, ports_with_laws
from aero_bayes.laws.write_model import write_laws
from aero_bayes.loop.modelica_family import fitted_parameters
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.simulation.interface import Experiment, InputSignal, ParameterTarget, Problem, SolverSettings
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import NativeSimulator
from aero_bayes.simulation.workers import WorkerPool

ROOM = """model Room
  input Real u(unit = "W");
  output Real T(unit = "degC", start = 18, fixed = true);
equation
  1000 * der(T) = u - 3 * (T - 10);
end Room;
"""
CELL = """model Cell
  input Real u(unit = "A");
  output Real v(unit = "V");
  Real q(unit = "C", start = 0, fixed = true);
equation
  der(q) = u;
  v = 3.6 - 2e-3 * q - 0.03 * u;
end Cell;
"""
DRIVE = """model Drive
  input Real u(unit = "N.m");
  output Real w(unit = "rad/s", start = 2, fixed = true);
equation
  0.02 * der(w) = u - 0.01 * w;
end Drive;
"""
Rates = Callable[[float, NDArray[np.float64], float], Sequence[float]]
Reading = Callable[[NDArray[np.float64], float], float]
#: Model, law, its parameters, input, duration (s); rates, start and reading with the law, and without it.
CASES: dict[str, tuple[str, str, dict[str, float], float, float, Rates, Sequence[float], Reading]] = {
    "Room": (
        ROOM, "second_storage@T", {"k_2": 8.0, "T_2": 500.0, "start_h_2": -1.5}, 60.0, 2000.0,
        lambda t, x, u: [(u - 3 * (x[0] - 10) - 8 * (x[0] - x[1])) / 1000, 8 * (x[0] - x[1]) / 4000],
        (18.0, 16.5), lambda x, u: x[0],
    ),
    "Cell": (
        CELL, "polarisation@v", {"R_1": 0.02, "T_1": 30.0, "start_i_1": 0.5}, 2.0, 100.0,
        lambda t, x, u: [u, (u - x[1] / 0.02) / 1500],
        (0.0, 0.05), lambda x, u: 3.6 - 2e-3 * x[0] - 0.03 * u - x[1],
    ),
    "Drive": (
        DRIVE, "attached_mass@w", {"m_a": 0.01, "w_a": 20.0, "d_a": 0.05}, 0.5, 1.0,
        lambda t, x, u: [
            (u - 0.01 * x[0] - 4 * x[2] - 0.02 * (x[0] - x[1])) / 0.02, (4 * x[2] + 0.02 * (x[0] - x[1])) / 0.01,
            x[0] - x[1],
        ],
        (2.0, 2.0, 0.0), lambda x, u: x[0],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(CASES))
def test_an_element_is_the_scipy_solution_and_off_the_model_as_it_was(name, laws, tmp_path):
    text, id_, values, before, duration, rates, start, reading = CASES[name]
    path = tmp_path / f"{name}.mo"
    path.write_text(text, encoding="utf-8")
    flat = rig(name, str(path))
    law_id, at = id_.split("@")
    port = next(p for p in ports_with_laws(flat, laws) if p.id == at)
    law = next(law for law in laws if law.id == law_id and law.kind == port.kind)
    placed = place_law(Candidate(law, port), [v.name for v in flat.variables], values=values, with_starts=True)
    written = write_laws([path], name, flat, [placed], tmp_path)
    again = load_flat(written.name, [path, written.path])
    time, levels = np.linspace(0.0, duration, 81), (before, -0.4 * before)
    signal = InputSignal("u", np.array([0.0, 0.5 * duration]), np.array(levels))
    output = next(v.name for v in flat.variables if v.causality == "output")
    experiment = Experiment(time, (output,), (signal,))
    magnitude = placed.names[law.magnitude.name]
    on, off = (
        simulated(Model.load(export_flat(f, tmp_path / f"{f.name}{k}.fmu")), experiment, targets)
        for k, (f, targets) in enumerate(((again, {}), (again, {magnitude: 0.0})))
    )
    exported = Model.load(tmp_path / f"{again.name}0.fmu")
    states = [state for p in fitted_parameters(placed) for state in p.starts]
    assert len(states) == len(law.starts)
    assert set(states) <= {s.name for s in exported.states}
    plain = simulated(Model.load(export_flat(flat, tmp_path / "plain.fmu")), experiment, {})
    np.testing.assert_allclose(off, plain, rtol=0, atol=1e-9 * np.abs(plain).max())
    expected, x = [], np.array(start)
    for u, part in zip(levels, (time[:41], time[40:]), strict=True):
        found = solve_ivp(rates, (part[0], part[-1]), x, "DOP853", part, args=(u,), rtol=1e-10, atol=1e-12)
        # where the input jumps, the reading after it counts
        expected = [*expected[:40], *(reading(y, u) for y in found.y.T)]
        x = found.y[:, -1]
    np.testing.assert_allclose(on, expected, rtol=0, atol=2e-6 * np.abs(expected).max())
    assert np.abs(on - plain).max() > 1e-3 * np.abs(plain).max()


def simulated(model: Model, experiment: Experiment, values: dict[str, float]) -> NDArray[np.float64]:
    """The output of a model with some parameters set."""
    targets = tuple(ParameterTarget(n) for n in values)
    problem = Problem(model, (experiment,), (targets,), {}, SolverSettings(1e-10, 1e-10))
    with WorkerPool(0) as pool, NativeSimulator(problem, pool=pool) as simulator:
        return simulator.simulate(np.array([list(values.values())])).outputs[0][0][:, 0]

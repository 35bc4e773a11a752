"""The engine beside FMPy, which runs the same FMU.

The paper's experiment (24 V for 20 s, 0 V for 20 s, 2,001 samples of three outputs) at one tolerance for all routes;
errors are measured against FMPy's CVode at a tolerance of 1e-10. Another comparison is another :class:`Pair` in
:func:`pairs`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from harness import Pair, Row, time_pair

from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.interface import Experiment, InputSignal, ParameterTarget, Problem, SolverSettings
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import NativeSimulator
from aero_bayes.simulation.workers import WorkerPool

OUTPUTS = ("i_m", "omega_m", "theta")
PARAMETERS = ("R_a", "c_m", "J_r", "k_d", "k_t", "D_p", "K_sp", "L_a")
TOLERANCE = 1e-6
WHITE = np.array([1.0, 0.0, 0.0])
Route = Callable[[], np.ndarray]


def paper_problem(model: Model) -> Problem:
    """Pose the paper's experiment with eight parameters free."""
    time = np.linspace(0.0, 40.0, 2001)
    signal = InputSignal("V_m", np.array([0.0, 20.0]), np.array([24.0, 0.0]))
    what = Experiment(time, OUTPUTS, (signal,), measured=np.zeros((time.size, 3)))
    targets = tuple(ParameterTarget(name) for name in PARAMETERS)
    return Problem(model, (what,), (targets,), settings=SolverSettings(TOLERANCE, TOLERANCE))


def nominal(model: Model, n: int = 1) -> np.ndarray:
    """Return the model's own values, n rows varied by 2 %."""
    values = np.array([model.parameter(name).start for name in PARAMETERS], dtype=float)
    return values * np.exp(0.02 * np.random.default_rng(0).standard_normal((n, len(PARAMETERS))) * (n > 1))


def fmpy_route(model: Model, folder: Path, tolerance: float = TOLERANCE) -> Route:
    """Return Model Exchange with CVode by FMPy as a user would write it, unpacked, described and loaded once."""
    from fmpy import extract, read_model_description, simulate_fmu

    unpacked = extract(str(model.path), str(folder / "fmpy"))
    described = read_model_description(unpacked)
    signal = np.array([(0.0, 24.0), (20.0, 24.0), (20.0, 0.0), (40.0, 0.0)], dtype=[("time", "f8"), ("V_m", "f8")])

    def call() -> np.ndarray:
        out = simulate_fmu(
            unpacked, model_description=described, fmi_type="ModelExchange", stop_time=40.0, output_interval=0.02,
            relative_tolerance=tolerance, solver="CVode", input=signal, output=list(OUTPUTS), validate=False,
        )  # fmt: skip
        last = np.append(np.diff(out["time"]) > 0.0, True)  # at the jump there is a row before it and one after
        return np.stack([out[name][last] for name in OUTPUTS], axis=1)

    return call


def pairs(model: Model, folder: Path, stack: ExitStack) -> Iterator[Pair]:
    """Pose all comparisons."""
    problem, values = paper_problem(model), nominal(model)
    batch, large, few = (nominal(model, count) for count in (100, 1000, 50))
    here, one, two = (stack.enter_context(WorkerPool(count)) for count in (0, 1, 2))
    local, single, double = (NativeSimulator(problem, pool=pool) for pool in (here, one, two))
    exact = fmpy_route(model, folder, 1e-10)()
    error = float(np.max(np.abs(local.simulate(values).outputs[0][0] - exact) / np.ptp(exact, axis=0)))
    yield Pair(
        "engine_over_fmpy_me", "one run: FMPy, Model Exchange, CVode / engine, batch of 100, one core",
        fmpy_route(model, folder), lambda: single.simulate(batch), (1, 100), error,
    )  # fmt: skip
    yield Pair(
        "two_cores_over_one", "log-likelihood, batch of 1000: one core / two cores",
        lambda: single.log_likelihood(large, WHITE), lambda: double.log_likelihood(large, WHITE),
    )  # fmt: skip
    yield Pair(
        "sensitivities_over_plain", "trajectories with 8 sensitivities / without",
        lambda: local.simulate(few, active=range(8)), lambda: local.simulate(few), error=error,
    )  # fmt: skip


def measured(rounds: int) -> Iterator[Row]:
    """Time all pairs."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        model = Model.load(export_fmu("Aero.Systems.OneDof", Path(name) / "OneDof.fmu"))
        for pair in pairs(model, Path(name), stack):
            yield time_pair(pair, rounds)

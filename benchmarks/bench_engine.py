"""The engine beside what else can run the same FMU, and beside a plain loop in C.

The paper's experiment (24 V for 20 s, 0 V for 20 s, 2,001 samples of three outputs) at one tolerance for all routes;
errors are measured against FMPy's CVode at a tolerance of 1e-10. Another comparison is another :class:`Pair` in
:func:`pairs`.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from harness import Pair, Row, time_pair, update

from aero_bayes.modelica.build import c_compiler
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Experiment, InputSignal, ParameterTarget, Problem, SolverSettings
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import NativeSimulator
from aero_bayes.simulation.workers import WorkerPool

OUTPUTS = ("i_m", "omega_m", "theta")
PARAMETERS = ("R_a", "c_m", "J_r", "k_d", "k_t", "D_p", "K_sp", "L_a")
TOLERANCE = 1e-6
WHITE = np.array([1.0, 0.0, 0.0])
Route = Callable[[], np.ndarray]


def paper_problem(model: Model, moving: bool = False) -> Problem:
    """Pose the paper's experiment, or one whose voltage moves at each sample, with eight parameters free."""
    time = np.linspace(0.0, 40.0, 2001)
    signal = InputSignal("V_m", np.array([0.0, 20.0]), np.array([24.0, 0.0]))
    if moving:
        noise = np.random.default_rng(3).standard_normal(time.size)
        signal = InputSignal("V_m", time, 12.0 + 6.0 * np.sin(0.6 * time) + 3.0 * np.sin(4.4 * time + 1.0) + noise)
    what = Experiment(time, OUTPUTS, (signal,), measured=np.zeros((time.size, 3)))
    targets = tuple(ParameterTarget(name) for name in PARAMETERS)
    return Problem(model, (what,), (targets,), settings=SolverSettings(TOLERANCE, TOLERANCE))


def nominal(model: Model, n: int = 1) -> np.ndarray:
    """Return the model's own values, n rows varied by 2 %."""
    values = np.array([model.parameter(name).start for name in PARAMETERS], dtype=float)
    return values * np.exp(0.02 * np.random.default_rng(0).standard_normal((n, len(PARAMETERS))) * (n > 1))


def fmpy_route(model: Model, folder: Path) -> Route:
    """Return Model Exchange with CVode by FMPy as a user would write it, unpacked, described and loaded once."""
    from fmpy import extract, read_model_description, simulate_fmu

    unpacked = extract(str(model.path), str(folder / "fmpy"))
    described = read_model_description(unpacked)
    signal = np.array([(0.0, 24.0), (20.0, 24.0), (20.0, 0.0), (40.0, 0.0)], dtype=[("time", "f8"), ("V_m", "f8")])

    def call() -> np.ndarray:
        out = simulate_fmu(
            unpacked, model_description=described, fmi_type="ModelExchange", stop_time=40.0, output_interval=0.02,
            relative_tolerance=TOLERANCE, solver="CVode", input=signal, output=list(OUTPUTS), validate=False,
        )  # fmt: skip
        last = np.append(np.diff(out["time"]) > 0.0, True)  # at the jump there is a row before it and one after
        return np.stack([out[name][last] for name in OUTPUTS], axis=1)

    return call


def casadi_route(model: Model, folder: Path) -> Route:
    """Return CasADi, which imports the FMU: cvodes, one segment either side of the jump."""
    import casadi
    from fmpy import extract

    dae = casadi.DaeBuilder("aero", str(extract(str(model.path), str(folder / "casadi"))))
    f = dae.create("f", ["x", "u"], ["ode"])
    x, u = casadi.MX.sym("x", f.numel_in(0)), casadi.MX.sym("u")
    time = np.linspace(0.0, 40.0, 2001)
    options = {"reltol": TOLERANCE, "abstol": TOLERANCE}
    integrators = [
        casadi.integrator(f"part{k}", "cvodes", {"x": x, "u": u, "ode": f(x, u)}, part[0], part, options)
        for k, part in enumerate((time[:1001], time[1000:]))
    ]
    rows = [list(dae.x()).index(name) for name in OUTPUTS]

    def call() -> np.ndarray:
        first = np.array(integrators[0](x0=0.0, u=24.0)["xf"])
        second = np.array(integrators[1](x0=first[:, -1], u=0.0)["xf"])
        return np.concatenate([first[rows, :-1], second[rows]], axis=1).T

    return call


def plain_loop(model: Model, problem: Problem, exact: np.ndarray, folder: Path) -> Route:
    """Return the model by hand in C (``plain_loop.c``) with the fewest steps, a power of two, within 1e-6 of exact."""
    source, library = Path(__file__).with_name("plain_loop.c"), folder / "plain_loop.so"
    flags = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC", str(source), "-o", str(library)]
    subprocess.run([*c_compiler(), *flags], check=True)
    loop = ctypes.CDLL(str(library)).aero_loop
    time, signal = problem.experiments[0].time, problem.experiments[0].inputs[0]
    level = signal.values[np.searchsorted(signal.time, time + 1e-9, side="right") - 1]
    names = ("R_a", "L_a", "c_m", "J_r", "k_d", "k_t", "J_p", "D_p", "K_sp", "D_t")
    values = np.array([float(model.parameter(name).start) for name in names])
    values[3] += float(model.parameter("J_s").start)
    out = np.empty(exact.shape)
    pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (time, level, values, out)]

    def call() -> np.ndarray:
        loop(ctypes.c_long(time.size), *pointers[:3], ctypes.c_long(parts), pointers[3])
        return out

    for power in range(11):
        parts = 2**power
        if _error(call(), exact) <= 1e-6:
            return call
    raise RuntimeError("the plain loop does not meet the reference")


def _error(out: np.ndarray, exact: np.ndarray) -> float:
    """Return the largest error over the range, of all outputs."""
    return float(np.max(np.abs(out - exact) / np.ptp(exact, axis=0)))


def _exact(problem: Problem, engine: Literal["fmpy", "native"]) -> np.ndarray:
    tight = SolverSettings(1e-10, 1e-10, max_steps=10_000_000, time_limit=100.0)
    with open_simulator(replace(problem, settings=tight), engine, workers=0) as reference:
        return np.array(reference.simulate(nominal(problem.model)).outputs[0][0])


def pairs(model: Model, folder: Path, stack: ExitStack) -> Iterator[Pair | Row]:
    """Pose all comparisons; what is not installed is a row without a figure."""
    step, moving = paper_problem(model), paper_problem(model, moving=True)
    exact, values, batch = _exact(step, "fmpy"), nominal(model), nominal(model, 100)
    here, one, two = (stack.enter_context(WorkerPool(count)) for count in (0, 1, 2))
    local, single, double = (NativeSimulator(step, pool=pool) for pool in (here, one, two))
    error = _error(local.simulate(values).outputs[0][0], exact)
    for key, name, make in (
        ("engine_over_fmpy_me", "one run: FMPy, Model Exchange, CVode / engine, batch of 100, one core", fmpy_route),
        ("engine_over_casadi", "one run: CasADi, cvodes / engine, batch of 100, one core", casadi_route),
    ):
        try:
            route = make(model, folder)
            route()
        except Exception as problem:  # another tool's failure is a line in the table, not the end of it
            yield Row(key, name, note=(str(problem).splitlines() or ["?"])[0])
        else:
            yield Pair(key, name, route, lambda: single.simulate(batch), (1, 100), error)
    fast, loop = NativeSimulator(moving, pool=here), plain_loop(model, moving, _exact(moving, "native"), folder)
    many = np.repeat(values, 10, axis=0)
    yield Pair(
        "over_plain_c", "voltage that moves at each sample: engine, log-likelihood / plain loop in C",
        lambda: fast.log_likelihood(many, WHITE), lambda: [loop() for _ in many], (10, 10),
    )  # fmt: skip
    large = nominal(model, 1000)
    yield Pair(
        "two_cores_over_one", "log-likelihood, batch of 1000: one core / two cores",
        lambda: single.log_likelihood(large, WHITE), lambda: double.log_likelihood(large, WHITE),
    )  # fmt: skip
    few = nominal(model, 50)
    yield Pair(
        "sensitivities_over_plain", "trajectories with 8 sensitivities / without",
        lambda: local.simulate(few, active=range(8)), lambda: local.simulate(few), error=error,
    )  # fmt: skip


def run(out: Path, rounds: int) -> None:
    """Time all pairs and write them to ``out``/bench.json."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        model = Model.load(export_fmu("Aero.Systems.OneDof", folder / "OneDof.fmu"))
        for pair in pairs(model, folder, stack):
            row = pair if isinstance(pair, Row) else time_pair(pair, rounds)
            update(out / "bench.json", [row], {} if row.error is None else {"max_relative_error": row.error})

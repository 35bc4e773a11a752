"""The engine beside what else can run the same FMU, in one run: ``python benchmarks/bench_engine.py``.

The paper's experiment (24 V for 20 s, 0 V for 20 s, 2,001 samples of three outputs) at one tolerance for all routes;
each route's error is measured against FMPy's CVode at a tolerance of 1e-10. Writes the contract's keys and its rows to
``reports/bench.json``.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from bench_growth import memory, states
from harness import Route, TimingRow, ratio, time_routes, update

from aero_bayes.export import export_fmu
from aero_bayes.simulation import (
    Experiment,
    InputSignal,
    Model,
    NativeSimulator,
    ParameterTarget,
    Problem,
    SolverSettings,
    WorkerPool,
    open_simulator,
)

OUTPUTS = ("i_m", "omega_m", "theta")
PARAMETERS = ("R_a", "c_m", "J_r", "k_d", "k_t", "D_p", "K_sp", "L_a")
GROUPS = ("one run", "cores", "sensitivities", "noise", "growth", "states")
TOLERANCE = 1e-6


def paper_experiment(samples: int = 2001, seconds: float = 40.0) -> Experiment:
    """Make the paper's experiment: 24 V, then 0 V from half time on."""
    time = np.linspace(0.0, seconds, samples)
    signal = InputSignal("V_m", np.array([0.0, seconds / 2]), np.array([24.0, 0.0]))
    return Experiment(time, OUTPUTS, (signal,), measured=np.zeros((samples, 3)))


def paper_problem(model: Model, what: Experiment, tolerance: float = TOLERANCE) -> Problem:
    """Pose the problem with eight parameters free."""
    targets = tuple(ParameterTarget(name) for name in PARAMETERS)
    return Problem(model, (what,), (targets,), settings=SolverSettings(tolerance, tolerance))


def nominal(model: Model, n: int = 1) -> np.ndarray:
    """Return the model's own values, n rows varied by 2 %."""
    values = np.array([model.parameter(name).start for name in PARAMETERS], dtype=float)
    return values * np.exp(0.02 * np.random.default_rng(0).standard_normal((n, len(PARAMETERS))) * (n > 1))


def fmpy_route(model: Model, kind: str, folder: Path) -> Any:
    """Time FMPy as a user would write it, unpacked, described and loaded once."""
    from fmpy import extract, read_model_description, simulate_fmu

    unpacked = extract(str(model.path), str(folder / kind))
    described = read_model_description(unpacked)
    signal = np.array([(0.0, 24.0), (20.0, 24.0), (20.0, 0.0), (40.0, 0.0)], dtype=[("time", "f8"), ("V_m", "f8")])

    def call() -> np.ndarray:
        out = simulate_fmu(
            unpacked,
            model_description=described,
            fmi_type=kind,
            stop_time=40.0,
            output_interval=0.02,
            relative_tolerance=TOLERANCE,
            solver="CVode",
            input=signal,
            output=list(OUTPUTS),
            validate=False,
        )
        last = np.append(np.diff(out["time"]) > 0.0, True)  # at the jump there is a row before it and one after
        return np.stack([out[name][last] for name in OUTPUTS], axis=1)

    return call


def casadi_route(model: Model, folder: Path) -> Any:
    """Time CasADi, which imports the FMU: cvodes, one segment either side of the jump."""
    import casadi
    from fmpy import extract

    unpacked = extract(str(model.path), str(folder / "casadi"))
    dae = casadi.DaeBuilder("aero", str(unpacked))
    f = dae.create("f", ["x", "u"], ["ode"])
    x, u = casadi.MX.sym("x", f.numel_in(0)), casadi.MX.sym("u")
    time = np.linspace(0.0, 40.0, 2001)
    parts = [time[:1001], time[1000:]]
    options = {"reltol": TOLERANCE, "abstol": TOLERANCE}
    integrators = [
        casadi.integrator(f"part{k}", "cvodes", {"x": x, "u": u, "ode": f(x, u)}, part[0], part, options)
        for k, part in enumerate(parts)
    ]
    names = list(dae.x())
    rows = [names.index(name) for name in OUTPUTS]

    def call() -> np.ndarray:
        first = np.array(integrators[0](x0=0.0, u=24.0)["xf"])
        second = np.array(integrators[1](x0=first[:, -1], u=0.0)["xf"])
        return np.concatenate([first[rows, :-1], second[rows]], axis=1).T

    return call


def one_run(model: Model, folder: Path, rounds: int) -> tuple[dict[str, TimingRow], float]:
    """Time every route for the same run."""
    what = paper_problem(model, paper_experiment())
    tight = replace(what, settings=replace(what.settings, relative_tolerance=1e-10, absolute_tolerance=1e-10))
    values, batch = nominal(model), nominal(model, 100)
    with open_simulator(tight, "fmpy") as reference:
        exact = reference.simulate(values).outputs[0][0]
    span = np.ptp(exact, axis=0)

    def error(out: np.ndarray) -> float:
        return float(np.max(np.abs(out - exact) / span))

    routes, engine_error = [], 0.0
    candidates = {
        "FMPy, Model Exchange, CVode": lambda: fmpy_route(model, "ModelExchange", folder),
        "FMPy, Co-Simulation": lambda: fmpy_route(model, "CoSimulation", folder),
        "CasADi importing the FMU, cvodes": lambda: casadi_route(model, folder),
    }
    for name, make in candidates.items():
        try:
            call = make()
            routes.append(Route("one run", name, call, error=error(call())))
        except Exception as problem_found:  # another tool's failure is a line in the table, not the end of it
            print(f"{name}: not run ({str(problem_found).splitlines()[0]})")
    reference_simulator = open_simulator(what, "fmpy")
    routes.append(
        Route("one run", "FMPy as the project's reference engine", lambda: reference_simulator.simulate(values))
    )
    with WorkerPool(0) as here, WorkerPool(1) as one, reference_simulator:
        local, remote = NativeSimulator(what, pool=here), NativeSimulator(what, pool=one)
        engine_error = error(local.simulate(values).outputs[0][0])
        routes += [
            Route("one run", "engine, one run a call, in process", lambda: local.simulate(values), error=engine_error),
            Route("one run", "engine, one run a call, worker", lambda: remote.simulate(values), error=engine_error),
            Route("one run", "engine, batch of 100, one core", lambda: remote.simulate(batch), 100, engine_error),
        ]
        rows = time_routes(routes, rounds)
    return rows, engine_error


def cores(model: Model, rounds: int) -> dict[str, TimingRow]:
    """Time the same batch on one and on two workers."""
    what = paper_problem(model, paper_experiment())
    values, noise = nominal(model, 1000), np.array([1.0, 0.0, 0.0])
    with WorkerPool(1) as one, WorkerPool(2) as two:
        a, b = NativeSimulator(what, pool=one), NativeSimulator(what, pool=two)
        routes = [
            Route("cores", "log-likelihood, batch of 1000, one core", lambda: a.log_likelihood(values, noise), 1000),
            Route("cores", "log-likelihood, batch of 1000, two cores", lambda: b.log_likelihood(values, noise), 1000),
        ]
        return time_routes(routes, rounds)


def sensitivities(model: Model, rounds: int) -> dict[str, TimingRow]:
    """Time runs without and with sensitivities, as trajectories and reduced."""
    what = paper_problem(model, paper_experiment())
    values, noise = nominal(model, 50), np.array([1.0, 0.0, 0.0])
    with WorkerPool(0) as here:
        s = NativeSimulator(what, pool=here)
        routes = [Route("sensitivities", "trajectories", lambda: s.simulate(values), 50)]
        for q in (1, 2, 4, 8):
            active = range(q)
            routes.append(
                Route(
                    "sensitivities",
                    f"trajectories and {q} sensitivities",
                    lambda active=active: s.simulate(values, active=active),
                    50,
                )
            )
        routes += [
            Route("sensitivities", "log-likelihood", lambda: s.log_likelihood(values, noise), 50),
            Route("sensitivities", "Gauss-Newton, 8", lambda: s.gauss_newton(values, noise, active=range(8)), 50),
        ]
        return time_routes(routes, rounds)


def noise(model: Model, rounds: int) -> dict[str, TimingRow]:
    """Time white against correlated noise at 30,000 samples."""
    what = paper_problem(model, paper_experiment(30_001, 30.0))
    values = nominal(model, 20)
    with WorkerPool(0) as here:
        s = NativeSimulator(what, pool=here)
        routes = [
            Route("noise", f"30,001 samples, {name}", lambda sd=sd: s.log_likelihood(values, np.array(sd)), 20)
            for name, sd in (("white", (1.0, 0.0, 0.0)), ("white + Ornstein-Uhlenbeck", (1.0, 0.5, 0.1)))
        ]
        return time_routes(routes, rounds)


def growth(model: Model, rounds: int) -> dict[str, TimingRow]:
    """Time runs over samples, recordings, tolerance and batch."""
    routes = []
    white = np.array([1.0, 0.0, 0.0])
    with WorkerPool(0) as here:
        for samples in (2_001, 20_001, 200_001):
            s = NativeSimulator(paper_problem(model, paper_experiment(samples)), pool=here)
            v = nominal(model, 5)
            routes.append(Route("growth", f"{samples:,} samples", lambda s=s, v=v: s.log_likelihood(v, white), 5))
        for count in (1, 4, 16):
            base = paper_problem(model, paper_experiment())
            many = replace(base, experiments=base.experiments * count, targets=base.targets * count)
            s = NativeSimulator(many, pool=here)
            v = nominal(model, 5)
            routes.append(Route("growth", f"{count} recordings", lambda s=s, v=v: s.log_likelihood(v, white), 5))
        for tolerance in (1e-4, 1e-5, 1e-6, 1e-8):
            s = NativeSimulator(paper_problem(model, paper_experiment(), tolerance), pool=here)
            v = nominal(model, 20)
            routes.append(Route("growth", f"tolerance {tolerance:g}", lambda s=s, v=v: s.log_likelihood(v, white), 20))
        for n in (1, 10, 100, 1000):
            s = NativeSimulator(paper_problem(model, paper_experiment()), pool=here)
            v = nominal(model, n)
            routes.append(Route("growth", f"batch of {n}", lambda s=s, v=v: s.log_likelihood(v, white), n))
        return time_routes(routes, rounds)


def run(out: Path, rounds: int = 15, fmu: Path | None = None) -> None:
    """Run all groups and write them to `out`/bench.json."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = Model.load(fmu or export_fmu("Aero.Systems.OneDof", folder / "OneDof.fmu"))
        table, error = one_run(model, folder, rounds)
        for group in (cores, sensitivities, noise, growth):
            table |= group(model, rounds)
        table |= states(folder, rounds)
        grown = memory(folder)
    ratios = {
        "engine_over_fmpy_me": ("FMPy, Model Exchange, CVode", "engine, batch of 100, one core"),
        "two_cores_over_one": (
            "log-likelihood, batch of 1000, one core",
            "log-likelihood, batch of 1000, two cores",
        ),
        "sensitivities_over_plain": ("trajectories and 8 sensitivities", "trajectories"),
        "gauss_newton_over_likelihood": ("Gauss-Newton, 8", "log-likelihood"),
        "ten_times_the_samples": ("200,001 samples", "20,001 samples"),
        "sixteen_recordings": ("16 recordings", "1 recordings"),
        "correlated_over_white": ("30,001 samples, white + Ornstein-Uhlenbeck", "30,001 samples, white"),
    }
    keys: dict[str, float | None] = {
        key: ratio(table[a].seconds, table[b].seconds) if a in table and b in table else None
        for key, (a, b) in ratios.items()
    }
    keys["time_over_linear_in_samples"] = keys.pop("ten_times_the_samples") / 10.0
    keys["time_over_linear_in_recordings"] = keys.pop("sixteen_recordings") / 16.0
    keys["memory_growth_mib"] = grown
    keys["max_relative_error"] = error
    update(out / "bench.json", keys, list(table.values()), GROUPS)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--fmu", type=Path, help="an AERO FMU already built")
    parser.add_argument("--out", type=Path, default=Path("reports"))
    options = parser.parse_args()
    run(options.out, options.rounds, options.fmu)


if __name__ == "__main__":
    main()

"""What a user would pick instead: PINTS on FMPy (M. Clerx et al., 2019, J. Open Res. Softw. 7, 23).

The same recording, parameters and noise as in ``bench_sampling``: PINTS' particle swarm and its default sampler
(adaptive Metropolis, Haario-Bardenet), the model simulated by FMPy as its documentation shows. A chain of the needed
length would take FMPy hours; PINTS therefore walks through the engine, and FMPy's seconds an evaluation, timed over a
few, give the time that the same chain would have taken.
"""

from __future__ import annotations

import importlib.util
import time
from pathlib import Path
from typing import Any

import numpy as np
from bench_density import density
from harness import TimingRow, missing

from aero_bayes.estimate import Fit
from aero_bayes.estimate.swarm import SwarmSettings, minimise
from aero_bayes.estimate.target import Target
from aero_bayes.sampling.diagnostics import check_convergence
from aero_bayes.simulation import DelayTarget, ParameterTarget, StartTarget, open_simulator

GROUPS = ("swarm", "pints")
SAMPLER, SAMPLER_SLOW = "PINTS adaptive Metropolis, engine", "PINTS adaptive Metropolis, FMPy"
SWARM, SWARM_SLOW = "swarm of 40, engine", "PINTS swarm of 40, FMPy"
CHAINS, STEPS = 4, 6000


def installed() -> bool:
    """Return whether the optional package is there."""
    return importlib.util.find_spec("pints") is not None


def fmpy_posterior(fit: Fit, target: Target, folder: Path) -> Any:
    """Make the log-posterior as a PINTS user writes it, up to a constant: FMPy behind a ForwardModel, known noise."""
    import pints
    from fmpy import extract, read_model_description, simulate_fmu

    problem = target.simulator.problem
    experiment, row = problem.experiments[0], problem.targets[0]
    unpacked = extract(str(problem.model.path), str(folder / "pints"))
    described = read_model_description(str(unpacked))
    grid = experiment.time

    class AeroModel(pints.ForwardModel):  # type: ignore[misc]
        def n_parameters(self) -> int:
            return len(fit.free)

        def n_outputs(self) -> int:
            return len(experiment.outputs)

        def simulate(self, parameters: np.ndarray, times: np.ndarray) -> np.ndarray:
            values = target.values(np.asarray(parameters)[None])[0]
            start = {**problem.fixed, **experiment.start}
            delay = 0.0
            for value, what in zip(values, row, strict=True):
                if isinstance(what, ParameterTarget):
                    start[what.name] = value
                elif isinstance(what, StartTarget):
                    start[what.state] = value
                elif isinstance(what, DelayTarget):
                    delay += value
            out = simulate_fmu(
                unpacked,
                model_description=described,
                fmi_type="ModelExchange",
                solver="CVode",
                start_time=grid[0],
                stop_time=grid[-1],
                output_interval=grid[1] - grid[0],
                relative_tolerance=problem.settings.relative_tolerance,
                start_values=start,
                input=stepped(experiment.inputs[0], delay, grid[-1]),
                output=list(experiment.outputs),
                record_events=False,
                validate=False,
            )
            return np.stack([np.interp(times, out["time"], out[name]) for name in experiment.outputs], axis=1)

    sds = [fit.noise[name].sd_white for name in experiment.outputs]
    measured = pints.MultiOutputProblem(AeroModel(), grid - grid[0], experiment.measured)
    likelihood = pints.GaussianKnownSigmaLogLikelihood(measured, sds)
    return lambda point: likelihood(point) + float(target.parameters.log_prior(np.asarray(point)[None])[0])


def stepped(signal: Any, delay: float, end: float) -> np.ndarray:
    """Write a held signal as FMPy takes it: two rows at every jump."""
    rows = [(min(0.0, signal.time[0]), signal.values[0])]
    for t, before, after in zip(signal.time[1:] + delay, signal.values[:-1], signal.values[1:], strict=True):
        if before != after and t < end:
            rows += [(t, before), (t, after)]
    rows.append((end, rows[-1][1]))
    return np.array(rows, dtype=[("time", "f8"), (signal.name, "f8")])


def swarm_rows(fit: Fit, slow: float | None, iterations: int = 30) -> list[TimingRow]:
    """Measure the seconds of an evaluation of the swarm search over the whole prior box."""
    with open_simulator(fit.calibration.problem()) as simulator:
        target = Target(fit.calibration, simulator, fit.values, fit.free)
        value = density(fit, target)
        low, high = target.box
        middle = 0.5 * (low + high)[None]  # where PINTS' swarm starts too
        settings = SwarmSettings(iterations=iterations, patience=iterations)
        minimise(lambda x: -value(x), low, high, np.random.default_rng(1), SwarmSettings(iterations=2))
        began = time.perf_counter()
        found = minimise(lambda x: -value(x), low, high, np.random.default_rng(1), settings, middle)
        each = (time.perf_counter() - began) / found.evaluations
        rows = [
            TimingRow("swarm", SWARM, each, each, each, None, f"best cost {found.cost:.0f} after {found.evaluations}")
        ]
        if slow is None:
            return [*rows, missing("swarm", SWARM_SLOW, "PINTS")]
        best = pints_swarm(value, low, high, found.evaluations)
    note = f"best cost {best:.0f} after as many (walked through the engine)"
    return [*rows, TimingRow("swarm", SWARM_SLOW, slow, slow, slow, None, note)]


def pints_swarm(value: Any, low: np.ndarray, high: np.ndarray, evaluations: int) -> float:
    """Return the best cost that PINTS' swarm reaches with so many evaluations."""
    import pints

    np.random.seed(1)  # noqa: NPY002  PINTS draws from NumPy's global generator
    middle = 0.5 * (low + high)
    swarm = pints.PSO(middle, (high - low) / 6.0, pints.RectangularBoundaries(low, high))
    swarm.set_population_size(40)
    for _ in range(evaluations // 40):
        points = np.array(swarm.ask())
        cost = -value(points)
        swarm.tell(np.where(np.isfinite(cost), cost, 1e30))
    return float(swarm.f_best())


def chain_rows(fit: Fit, slow: float | None) -> list[TimingRow]:
    """Measure the seconds of an effective sample of the worst parameter, burn-in (the first half) included."""
    if slow is None:
        return [missing("pints", name, "PINTS") for name in (SAMPLER, SAMPLER_SLOW)]
    import pints

    d = len(fit.free)
    np.random.seed(1)  # noqa: NPY002
    with open_simulator(fit.calibration.problem(), workers=0) as simulator:
        value = density(fit, Target(fit.calibration, simulator, fit.values, fit.free))

        class Posterior(pints.LogPDF):  # type: ignore[misc]
            def n_parameters(self) -> int:
                return d

            def __call__(self, point: np.ndarray) -> float:
                return float(value(np.asarray(point)[None])[0])

        rng = np.random.default_rng(5)
        starts = fit.laplace.mean[:d] + fit.laplace.sd[:d] * rng.standard_normal((CHAINS, d))
        run = pints.MCMCController(Posterior(), CHAINS, starts, fit.laplace.sd[:d] ** 2)
        run.set_max_iterations(STEPS)
        run.set_log_to_screen(False)
        began = time.perf_counter()
        chains = np.asarray(run.run())[:, STEPS // 2 :]
        seconds = time.perf_counter() - began
    found = [check_convergence(chains[:, :, j : j + 1]) for j in range(d)]
    ess = min(f.ess_bulk for f in found)
    total = CHAINS * STEPS
    text = f"{ess:.0f} effective of {total} evaluations, R-hat {max(f.r_hat for f in found):.4f}"
    each, each_slow = seconds / ess, slow * total / ess
    return [
        TimingRow("pints", SAMPLER, each, each, each, None, f"{text}, {seconds:.1f} s"),
        TimingRow(
            "pints", SAMPLER_SLOW, each_slow, each_slow, each_slow, None, f"{text}, projected {slow * total:.0f} s"
        ),
    ]


def pints_fmpy_seconds(fit: Fit, folder: Path, evaluations: int) -> float:
    """Measure the median seconds of one evaluation of PINTS' log-posterior through FMPy."""
    with open_simulator(fit.calibration.problem(), workers=0) as simulator:
        target = Target(fit.calibration, simulator, fit.values, fit.free)
        posterior = fmpy_posterior(fit, target, folder)
        rng = np.random.default_rng(3)
        d, seconds = len(fit.free), []
        for _ in range(evaluations + 1):
            point = fit.laplace.mean[:d] + 0.5 * fit.laplace.sd[:d] * rng.standard_normal(d)
            began = time.perf_counter()
            posterior(point)
            seconds.append(time.perf_counter() - began)
    return float(np.median(seconds[1:]))


def rows(fit: Fit, folder: Path, evaluations: int = 15) -> list[TimingRow]:
    """Return all rows; those of PINTS say so where it is not installed."""
    slow = pints_fmpy_seconds(fit, folder, evaluations) if installed() else None
    return swarm_rows(fit, slow) + chain_rows(fit, slow)

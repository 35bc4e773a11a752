"""Effective samples a second of the AERO posterior, beside what a user would pick instead.

One simulated recording (the paper's experiment, 40 s, 2,001 samples of three outputs with white noise) is fitted; eight
parameters (the seven physical ones and the input's delay) are sampled with the noise held as fitted, by the program's
own moves and by emcee's plain stretch move, both through the engine. Through FMPy the latter would need hours: its time
there is that of as many evaluations, timed over a few. Effective samples are those of the worst parameter
(rank-normalised bulk ESS over independent ensembles), burn-in included in the time of each.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench_engine import fmpy_route
from emcee.moves import StretchMove
from harness import Row
from threadpoolctl import threadpool_limits

from aero_bayes.estimate import CalibrationSettings, NoiseModel
from aero_bayes.estimate.convergence import SampleSettings
from aero_bayes.estimate.fit import fit
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.log_posterior import LogPosterior
from aero_bayes.estimate.mcmc import MakeMoves, run_chain, standard_moves
from aero_bayes.estimate.moves import WarpedStudentT
from aero_bayes.estimate.result import Fit
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.model import Model
from simulated_rigs.aero import Truth, simulate_recording
from simulated_rigs.designs import paper_step
from simulated_rigs.sensors import white

#: Minutes after which each of our samplers is stopped; effective samples are counted by the second.
TIME_LIMIT = 1.0
OURS = SampleSettings(max_steps=400, ess=1e9, max_minutes=TIME_LIMIT)
STRETCH = SampleSettings(burn_in=600, max_rounds=1, max_steps=2500, ess=1e9, lengths=100.0, max_minutes=TIME_LIMIT)
Density = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Sampled:
    """What a sampler did: seconds, evaluations, effective samples of the worst parameter, R-hat."""

    seconds: float
    evaluations: int
    ess: float
    r_hat: float

    @property
    def each(self) -> float | None:
        """Seconds of an effective sample; None where there is none."""
        return self.seconds / self.ess if self.ess > 0.0 else None

    def __str__(self) -> str:
        return f"{self.ess:.0f} effective of {self.evaluations} in {self.seconds:.1f} s, R-hat {self.r_hat:.3f}"


def paper_fit(folder: Path) -> Fit:
    """Simulate the paper's experiment and fit it."""
    model = Model.load(export_fmu("Aero.Systems.OneDof", folder / "OneDof.fmu"))
    truth, rng = Truth(input_delay=0.006), np.random.default_rng(2)
    recording = simulate_recording(truth, paper_step(), white(1.0), rng, duration=40.0, rate_hz=50.0)
    settings = FitSettings(
        method="local", calibration=CalibrationSettings(initial_states="reading"), noise=NoiseModel("white")
    )
    return fit(recording, model, settings=settings)


def density(fit: Fit, target: LogPosterior) -> Density:
    """Make the log-posterior of the eight parameters with the noise held."""
    noise = target.objective.noise_rows(fit.noise)

    def value(points: np.ndarray) -> np.ndarray:
        total = np.full(len(points), -np.inf)
        inside = np.isfinite(target.parameters.log_prior(points))
        if inside.any():
            total[inside] = -target.cost(points[inside], noise)
        return total

    return value


def own_sampler(fit: Fit, value: Density, settings: SampleSettings, moves: MakeMoves = standard_moves) -> Sampled:
    """Run the program's sampler with some moves."""
    d = len(fit.free)
    proposal = WarpedStudentT.of(fit.laplace.mean[:d], fit.laplace.covariance[:d, :d], settings.dof)
    began = time.perf_counter()
    chain = run_chain(value, proposal, settings, 1, moves=moves)
    seconds = time.perf_counter() - began
    ess, r_hat = (chain.worst.ess_bulk, chain.worst.r_hat) if chain.diagnoses else (0.0, np.nan)
    return Sampled(seconds, chain.evaluations, ess, r_hat)


def fmpy_seconds(model: Model, evaluations: int) -> float:
    """Measure the median seconds of one run of the paper's experiment by FMPy, which is all of an evaluation."""
    seconds = []
    with tempfile.TemporaryDirectory() as folder:
        run = fmpy_route(model, Path(folder))
        for _ in range(evaluations + 1):
            began = time.perf_counter()
            run()
            seconds.append(time.perf_counter() - began)
    return statistics.median(seconds[1:])


def compared(key: str, name: str, own: Sampled, other: Sampled, per_evaluation: float | None = None) -> Row:
    """Compare seconds of an effective sample; ``per_evaluation`` projects the other's to another engine."""
    each = other.each
    if per_evaluation is not None and other.ess > 0.0:
        each = per_evaluation * other.evaluations / other.ess
    ratio = each / own.each if each and own.each else None
    projected = "" if per_evaluation is None else f"; projected with {1e3 * per_evaluation:.1f} ms an evaluation"
    return Row(key, f"effective samples/s: {name}", each, own.each, ratio, note=f"{other}{projected}; own: {own}")


def rows(fit: Fit, evaluations: int) -> Iterator[Row]:
    """Run all samplers, and return each comparison as it ends."""
    with open_simulator(fit.calibration.problem()) as simulator:
        value = density(fit, LogPosterior(fit.calibration, simulator, fit.values, fit.free))
        value(fit.laplace.mean[None, : len(fit.free)])
        own = own_sampler(fit, value, OURS)
        stretch = own_sampler(fit, value, STRETCH, lambda adaptation, prior: [(StretchMove(), 1.0)])
        yield compared("ess_per_s_over_stretch", "own moves / emcee's stretch move, same engine", own, stretch)
        slow = fmpy_seconds(fit.calibration.model, evaluations)
        yield compared("ess_per_s_over_fmpy", "own moves / emcee's stretch move on FMPy", own, stretch, slow)


def measured(rounds: int) -> Iterator[Row]:
    """Measure on one core."""
    # As in `sample`: BLAS threads on small matrices wait for each other, without an end in sight on a busy machine.
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(limits=1, user_api="blas"):
        yield from rows(paper_fit(Path(folder)), max(10, rounds))

"""Effective samples a second of the AERO posterior: ``python benchmarks/bench_sampling.py``.

One simulated recording (the paper's experiment, 40 s, 2,001 samples of three outputs with white noise) is fitted; eight
parameters (the seven physical ones and the input's delay) are sampled with the noise held as fitted. Three samplers of
the same posterior, started from the same Laplace approximation:

- the program's own moves, by delayed acceptance with a surrogate,
- emcee's plain stretch move through the same engine,
- emcee's plain stretch move through FMPy, which would need hours: its time is that of its evaluations, timed over a
  few, at the same effective samples an evaluation as through the engine,
- PINTS, through the engine and through FMPy likewise (``bench_pints``).

Effective samples are those of the worst parameter (rank-normalised bulk ESS over independent ensembles), burn-in
included in the time of each.

A second recording is read every 4 ms and has a delay of 4.05 ms, so that the posterior reaches across a corner of the
likelihood: the delay moves the jump of the input across a reading. Its whole posterior is sampled, noise included,
until the sampler stops by itself.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import bench_pints
import numpy as np
from bench_density import density
from harness import TimingRow, ratio, update
from threadpoolctl import threadpool_limits

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate import CalibrationSettings, Fit, FitSettings, NoiseModel, fit
from aero_bayes.estimate.target import Target
from aero_bayes.export import export_fmu
from aero_bayes.sampling import Chain, MakeMoves, Posterior, SampleSettings, run_chain, sample, standard_moves
from aero_bayes.sampling.moves import StretchMove, WarpedStudentT
from aero_bayes.simulation import Model, open_simulator
from simulated_rigs.aero import Parameters, Truth, simulate_recording
from simulated_rigs.designs import paper_step
from simulated_rigs.sensors import white

GROUPS = ("sampling", *bench_pints.GROUPS)
#: Minutes after which each sampler is stopped; effective samples are counted by the second.
TIME_LIMIT = 1.0
OURS = SampleSettings(max_steps=400, ess=1e9, max_minutes=TIME_LIMIT)
STRETCH = SampleSettings(
    burn_in=600, max_rounds=1, max_steps=2500, ess=1e9, lengths=100.0, max_minutes=TIME_LIMIT
)  # fmt: skip


def paper_fit(folder: Path) -> Fit:
    """Simulate the paper's experiment and fit it."""
    model = Model.load(export_fmu("Aero.Systems.OneDof", folder / "OneDof.fmu"))
    truth = Truth("one_dof", Parameters(), (), 0.006)
    rng = np.random.default_rng(2)
    recording = simulate_recording(truth, paper_step(), white(1.0), rng, duration=40.0, rate_hz=50.0)
    settings = FitSettings(
        method="local", calibration=CalibrationSettings(initial_states="reading"), noise=NoiseModel("white")
    )
    return fit(recording, model, settings=settings)


def posterior_with_delay(folder: Path) -> Posterior:
    """Sample the whole posterior of a recording whose delay may lie on either side of a reading."""
    model = Model.load(export_fmu("Aero.Systems.OneDof", folder / "WithDelay.fmu"))
    truth = Truth("one_dof", Parameters(), (), 0.00405)
    rng = np.random.default_rng(4)
    recording = simulate_recording(truth, paper_step(), white(1.0), rng, duration=20.0, rate_hz=250.0)
    settings = FitSettings(method="local", calibration=CalibrationSettings(initial_states="reading"))
    return sample(fit(recording, model, settings=settings), settings=SampleSettings(max_minutes=TIME_LIMIT), seed=1)


def sampled(fit: Fit, settings: SampleSettings, moves: MakeMoves = standard_moves) -> tuple[Chain, float]:
    """Sample a chain through the engine, and return it with the seconds it took."""
    d = len(fit.free)
    proposal = WarpedStudentT.of(fit.laplace.mean[:d], fit.laplace.covariance[:d, :d], settings.dof)
    with open_simulator(fit.calibration.problem()) as simulator:
        target = Target(fit.calibration, simulator, fit.values, fit.free)
        value = density(fit, target)
        value(fit.laplace.mean[None, :d])
        began = time.perf_counter()
        chain = run_chain(value, proposal, settings, 1, moves=moves)
        return chain, time.perf_counter() - began


def fmpy_seconds(fit: Fit, evaluations: int) -> list[float]:
    """Measure the seconds of single evaluations through FMPy."""
    d = len(fit.free)
    rng = np.random.default_rng(3)
    points = fit.laplace.mean[:d] + 0.5 * fit.laplace.sd[:d] * rng.standard_normal((evaluations + 1, d))
    seconds = []
    with open_simulator(fit.calibration.problem(), "fmpy") as simulator:
        value = density(fit, Target(fit.calibration, simulator, fit.values, fit.free))
        for point in points:
            began = time.perf_counter()
            value(point[None])
            seconds.append(time.perf_counter() - began)
    return seconds[1:]


def row(name: str, chain: Chain, seconds: float, note: str = "") -> TimingRow:
    """Make the row of the seconds of an effective sample; without a time where the limit left none."""
    each = seconds / chain.ess_bulk if chain.diagnoses and chain.ess_bulk > 0.0 else None
    if each is None:
        return TimingRow("sampling", name, None, None, None, None, f"no effective sample in {seconds:.1f} s")
    text = (
        f"{chain.ess_bulk:.0f} effective of {chain.evaluations} evaluations in {seconds:.1f} s, tau {chain.tau:.1f}, "
        f"R-hat {chain.r_hat:.4f}{', ' + note if note else ''}"
    )
    return TimingRow("sampling", name, each, each, each, None, text)


def simulations_each(posterior: Posterior) -> float | None:
    """Return the simulations of an effective sample, burn-in included; None where the limit left no sample."""
    return ratio(posterior.evaluations, min(posterior.ess_bulk_min, posterior.ess_tail_min) or None)


def simulations_row(name: str, posterior: Posterior) -> TimingRow:
    """Make the row of a posterior that the sampler ended by itself; its figure is a count, not a time."""
    text = (
        f"{simulations_each(posterior) or np.nan:.1f}: ESS {posterior.ess_bulk_min:.0f} in bulk, "
        f"{posterior.ess_tail_min:.0f} in tails, {posterior.evaluations} simulations, R-hat {posterior.r_hat_max:.4f}"
    )
    return TimingRow("sampling", name, None, None, None, None, text)


def run(out: Path, rounds: int = 15) -> None:
    """Measure, print each row as it ends, and merge them into ``out``/bench.json, so that an early end loses the rest
    alone."""
    rows: list[TimingRow] = []
    keys: dict[str, float | None] = {}

    def ended(*new: TimingRow, **more: float | None) -> None:
        rows.extend(new)
        keys.update(more)
        for line in new:
            print(line.line(), flush=True)
        update(out / "bench.json", keys, rows, GROUPS)

    # As in `sample`: BLAS threads on small matrices wait for each other, without an end in sight on a busy machine.
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(limits=1, user_api="blas"):
        found = paper_fit(Path(folder))
        ours, seconds = sampled(found, OURS)
        own = row("mix of moves, engine", ours, seconds)
        ended(own, evaluations_an_effective_sample=ratio(ours.evaluations, min(ours.ess_bulk, ours.ess_tail) or None))
        plain, seconds = sampled(found, STRETCH, lambda adaptation, prior: [(StretchMove(), 1.0)])
        stretch = row("emcee stretch, engine", plain, seconds)
        ended(stretch, ess_per_s_over_stretch=ratio(stretch.seconds, own.seconds))
        single = fmpy_seconds(found, max(10, rounds))
        slow = float(np.median(single)) * plain.evaluations
        on_fmpy = row("emcee stretch, FMPy", plain, slow, f"projected from {len(single)} evaluations")
        ended(on_fmpy, ess_per_s_over_fmpy=ratio(on_fmpy.seconds, own.seconds))
        others = bench_pints.rows(found, Path(folder), max(10, rounds))
        of = {line.name: line.seconds for line in others}
        ended(
            *others,
            ess_per_s_over_pints_on_fmpy=ratio(of[bench_pints.SAMPLER_SLOW], own.seconds),
            swarm_evaluations_per_s_over_pints_on_fmpy=ratio(of[bench_pints.SWARM_SLOW], of[bench_pints.SWARM]),
        )
        name = "simulations per effective sample on a recording with a delay"
        try:
            delayed = posterior_with_delay(Path(folder))
        except CannotFinishError as late:  # on a machine that is busy
            ended(TimingRow("sampling", name, None, None, None, None, str(late)))
        else:
            ended(
                simulations_row(name, delayed), simulations_an_effective_sample_with_a_delay=simulations_each(delayed)
            )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("reports"))
    parser.add_argument("--rounds", type=int, default=15)
    options = parser.parse_args()
    run(options.out, options.rounds)


if __name__ == "__main__":
    main()

"""Do the intervals hold what they promise? Simulation-based calibration and coverage over simulated recordings.

Every study draws the truth from the prior, simulates, fits as any recording is fitted (noise chosen by the data), and
asks where the truth ranks in the posterior. If inference is right the ranks are uniform and an interval of 90 % holds
the truth in 90 % of the studies (Talts et al., 2018, arXiv:1804.06788).

Four cells are simulated with the model itself: white and correlated noise, one and two recordings. One more has noise
so slow (above 2 % of a recording) that the program suspects a fault of the model and says so; it is shown, not
counted. Three come from the bench, which shares no code with the model: one with white noise, one with the sensors of
a real rig (correlated noise, ripple, encoder quantisation), which the noise model describes only roughly; it is shown,
not counted. In the last the model is wrong: the bench's pivot has friction that the model lacks. What its intervals can
hold is the parameters that serve best over all such recordings, those of one fit to many; it is shown, not counted.

The posterior is the Laplace approximation refined by Pareto-smoothed importance sampling; where its diagnostic says no,
and in a few studies of one recording to check it, the ensembles of the main program sample instead.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.stats import kstest

import simulated_rigs.aero as bench
from aero_bayes.data import Recording, to_experiment
from aero_bayes.estimate import (
    CalibrationSettings,
    Fit,
    FitSettings,
    ParameterSet,
    declared_overrides,
    fit,
    parameters_from_model,
)
from aero_bayes.estimate.identifiability import Status
from aero_bayes.export import export_fmu
from aero_bayes.sampling import SampleSettings, run_chain
from aero_bayes.sampling.evidence import importance_posterior
from aero_bayes.sampling.importance import WeightedSample
from aero_bayes.sampling.moves import WarpedStudentT
from aero_bayes.simulation import (
    DelayTarget,
    Model,
    ParameterTarget,
    Problem,
    Simulator,
    SolverSettings,
    StartTarget,
    open_simulator,
)
from coverage_page import TITLE, parts
from study_page import write_page
from trial_runs import run_study, study_parser, write_summary

#: Correlation times in s of each kind of correlated noise.
CORRELATION = {"correlated": (0.02, 0.25), "slow": (0.35, 1.5)}
FREE = ("R_a", "c_m", "J_r", "k_d", "k_t", "D_p", "K_sp")
OUTPUTS = ("i_m", "omega_m", "theta")
DELAY_LIMIT = 0.02
#: One study of one recording in so many is sampled beside.
CHECK_EVERY = 100
LEVELS = (0.5, 0.9)


@dataclass(frozen=True)
class Cell:
    """A kind of study: how many recordings, with which noise, made by what; ``counted`` in the summary or not."""

    name: str
    noise: str
    recordings: int
    source: str
    studies: int
    counted: bool = True


CELLS = (
    Cell("white noise, one recording", "white", 1, "model", 130),
    Cell("white noise, two recordings", "white", 2, "model", 60),
    Cell("correlated noise, one recording", "correlated", 1, "model", 150),
    Cell("correlated noise, two recordings", "correlated", 2, "model", 65),
    Cell("slow noise, one recording", "slow", 1, "model", 30, counted=False),
    Cell("bench, white noise", "white", 1, "bench", 40),
    Cell("bench, a real rig's sensors", "real", 1, "bench", 40, counted=False),
    Cell("bench, friction that the model lacks", "white", 1, "wrong", 60, counted=False),
)
#: What a wrong model is fitted to at once for its best parameters: recordings, and how much longer than one study's.
MANY, LONGER = 4, 8.0


@dataclass(frozen=True)
class StudyPlan:
    """What makes one study different from every other run of it."""

    seed: int
    duration: float
    rate_hz: float
    draws: int
    fmu_sha256: str

    @property
    def key(self) -> str:
        """Hash of the settings: rows made under other settings are not used."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:12]


def free_parameters(model: Model) -> ParameterSet:
    """Return the parameters that are fitted, with the priors of the package."""
    overrides = {name: item for name, item in declared_overrides(model).items() if name in FREE}
    return parameters_from_model(model, overrides=overrides)


def noise_like(rng: np.random.Generator, kind: str, time: np.ndarray, span: float) -> np.ndarray:
    """Draw noise of one output whose range is ``span``: white, or white plus Ornstein-Uhlenbeck, of random sizes."""
    white = span * np.exp(rng.uniform(np.log(0.002), np.log(0.02)))
    noise = white * rng.standard_normal(time.size)
    if kind in CORRELATION:
        size = white * np.exp(rng.uniform(np.log(0.5), np.log(3.0)))
        tau = np.exp(rng.uniform(*np.log(CORRELATION[kind])))
        rho = np.exp(-np.diff(time) / tau)
        slow = rng.standard_normal(time.size)
        for k in range(1, time.size):
            slow[k] = rho[k - 1] * slow[k - 1] + np.sqrt(1.0 - rho[k - 1] ** 2) * slow[k]
        noise += size * slow
    return noise


def simulate_with_model(
    rng: np.random.Generator, model: Model, truth: dict[str, float], cell: Cell, plan: StudyPlan, name: str
) -> Recording:
    """Simulate one recording with the model itself, then add noise."""
    time = np.arange(round(plan.duration * plan.rate_hz) + 1) / plan.rate_hz
    volts = bench.random_levels(rng, 24.0, plan.duration, (0.3, 2.5), 0.5).volts(time)
    blank = {output: np.zeros(time.size) for output in OUTPUTS}
    experiment = to_experiment(
        Recording(name, time, {"V_m": volts}, blank), OUTPUTS, zero_at_rest=model.declared.recording.zero_at_rest
    )
    names = tuple(truth)
    targets = (*(ParameterTarget(n) for n in names), DelayTarget(), StartTarget("theta"))
    values = [*truth.values(), rng.uniform(0.0, DELAY_LIMIT), 0.02 * rng.standard_normal()]
    problem = Problem(model, (experiment,), (targets,), settings=SolverSettings(1e-8, 1e-8))
    with open_simulator(problem, workers=0) as simulator:
        clean = simulator.simulate(np.array([values])).outputs[0][0]
    if not np.all(np.isfinite(clean)):
        raise ArithmeticError("the truth could not be simulated")
    outputs = {o: clean[:, k] + noise_like(rng, cell.noise, time, np.ptp(clean[:, k])) for k, o in enumerate(OUTPUTS)}
    return Recording(name, time, {"V_m": volts}, outputs)


def simulate_with_bench(
    rng: np.random.Generator, truth: dict[str, float], cell: Cell, plan: StudyPlan, name: str
) -> Recording:
    """Simulate one recording with the simulated AERO, which shares no code with the model."""
    rig = bench.Truth("one_dof", replace(bench.Parameters(), **truth), (), rng.uniform(0.0, DELAY_LIMIT))
    sensors = bench.real() if cell.noise == "real" else bench.white(1.0)
    volts = bench.random_levels(rng, 24.0, plan.duration, (0.3, 2.5), 0.5)
    recording = bench.simulate_recording(rig, volts, sensors, rng, duration=plan.duration, rate_hz=plan.rate_hz)
    return replace(recording, name=name)


def friction(rng: np.random.Generator, plan: StudyPlan, name: str) -> Recording:
    """Simulate a recording with friction in the pivot, all else as in the data sheet."""
    rig = bench.Truth("one_dof", bench.Parameters(), (bench.effect("pivot_coulomb_friction", tau_c=8e-4),), 5e-3)
    volts = bench.random_levels(rng, 24.0, plan.duration, (0.3, 2.5), 0.5)
    recording = bench.simulate_recording(
        rig, volts, bench.white(1.0), rng, duration=plan.duration, rate_hz=plan.rate_hz
    )
    return replace(recording, name=name)


@cache
def best_of_wrong(plan: StudyPlan, fmu: Path) -> dict[str, float]:
    """Fit the model without friction to many recordings with it: the parameters that serve best."""
    rng, long = np.random.default_rng([plan.seed, MANY]), replace(plan, duration=LONGER * plan.duration)
    found = fitted([friction(rng, long, f"r{k}") for k in range(MANY)], Model.load(fmu), rng)
    return {name: found[name].value for name in FREE}


def fitted(recordings: list[Recording], model: Model, rng: np.random.Generator) -> Fit:
    """Fit recordings as any user does, the noise chosen by the data."""
    settings = FitSettings(method="local", calibration=CalibrationSettings(delay="free", max_input_delay=DELAY_LIMIT))
    return fit(
        recordings, model, parameters=free_parameters(model), settings=settings, seed=int(rng.integers(2**31)),
        workers=0,
    )  # fmt: skip


@dataclass(frozen=True)
class Study:
    """One study of a cell."""

    plan: StudyPlan
    fmu: Path
    cell: Cell
    index: int

    @property
    def key(self) -> str:
        """Key of the row: cell and index."""
        return f"{self.cell.name}/{self.index}"


def study(task: Study) -> dict[str, object]:
    """Run one study; everything random in it follows from the plan's seed, the cell and the index."""
    plan, cell, index = task.plan, task.cell, task.index
    began = time.perf_counter()
    label = int.from_bytes(hashlib.sha256(cell.name.encode()).digest()[:4], "big")
    rng = np.random.default_rng([plan.seed, label, index])
    model = Model.load(task.fmu)
    parameters = free_parameters(model)
    row: dict[str, object] = {"cell": cell.name, "index": index, "key": task.key}
    try:
        truth = dict(zip(parameters.names, parameters.sample_prior(rng, 1)[0].tolist(), strict=True))
        names = [f"r{k}" for k in range(cell.recordings)]
        if cell.source == "wrong":
            truth, recordings = best_of_wrong(plan, task.fmu), [friction(rng, plan, name) for name in names]
        elif cell.source == "model":
            recordings = [simulate_with_model(rng, model, truth, cell, plan, name) for name in names]
        else:
            recordings = [simulate_with_bench(rng, truth, cell, plan, name) for name in names]
        found = fitted(recordings, model, rng)
        with open_simulator(found.calibration.problem(), workers=0) as simulator:
            row |= rank_truth(
                found, simulator, truth, plan, rng, check=cell.recordings == 1 and index % CHECK_EVERY == 3
            )
    except (ArithmeticError, ValueError, RuntimeError) as error:
        row["failed"] = str(error)
    row["seconds"] = time.perf_counter() - began
    return row


def rank_truth(
    fit: Fit, simulator: Simulator, truth: dict[str, float], plan: StudyPlan, rng: np.random.Generator, *, check: bool
) -> dict[str, object]:
    """Rank the truth in the posterior, and say how the posterior was made."""
    names = fit.laplace.names[: fit.laplace.parameters]
    point = fit.calibration.parameters.to_search(
        np.array([truth.get(p.name, p.start) for p in fit.calibration.parameters])
    )
    point = point[list(fit.free)]
    found = importance_posterior(fit, simulator, plan.draws, rng, rounds=12)
    weak = not found.reliable or found.ess < 100.0
    row: dict[str, object] = {
        "pareto_k": found.pareto_k,
        "ess": found.ess,
        "method": "sampler" if weak else "importance",
    }
    ranks = found.below(np.append(point, fit.laplace.mean[len(point) :]))
    if weak or check:
        chain = sampled(fit, simulator, found, rng)
        if weak and chain is None:
            raise ArithmeticError("neither importance sampling nor the sampler converged")
        if chain is not None:
            again = np.mean(chain[:, : len(point)] < point, axis=0)
            if weak:
                ranks = again
            else:
                row["sampler_ranks"] = dict(zip(names, again.tolist(), strict=True))
    verdict = {n: str(fit.identifiability.status[n]) for n in names}
    row["status"] = {n: verdict[n] for n in names if n in truth}
    row["ranks"] = {n: float(r) for n, r in zip(names, ranks, strict=False) if n in truth}
    row["noise"] = {output: noise.kind for output, noise in fit.noise.items()}
    row["warned"] = len(fit.warnings)
    row["held"] = [output for output, noise in fit.noise.items() if noise.model_error]
    return row


def sampled(fit: Fit, simulator: Simulator, found: WeightedSample, rng: np.random.Generator) -> np.ndarray | None:
    """Draw from the posterior with the program's sampler, shape (n, d); None where it does not converge in time."""
    proposal = WarpedStudentT.of(fit.laplace.mean, fit.laplace.covariance)
    if found.ess > 50.0:
        proposal = WarpedStudentT.of(found.mean, found.covariance)
    settings = SampleSettings(ess=800.0, max_steps=1500, max_minutes=0.75)
    chain = run_chain(fit.joint_target(simulator), proposal, settings, int(rng.integers(2**31)))
    return chain.points.reshape(-1, chain.points.shape[-1]) if chain.converged or chain.r_hat < 1.05 else None


def summarise(rows: list[dict[str, object]], plan: StudyPlan) -> dict[str, object]:
    """Summarise the ranks by cell and parameter, and pooled as the contract asks."""
    table: list[dict[str, object]] = []
    pooled: dict[str, dict[str, list[float]]] = {kind: {name: [] for name in FREE} for kind in ("white", "correlated")}
    recordings = dict.fromkeys(pooled, 0)
    for cell in CELLS:
        good = [r for r in rows if r.get("cell") == cell.name and "failed" not in r]
        if cell.counted:
            recordings[cell.noise] += cell.recordings * len(good)
        for name in FREE:
            ranks = [r["ranks"][name] for r in good if r["status"].get(name) == Status.IDENTIFIED]
            table += entry(cell.name, name, ranks, counted=cell.counted)
            if cell.counted:
                pooled[cell.noise][name] += ranks
    kinds = [e for kind, names in pooled.items() for name, ranks in names.items() for e in entry(kind, name, ranks)]
    p_values = [float(str(e["rank_uniformity_p"])) for e in kinds]
    together = {kind: [r for ranks in names.values() for r in ranks] for kind, names in pooled.items()}
    checks = [r for r in rows if "sampler_ranks" in r]
    gaps = [abs(r["ranks"][n] - v) for r in checks for n, v in r["sampler_ranks"].items() if n in FREE]
    failed = [str(r.get("failed", r.get("error"))) for r in rows if "failed" in r or "error" in r]
    return {
        "recordings": sum(recordings.values()),
        "recordings_by_noise": recordings,
        **{
            kind: {str(round(100 * level)): inside(ranks, level) for level in LEVELS}
            for kind, ranks in together.items()
        },
        "rank_uniformity_p_min": min(p_values, default=float("nan")),
        "rank_uniformity_tests": len(p_values),
        "outside_two_standard_errors": misses(kinds),
        "outside_two_standard_errors_by_cell": misses(table),
        "by_noise": kinds,
        "studies": len(rows),
        "failed": len(failed),
        "failures": sorted(set(failed)),
        "warned_of_structure": sum(bool(r.get("warned")) for r in rows),
        "sampled_instead": sum(r.get("method") == "sampler" for r in rows),
        "importance_against_sampler": {"studies": len(checks), "largest_rank_gap": max(gaps, default=float("nan"))},
        "seed": plan.seed,
        "plan": asdict(plan),
        "cpu_seconds": sum(float(r.get("seconds", 0.0)) for r in rows),
        "rows": table,
    }


def entry(cell: str, name: str, ranks: list[float], *, counted: bool = True) -> list[dict[str, object]]:
    """Make one row: shares within the intervals with their standard errors; none for fewer than ten ranks."""
    if len(ranks) < 10:
        return []
    row: dict[str, object] = {"cell": cell, "counted": counted, "parameter": name, "studies": len(ranks)}
    row |= {str(round(100 * level)): inside(ranks, level) for level in LEVELS}
    row |= {f"{round(100 * level)}_standard_error": standard_error(level, len(ranks)) for level in LEVELS}
    row["rank_uniformity_p"] = float(kstest(ranks, "uniform").pvalue)
    row["ranks"] = np.histogram(ranks, bins=10, range=(0.0, 1.0))[0].tolist()
    return [row]


def misses(table: list[dict[str, object]]) -> list[str]:
    """List rows further from nominal than two binomial standard errors, in words."""
    found = []
    for row in table:
        for level in LEVELS:
            share, key = float(str(row[str(round(100 * level))])), f"{round(100 * level)}_standard_error"
            if abs(share - level) > 2.0 * float(str(row[key])):
                found.append(f"{row['cell']}, {row['parameter']}: {level:.0%} interval holds {share:.1%}")
    return found


def inside(ranks: list[float], level: float) -> float:
    """Return the share of ranks within the central interval of a level."""
    return float(np.mean(np.abs(np.array(ranks) - 0.5) < 0.5 * level))


def standard_error(level: float, count: int) -> float:
    """Return the binomial standard error of a share."""
    return float(np.sqrt(level * (1.0 - level) / count))


def main() -> None:
    parser = study_parser(__doc__, stop_after=18.5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--share", type=float, default=1.0, help="share of the studies of every cell")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    fmu = export_fmu("Aero.Systems.OneDof", options.out / "coverage_model.fmu")
    plan = StudyPlan(options.seed, 15.0, 100.0, 2000, Model.load(fmu).sha256)
    studies = [
        Study(plan, fmu.resolve(), cell, k) for cell in CELLS for k in range(round(options.share * cell.studies))
    ]
    studies.sort(key=lambda one: (one.index / one.cell.studies, one.cell.name))
    rows = run_study(studies, study, options.out / "coverage.sqlite", options, made_of=plan.key)
    result = summarise(rows, plan)
    write_summary(result, options.out / "coverage.json")
    write_page(options.out / "coverage.html", TITLE, parts(result))
    print(json.dumps({k: v for k, v in result.items() if k != "rows"}, indent=1))


if __name__ == "__main__":
    main()

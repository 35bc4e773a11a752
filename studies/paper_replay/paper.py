"""The replay itself: record, export, run the five models of Table 1 in their variants, and report what happened."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from aero_bayes.data import Recording
from aero_bayes.estimate import Fit, FitSettings, fit
from aero_bayes.estimate.declared import declared_overrides
from aero_bayes.estimate.parameters import Override, parameters_from_model
from aero_bayes.estimate.priors import LogNormal
from aero_bayes.sensors.noise import NoiseModel
from aero_bayes.simulation import Model, Outcome, WorkerPool, open_simulator
from paper_replay import table
from paper_replay.models import export_models, open_models, paper_recording
from paper_replay.notes import write_notes
from paper_replay.published import PAPER_STAGES, UNOPTIMISED
from paper_replay.result import Details, Replay
from paper_replay.search import coarse_stage, exact_stage, in_stages, swarm_recipe, swarm_stage

Progress = Callable[[str, float, float], None]
#: How often the swarm's speed stage is repeated to see where it can end.
SEEDS = 12
#: How far from the data sheet the thrust and drag of the linear law may be, as a factor; bounds are its square.
SPREAD = 10.0


def replay_paper(
    *, seed: int = 1, workers: int | None = None, out: Path, progress: Progress = lambda phase, share, fitness: None
) -> Replay:
    """Replay the paper's Table 1 and Fig. 6 on the simulated bench.

    Parameters
    ----------
    seed : int
        Decides the recording's noise and every swarm; the same seed gives the same numbers.
    workers : int, optional
        Simulation processes; one a core by default.
    out : Path
        Folder for the three FMUs.
    progress : callable
        Told a phase, how far it is (0 to 1), and the best fitness known (NaN until there is one).

    Returns
    -------
    Replay

    Raises
    ------
    InputError
        If an FMU cannot be built.
    CannotFinishError
        If not even the unoptimised model can be simulated.
    """
    began = time.perf_counter()

    def report(share: float, fitness: float = np.nan) -> None:
        progress("replaying the paper", share, fitness)

    report(0.0)
    recording, rng = paper_recording(seed), np.random.default_rng([seed, 3])
    models = export_models(out, lambda share: report(0.25 * share))
    with WorkerPool(workers) as pool:
        linear, transfer = open_models(recording, models, lambda problem: open_simulator(problem, pool=pool))
        with linear.simulator, transfer.simulator:
            axes = rng.spawn(2)
            swarm, scaled = swarm_recipe(linear, "linear", axes[0]), swarm_recipe(linear, "log", axes[1])
            report(0.35)
            line = in_stages(partial(coarse_stage, method="line search"), linear)
            interior = in_stages(partial(coarse_stage, method="interior point"), linear)
            exact = in_stages(exact_stage, linear)
            report(0.45)
            again = (swarm_stage(linear, PAPER_STAGES[1], swarm[0].values, "linear", s) for s in rng.spawn(SEEDS))
            endings = np.array([end.path.sum(axis=1) for end in again if end.path is not None])
            report(0.6)
            fits = [_fit_jointly(recording, models["OneDofLinear"], linear_law=True, seed=seed, workers=workers)]
            report(0.8)
            fits += [_fit_jointly(recording, models["OneDof"], linear_law=False, seed=seed, workers=workers)]
            still = float(np.nansum(recording.outputs["theta"] ** 2))
            details = Details(swarm, scaled, line, interior, exact, endings, still, *fits)
            rows, pitch = table.build(linear, transfer, details)
    outcomes = sum((Counter(one.outcomes) for one in fits), linear.outcomes + transfer.outcomes)
    report(1.0, min(row.fitness for row in rows if row.fitness is not None))
    return Replay(
        rows, write_notes(rows, details, outcomes), recording.time, recording.outputs["theta"], pitch, details,
        {outcome.key: outcomes[outcome] for outcome in Outcome}, seed, time.perf_counter() - began,
    )  # fmt: skip


def _fit_jointly(recording: Recording, model: Model, *, linear_law: bool, seed: int, workers: int | None) -> Fit:
    """Fit all outputs at once: particle swarm, then bounded local search, each output weighed by its own residual.

    White residuals are assumed: the table compares sums of squares, and a fit that may call a misfit correlated noise
    does not lower them. Free are the AERO's usual parameters, under the linear law about the paper's thrust and drag.
    """
    overrides = declared_overrides(model)
    for name in ("k_d", "k_t") if linear_law else ():
        centre = UNOPTIMISED.model_values[name]
        prior = LogNormal.factor(centre, SPREAD)
        overrides[name] = Override(centre, centre / SPREAD**2, centre * SPREAD**2, prior, "log")
    parameters = parameters_from_model(model, overrides=overrides)
    settings = FitSettings(noise=NoiseModel("white"))
    return fit([recording], model, parameters=parameters, settings=settings, seed=seed, workers=workers)

"""The replay itself: record, export, run the five models of Table 1 in their variants, and report what happened."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from aero_bayes.simulation import Outcome, Problem, Simulator, WorkerPool, open_simulator
from paper_replay import table
from paper_replay.descent import coarse_stage, descend, exact_stage
from paper_replay.evaluator import ModelEvaluator
from paper_replay.facts import Facts
from paper_replay.joint import fit_jointly
from paper_replay.notes import write_notes
from paper_replay.published import PAPER_STAGES
from paper_replay.recording import paper_recording
from paper_replay.result import Details, Replay
from paper_replay.rigs import Rigs, export_models
from paper_replay.swarm import swarm_recipe, swarm_stage

FloatArray = NDArray[np.float64]
Engine = Literal["native", "fmpy"]
Progress = Callable[[str, float, float], None]

#: How often the swarm's speed stage is repeated to see where it can end.
SEEDS = 12
PHASE = "replaying the paper"


def replay_paper(
    *,
    seed: int = 1,
    workers: int | None = None,
    engine: Engine = "native",
    out: Path,
    progress: Progress | None = None,
) -> Replay:
    """Replay the paper's Table 1 and Fig. 6 on the simulated bench.

    Parameters
    ----------
    seed : int
        Decides the recording's noise and every swarm; the same seed gives the same numbers.
    workers : int, optional
        Simulation processes; one a core by default.
    engine : {"native", "fmpy"}
    out : Path
        Folder for the three FMUs.
    progress : callable, optional
        Told a phase, how far it is (0 to 1), and the best fitness known (NaN until there is one).

    Raises
    ------
    InputError
        If an FMU cannot be built.
    CannotFinishError
        If not even the unoptimised model can be simulated.
    """
    began = time.perf_counter()

    def report(share: float, fitness: float = np.nan) -> None:
        if progress is not None:
            progress(PHASE, share, fitness)

    report(0.0)
    recording, rng = paper_recording(seed), np.random.default_rng([seed, 3])
    models = export_models(out, lambda share: report(0.25 * share))
    with ExitStack() as stack:
        pool = stack.enter_context(WorkerPool(workers)) if engine == "native" else None

        def opened(problem: Problem) -> Simulator:
            return stack.enter_context(open_simulator(problem, engine=engine, pool=pool))

        rigs = Rigs(recording, models, opened)
        linear_axes, log_axes = rng.spawn(2)
        swarm = swarm_recipe(rigs.linear, "linear", linear_axes)
        scaled = swarm_recipe(rigs.linear, "log", log_axes)
        report(0.35)
        line = descend(partial(coarse_stage, method="line search"), rigs.linear)
        interior = descend(partial(coarse_stage, method="interior point"), rigs.linear)
        exact = descend(exact_stage, rigs.linear)
        report(0.45)
        endings = _endings(rigs.linear, swarm[0].values, rng.spawn(SEEDS))
        report(0.6)
        linear = fit_jointly(recording, models["OneDofLinear"], "linear", seed=seed, engine=engine, workers=workers)
        report(0.8)
        quadratic = fit_jointly(recording, models["OneDof"], "quadratic", seed=seed, engine=engine, workers=workers)
        look = rigs.look(quadratic)
        details = Details(swarm, scaled, line, interior, exact, endings, look, linear, quadratic)
        rows, pitch = table.build(rigs, details)
        facts = Facts.gather(rigs, details, rows)
        outcomes = rigs.outcomes
    for fit in (linear, quadratic):
        outcomes.update(dict(fit.outcomes))
    report(1.0, min(row.fitness for row in rows if row.fitness is not None))
    return Replay(
        rows,
        write_notes(facts, outcomes),
        recording.time,
        recording.outputs["theta"],
        pitch,
        details,
        {outcome.key: outcomes[outcome] for outcome in Outcome},
        seed,
        time.perf_counter() - began,
    )


def _endings(evaluator: ModelEvaluator, base: Mapping[str, float], streams: list[np.random.Generator]) -> FloatArray:
    """J_r + J_s of the best particle in the speed stage after each iteration, shape (seeds, iterations)."""
    stage = PAPER_STAGES[1]
    return np.array([swarm_stage(evaluator, stage, base, "linear", stream).path.sum(axis=1) for stream in streams])

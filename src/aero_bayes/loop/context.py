"""What all stages of the closed loop share: recordings, models, settings, workers."""

from __future__ import annotations

import math
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.filter_objective import objective_of
from aero_bayes.estimate.objective import Objective
from aero_bayes.judge.recordings import Recordings
from aero_bayes.judge.unseen import Unseen
from aero_bayes.laws.model_family import ModelFamily
from aero_bayes.loop.settings import LoopSettings
from aero_bayes.parallel import ParallelMap
from aero_bayes.progress import Progress, Watched
from aero_bayes.simulation import WorkerPool, open_simulator
from aero_bayes.simulation.interface import Outcome, Problem, Simulator


class LoopStatistics:
    """Time spent in each stage, the time limit, and counts of simulations; the only part of a loop that changes.

    The search ends early where the progress that is ``watched`` is asked to end."""

    def __init__(self, watched: Watched | None = None) -> None:
        self.watched = watched or Watched()
        self.seconds: dict[str, float] = {}
        self.outcomes: Counter[Outcome] = Counter()
        self._clock = time.perf_counter()
        self._until = math.inf

    def set_time_limit(self, seconds: float) -> None:
        """Limit the time from now on, in s."""
        self._until = time.perf_counter() + seconds

    def time_is_up(self) -> bool:
        """Whether the time limit has passed, or the search is asked to end."""
        return time.perf_counter() > self._until or self.watched.again()

    def end_stage(self, stage: str) -> None:
        """Add the time since the last stage ended to this stage."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._clock
        self._clock = now


@dataclass(frozen=True, eq=False)
class LoopContext:
    """What all stages of a loop share.

    ``folder`` is where the extended model is written; ``progress`` receives what is done and how far it is (0 to 1)."""

    family: ModelFamily
    recordings: Recordings
    settings: LoopSettings
    pool: WorkerPool
    folder: Path
    progress: Progress
    statistics: LoopStatistics
    seed: int = 1

    @property
    def units(self) -> dict[str, str]:
        """Units of the model's outputs."""
        return {v.name: v.unit for v in self.family.base_model().outputs}

    def open(self, problem: Problem) -> Simulator:
        """A simulator on the loop's workers."""
        return open_simulator(problem, pool=self.pool)

    def open_objective(self, calibration: Calibration) -> Objective:
        """A calibration with a simulator of its own, which the caller closes."""
        return self.objective(calibration, self.open(calibration.problem()))

    def objective(self, calibration: Calibration, simulator: Simulator) -> Objective:
        """A calibration on a simulator that is open; its simulations are counted."""
        found = objective_of(calibration, simulator)
        found.outcomes = self.statistics.outcomes
        return found

    @property
    def map(self) -> ParallelMap:
        """A map over independent fits, one process a worker; none is begun after the time limit."""
        return ParallelMap(self.pool, self.statistics.time_is_up)

    @property
    def unseen(self) -> Unseen:
        """The recordings whole, to run fitted models over."""
        return Unseen(self.recordings, self.settings.fitting.calibration, self.family, self.open)

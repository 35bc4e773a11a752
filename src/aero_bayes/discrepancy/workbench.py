"""What every stage of the closed loop works with: the recordings, the models, the settings, and where work is done."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from aero_bayes.data import Recording
from aero_bayes.discrepancy.baseline import Prepared
from aero_bayes.discrepancy.family import ModelFamily
from aero_bayes.discrepancy.judge import Prediction, predict
from aero_bayes.discrepancy.refit import Refit, RefitSettings
from aero_bayes.discrepancy.settings import LoopSettings
from aero_bayes.discrepancy.study import Study, problem_of
from aero_bayes.errors import InputError
from aero_bayes.inference.parameters import ParameterSet
from aero_bayes.simulation import Model, WorkerPool, open_simulator
from aero_bayes.simulation.interface import InputSignal

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Recordings:
    """The recordings, and which part of them is fitted.

    ``fitted`` are the training recordings, or what is left of them where their ends are held out for want of test
    recordings; ``held_from`` then gives by name the time (s) from which readings count as unseen.
    """

    train: tuple[Recording, ...]
    test: tuple[Recording, ...]
    fitted: tuple[Recording, ...]
    held_from: Mapping[str, float]
    outputs: tuple[str, ...]

    @classmethod
    def of(cls, train: Sequence[Recording], test: Sequence[Recording], held_out: float) -> Recordings:
        """Check the recordings, and hold out the share ``held_out`` of each training one if there is no other test.

        Raises
        ------
        InputError
            If no output was recorded that a model has, or if two training recordings have the same name.
        """
        outputs = tuple(o for o in ("i_m", "omega_m", "theta") if any(o in r.outputs for r in train))
        if not outputs:
            raise InputError("none of the outputs i_m, omega_m, theta was recorded")
        names = [r.name for r in train]
        if len(set(names)) < len(names):
            raise InputError("two training recordings have the same name")
        if test:
            return cls(tuple(train), tuple(test), tuple(train), {}, outputs)
        held_from: dict[str, float] = {}
        parts = []
        for recording in train:
            cut = float(recording.time[0] + (1.0 - held_out) * recording.duration)
            held_from[recording.name] = cut
            parts.append(replace(recording.without(after=cut), name=recording.name))
        return cls(tuple(train), (), tuple(parts), held_from, outputs)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the training recordings."""
        return tuple(r.name for r in self.train)


class Tally:
    """Seconds spent by stage and simulations run so far: the one thing on the bench that changes."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.simulations = self.failures = 0
        self._clock = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Book the time since the last lap on a stage."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._clock
        self._clock = now

    def count(self, study: Study) -> None:
        """Add a study's simulations."""
        self.simulations += study.simulations
        self.failures += study.failures


@dataclass(frozen=True, eq=False)
class Workbench:
    """What the stages share.

    ``folder`` is where the extended model is written; ``progress`` is told what happens and how far it is (0 to 1).
    """

    family: ModelFamily
    recordings: Recordings
    settings: LoopSettings
    pool: WorkerPool
    folder: Path
    progress: Progress
    tally: Tally

    def open_study(
        self, model: Model, parameters: ParameterSet, prepared: Prepared, fixed: Mapping[str, float]
    ) -> Study:
        """Hold a model against prepared recordings; ``fixed`` goes before what the settings hold fixed."""
        held = {**self.settings.fixed, **fixed}
        problem = problem_of(model, prepared.experiments, parameters, held, self.settings.solver)
        return Study(open_simulator(problem, pool=self.pool), parameters)

    def predict(
        self, model: Model, parameters: ParameterSet, fit: Refit, extra: Mapping[int, InputSignal] | None = None
    ) -> Prediction:
        """Run a fitted model over all recordings, whole; ``extra`` as in :func:`~.judge.predict`."""
        seen = self.recordings
        return predict(
            model, parameters, fit, seen.train, seen.test, seen.outputs, self.settings.fixed, self.settings.solver,
            self.pool, seen.held_from, extra,
        )  # fmt: skip

    def refit_settings(self, prepared: Prepared) -> RefitSettings:
        """The settings of a refit, with the noise that the sensors of these recordings have at least."""
        return replace(self.settings.refit, floors=prepared.floors)

"""A simulation study of a separating experiment: each model simulates recordings, and both are fitted to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aero_bayes.design.gain_check import refit_experiment, simulated_experiment
from aero_bayes.design.information import Engine, ExperimentPredictor
from aero_bayes.design.separation import Separation
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate import Fit
from aero_bayes.progress import Progress
from aero_bayes.simulation.workers import WorkerPool

#: Difference in log-evidence above which two models count as separated (odds of 20 to 1).
MIN_LOG_EVIDENCE_DIFFERENCE = 3.0


@dataclass(frozen=True)
class SeparationCheck:
    """Differences in log-evidence in favour of the true model, one a simulated repetition.

    ``failures`` counts repetitions whose simulation or fits failed."""

    first_true: tuple[float, ...]
    second_true: tuple[float, ...]
    failures: int

    @property
    def achieved(self) -> float:
        """Mean difference, of the model for which it is smaller."""
        return min(float(np.mean(self.first_true)), float(np.mean(self.second_true)))

    @property
    def told_apart(self) -> float:
        """Share of repetitions in which the evidence decided for the true model."""
        return float(np.mean(np.array([*self.first_true, *self.second_true]) > MIN_LOG_EVIDENCE_DIFFERENCE))

    def to_dict(self) -> dict[str, object]:
        return {
            "first_true": float(np.mean(self.first_true)),
            "second_true": float(np.mean(self.second_true)),
            "achieved": self.achieved,
            "told_apart": self.told_apart,
            "decisive": MIN_LOG_EVIDENCE_DIFFERENCE,
            "repeats": len(self.first_true) + len(self.second_true) + self.failures,
            "failures": self.failures,
        }


def check_separation(
    separation: Separation,
    first: Fit,
    second: Fit,
    *,
    repeats: int = 20,
    seed: int = 1,
    engine: Engine = "native",
    workers: int | None = None,
    progress: Progress | None = None,
) -> SeparationCheck:
    """Simulate recordings of the experiment with each of two fitted models, and fit both models to them."""
    half = max(1, repeats // 2)
    streams = np.random.default_rng(seed).spawn(2 * half)
    time, limits = separation.time, separation.limits
    with WorkerPool(workers) as pool:
        a, b = (ExperimentPredictor(fit, time, limits, engine, workers, pool) for fit in (first, second))
        found: tuple[list[float], list[float]] = ([], [])
        for k, rng in enumerate(streams):
            if progress is not None:
                progress("simulated check", k / len(streams), "")
            truth, rival = (a, b) if k < half else (b, a)
            difference = _repetition(separation, truth, rival, rng)
            if difference is not None:
                found[k // half].append(difference)
    if not found[0] or not found[1]:
        raise CannotFinishError("no repetition of the proposed experiment could be simulated and fitted")
    return SeparationCheck(tuple(found[0]), tuple(found[1]), 2 * half - len(found[0]) - len(found[1]))


def _repetition(
    separation: Separation, truth: ExperimentPredictor, rival: ExperimentPredictor, rng: np.random.Generator
) -> float | None:
    """Compute the log-evidence of the true model less that of the other, under the noise of the other one."""
    noise = [rival.fit.noise[name] for name in truth.fit.calibration.data.outputs]
    values = np.append(truth.values, truth.delay_value)
    measured = simulated_experiment(truth, separation, values, noise, rng)
    if measured is None:
        return None
    own, other = refit_experiment(truth, measured, noise), refit_experiment(rival, measured, noise)
    return None if own is None or other is None else other[1] - own[1]

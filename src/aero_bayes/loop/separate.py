"""Which experiment would tell two effects apart that the recordings at hand cannot.

For each of a few input signals the model with the first effect makes a recording without noise; the model with the
second is fitted to it, everything free. Half the squared distance that is left, in noise units, is the evidence that
such an experiment is expected to bring.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.climb import ClimbSettings, Optimum, climb
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.physics.kin import Candidate
from aero_bayes.simulation.interface import Experiment, InputSignal

FloatArray = NDArray[np.float64]
OpenObjective = Callable[[Calibration], Objective]

DURATION = 40.0
RATE = 50.0


@dataclass(frozen=True)
class Design:
    """An experiment in words, and its voltage over time for a greatest one of 1 V."""

    text: str
    levels: Callable[[FloatArray], FloatArray]


def _steps(*levels: float) -> Callable[[FloatArray], FloatArray]:
    table: FloatArray = np.array(levels, dtype=np.float64)
    return lambda t: table[np.minimum((t / DURATION * len(levels)).astype(int), len(levels) - 1)]


def _sine(t: FloatArray) -> FloatArray:
    return np.asarray(np.sin(0.2 * np.pi * t), dtype=np.float64)


DESIGNS = (
    Design("a full step, then nothing (20 s each)", _steps(1.0, 0.0)),
    Design("steps up and down in both directions (5 s each)", _steps(0.0, 0.3, 0.6, 1.0, -0.3, -0.6, -1.0, 0.0)),
    Design("small steps in both directions (5 s each)", _steps(0.0, 0.1, -0.1, 0.2, -0.2, 0.3, -0.3, 0.0)),
    Design("a slow sine of full height (10 s a period)", _sine),
    Design("switching between full voltages every 2 s", _steps(*([1.0, -1.0] * 10))),
    Design("one short pulse (1 s), then free motion", lambda t: np.where((t >= 1.0) & (t < 2.0), 1.0, 0.0)),
)


@dataclass(frozen=True)
class Proposal:
    """The experiment that separates two effects best and the log-evidence that it is expected to bring."""

    first: str
    second: str
    text: str
    expected: float

    def sentence(self) -> str:
        if self.expected < 1.0:
            return f"None of the experiments tried would tell {self.first} from {self.second}."
        return (
            f"To tell {self.first} from {self.second}: {self.text} "
            f"(expected difference in log-evidence {self.expected:.0f})."
        )


def propose(
    calibration: Calibration,
    first: tuple[Candidate, Optimum],
    second: tuple[Candidate, Optimum],
    height: float,
    open_objective: OpenObjective,
    designs: Sequence[Design] = DESIGNS,
) -> Proposal:
    """Choose among ``designs``, each scaled to ``height`` V, by the evidence that it is expected to bring."""
    time = np.arange(0.0, DURATION, 1.0 / RATE)
    outputs = calibration.outputs
    best = Proposal(first[0].id, second[0].id, "", 0.0)
    own = [
        p if p.recording is None else replace(p, recording=0 if p.recording == 0 else 1) for p in calibration.parameters
    ]
    everything = ParameterSet(tuple(own))
    for design in designs:
        volts = height * design.levels(time)
        keep = np.concatenate(([True], np.diff(volts) != 0.0))
        signal = InputSignal("V_m", np.concatenate(([-1.0], time[keep])), np.concatenate(([0.0], volts[keep])))
        silent = Experiment(time, outputs, (signal,), {}, np.zeros((time.size, len(outputs))))
        one = replace(
            calibration, names=("design",), experiments=(silent,), parameters=everything, fixed={}, recordings=()
        )
        study = open_objective(one)
        made = study.evaluate(first[1].coordinates)
        study.simulator.close()
        if made is None:
            continue
        experiment = replace(silent, measured=np.column_stack(made.predicted))
        study = open_objective(replace(one, experiments=(experiment,)))
        free = [j for j in second[1].free if everything.items[j].recording in (None, 0)]
        try:
            fit = climb(
                study, second[1].coordinates, free, noise=first[1].noise, settings=ClimbSettings(hold_noise=True)
            )
            expected = 0.5 * float(fit.whitened.residual @ fit.whitened.residual)
        except CannotFinishError:
            continue
        finally:
            study.simulator.close()
        if expected > best.expected:
            best = replace(best, text=design.text, expected=expected)
    return best

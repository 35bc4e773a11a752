"""Does a recorded input hold from sample to sample, or was it read off a signal that moves in between?

A commanded voltage is held by its converter. A measured force is a reading of something smooth, for which straight
lines are closer. Where an input changes at most samples the fit decides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aero_bayes.data.align import to_experiment
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.simulation.interface import Experiment, InputSignal

#: Share of the samples at which an input must change for straight lines to make sense.
MOVING = 0.5
#: Gain in log-likelihood at which straight lines are preferred.
LEAST_GAIN = 10.0


def with_lines(calibration: Calibration) -> Calibration | None:
    """The calibration with straight lines between the samples of its inputs; None where that makes no sense."""
    if not calibration.recordings:
        return None
    experiments = []
    for experiment, recording in zip(calibration.experiments, calibration.recordings, strict=True):
        moving = [n for n, v in recording.inputs.items() if float(np.mean(np.diff(v) != 0.0)) > MOVING]
        if not moving:
            return None
        experiments.append(_lines(experiment, {n: (recording.time, recording.inputs[n]) for n in moving}))
    return replace(calibration, experiments=tuple(experiments), interpolation="linear")


def read_otherwise(calibration: Calibration) -> Calibration | None:
    """The calibration with its inputs read the other way between the samples; None where that makes no sense."""
    return with_lines(calibration) if calibration.interpolation == "hold" else _with_steps(calibration)


def _with_steps(calibration: Calibration) -> Calibration:
    at_rest = calibration.model.declared.recording.zero_at_rest
    experiments = [
        replace(experiment, inputs=to_experiment(recording, (), zero_at_rest=at_rest).inputs)
        for experiment, recording in zip(calibration.experiments, calibration.recordings, strict=True)
    ]
    return replace(calibration, experiments=tuple(experiments), interpolation="hold")


def _lines(experiment: Experiment, signals: dict[str, tuple[np.ndarray, np.ndarray]]) -> Experiment:
    inputs = tuple(
        InputSignal(s.name, *signals[s.name], "linear") if s.name in signals else s for s in experiment.inputs
    )
    return replace(experiment, inputs=inputs)

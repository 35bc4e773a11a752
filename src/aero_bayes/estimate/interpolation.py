"""Does a recorded input hold from sample to sample, or was it read off a signal that moves in between?

A commanded voltage is held by its converter. A measured force is a reading of something smooth, for which straight
lines are closer. The fit decides for each input that moves from sample to sample while it acts; one that jumps now and
then was a step, and holds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from aero_bayes.data.align import to_experiment
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.simulation.interface import Interpolation

#: Share of an input's changes that must follow another at once for straight lines to make sense.
MOVING = 0.5
#: Gain in log-likelihood at which another reading of an input is preferred.
LEAST_GAIN = 10.0


def moving_inputs(calibration: Calibration) -> tuple[str, ...]:
    """Inputs that may run in straight lines between their samples: what changes mostly changed a sample ago as well."""
    changes: dict[str, int] = {}
    follow: dict[str, int] = {}
    for recording in calibration.recordings:
        for name, values in recording.inputs.items():
            changed = np.diff(values) != 0.0
            changes[name] = changes.get(name, 0) + int(changed.sum())
            follow[name] = follow.get(name, 0) + int((changed[1:] & changed[:-1]).sum())
    discrete = {variable.name for variable in calibration.model.inputs if variable.discrete}
    return tuple(n for n, count in changes.items() if follow[n] > MOVING * count and n not in discrete)


def read_as(calibration: Calibration, interpolation: Mapping[str, Interpolation]) -> Calibration:
    """The calibration with some of its inputs held or in straight lines between their samples, the others as before."""
    at_rest = calibration.model.declared.recording.zero_at_rest
    wanted = {**calibration.interpolation, **interpolation}
    experiments = []
    for experiment, recording in zip(calibration.experiments, calibration.recordings, strict=True):
        again = to_experiment(recording, (), zero_at_rest=at_rest, interpolation=wanted)
        experiments.append(replace(experiment, inputs=again.inputs))
    return replace(calibration, experiments=tuple(experiments))


def with_lines(calibration: Calibration) -> Calibration | None:
    """The calibration with straight lines between the samples of its moving inputs; None where there are none."""
    moving = moving_inputs(calibration)
    return read_as(calibration, dict.fromkeys(moving, "linear")) if moving else None


def read_otherwise(calibration: Calibration) -> Calibration | None:
    """The calibration with its moving inputs read the other way between the samples; None where there are none."""
    if "linear" not in calibration.interpolation.values():
        return with_lines(calibration)
    return read_as(calibration, dict.fromkeys(calibration.interpolation, "hold"))

"""Process noise of a calibration: diffusion of named states and the readings' noise, as parameters beside the others.

Diffusion and reading noise hang together in the likelihood, so that both are searched and sampled with the parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate.initial_states import MAX_SPREAD_SHARE, state_of, state_sizes
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.estimate.priors import LogNormal, Normal
from aero_bayes.sensors.noise import NoiseModel
from aero_bayes.simulation.interface import (
    DiffusionTarget,
    Experiment,
    ProcessNoise,
    ReadingNoiseTarget,
    StartTarget,
)
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.problem_checks import check_process

#: What the name of a diffusion's parameter begins with; the state follows.
DIFFUSION_PREFIX = "process."
#: Prior of a diffusion: its median moves the state by this share of its range over a recording.
DIFFUSION_SHARE = 0.1
#: Prior of the reading noise: its median as a share of the output's range.
READING_SHARE = 0.01
#: Standard deviation of the logarithms of both, and the largest distance of the bounds from the median.
SIGMA, LIMIT = 2.5, 10.0


def process_parameters(
    noise: NoiseModel, model: Model, experiments: Sequence[Experiment], floors: Mapping[str, float]
) -> tuple[ProcessNoise, list[Parameter]]:
    """Return the process noise that is given, and parameters for what is estimated of it."""
    for name in noise.process:
        model.state_index(name)
    held = {name: float(value) for name, value in noise.process.items() if value != "estimated"}
    wanted = [name for name, value in noise.process.items() if value == "estimated"]
    given = ProcessNoise(held)
    check_process(model, given)
    states = [model.states[model.state_index(name)] for name in wanted]
    sizes = state_sizes(model, experiments[0], states)
    duration = max(float(e.time[-1] - e.time[0]) for e in experiments)
    found = [
        _parameter(
            f"{DIFFUSION_PREFIX}{name}", f"{state.unit or 1}/sqrt(s)",
            DIFFUSION_SHARE * sizes[state.name] / math.sqrt(duration), f"diffusion of {name}", DiffusionTarget(name),
        )
        for name, state in zip(wanted, states, strict=True)
    ]  # fmt: skip
    for column, output in enumerate(experiments[0].outputs):
        values = np.concatenate([_measured(e)[:, column] for e in experiments])
        found.append(
            _parameter(
                f"noise.{output}.sd_white", model.units[output], READING_SHARE * _range(values),
                f"noise of the readings of {output}", ReadingNoiseTarget(output), floors.get(output, 0.0),
            )
        )  # fmt: skip
    return given, found


def uncertain_start(
    start: Mapping[str, float],
    estimated: Sequence[Parameter],
    experiment: Experiment,
    model: Model,
    given: Mapping[str, float],
) -> tuple[dict[str, float], dict[str, float]]:
    """Compute initial values of states and their standard deviations, by state.

    An initial value is not estimated beside process noise but integrated out: one that is free to meet the first
    reading would let that reading's noise shrink to nothing."""
    mean, sd = dict(start), {}
    for p in estimated:
        if isinstance(p.target, StartTarget) and isinstance(p.prior, Normal):
            mean[p.target.state], sd[p.target.state] = p.start, p.prior.sd
    for column, output in enumerate(experiment.outputs):
        state = state_of(model, output)
        if state is not None and state.name in start:
            sd[state.name] = MAX_SPREAD_SHARE * _range(_measured(experiment)[:, column])
    for name, value in given.items():
        state_name = model.states[model.state_index(name)].name
        mean.pop(state_name, None)
        sd[state_name] = value
    return mean, sd


def _range(values: FloatArray) -> float:
    return float(np.nanmax(values) - np.nanmin(values)) or 1.0


def _measured(experiment: Experiment) -> FloatArray:
    if experiment.measured is None:
        raise InputError("an experiment without measurements cannot be fitted")
    return experiment.measured


def _parameter(
    name: str, unit: str, median: float, about: str, target: DiffusionTarget | ReadingNoiseTarget, floor: float = 0.0
) -> Parameter:
    """Return a positive number of which little more than the order of magnitude is known."""
    low, high = max(median * math.exp(-LIMIT), floor), median * math.exp(LIMIT)
    return Parameter(name, unit, max(median, 1.01 * floor), low, high, LogNormal(median, SIGMA), "log", about, target)

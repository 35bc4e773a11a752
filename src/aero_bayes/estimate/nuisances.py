"""Nuisance parameters of recordings: initial values and delays of inputs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from aero_bayes.data import Recording
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration_settings import CalibrationSettings, DelayPolicy
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.estimate.priors import Uniform
from aero_bayes.simulation.interface import DelayTarget, Experiment
from aero_bayes.simulation.model import Model


def largest_delay(
    recordings: Sequence[Recording], model: Model, settings: CalibrationSettings
) -> float | Mapping[str, float]:
    """Return the largest delay of the inputs in s, or of each; also check that the model has the recordings' inputs."""
    declared = model.declared.recording.max_input_delay
    limit = declared if settings.max_input_delay is None else settings.max_input_delay
    if settings.delay == "free" and not limit:
        raise InputError(f"model {model.name} declares no input delay: give its max_input_delay")
    driven = {variable.name for variable in model.inputs}
    for recording in recordings:
        missing = [name for name in recording.inputs if name not in driven]
        if missing:
            raise InputError(f"{recording.name}: model {model.name} has no input {missing[0]}")
    if isinstance(limit, Mapping):
        check_inputs(recordings, limit, "delay")
    return limit


def nuisance_parameters(
    experiments: Sequence[Experiment],
    starts: Sequence[Sequence[Parameter]],
    recordings: Sequence[Recording],
    limit: float | Mapping[str, float],
    policy: DelayPolicy,
) -> list[Parameter]:
    """List initial values and delay of each recording in turn, or the delays of single inputs at the end."""
    nuisances: list[Parameter] = []
    for index, (experiment, own) in enumerate(zip(experiments, starts, strict=True)):
        nuisances += own
        if not isinstance(limit, Mapping) and limit and _delay_wanted([experiment], policy, limit):
            nuisances.append(_delay(limit, index, recording_suffix(recordings, index)))
    return nuisances + (_delays(experiments, limit, policy) if isinstance(limit, Mapping) else [])


def _delay(limit: float, index: int, suffix: str) -> Parameter:
    return Parameter(
        f"input_delay{suffix}", "s", 0.3 * limit, *_range(limit), Uniform(*_range(limit)), "linear",
        "delay of the input", DelayTarget(), index,
    )  # fmt: skip


def _range(limit: float) -> tuple[float, float]:
    """Return the range of a delay: below zero, the input acts before it is logged."""
    return min(limit, 0.0), max(limit, 0.0)


def input_delay(name: str, limit: float) -> Parameter:
    """Return the delay of one input by up to ``limit`` s, the same in every recording: a dead time of the rig."""
    prior, about = Uniform(*_range(limit)), f"delay of {name}"
    return Parameter(f"{name}_delay", "s", 0.3 * limit, *_range(limit), prior, "linear", about, DelayTarget(name))


def _delays(experiments: Sequence[Experiment], limits: Mapping[str, float], policy: DelayPolicy) -> list[Parameter]:
    """List the delays of single inputs."""
    wanted = {
        name: limit for name, limit in limits.items() if limit and _delay_wanted(experiments, policy, limit, name)
    }
    return [input_delay(name, limit) for name, limit in wanted.items()]


def check_inputs(recordings: Sequence[Recording], names: Iterable[str], of_what: str) -> None:
    for name in names:
        for recording in recordings:
            if name not in recording.inputs:
                has = ", ".join(recording.inputs) or "none"
                raise InputError(f"{of_what} of {name}: {recording.name} has no such input; it has {has}")


def _delay_wanted(
    experiments: Sequence[Experiment], policy: DelayPolicy, limit: float, name: str | None = None
) -> bool:
    """Return whether a delay of an input (of any by default) is searched: asked for, or seen in one of the experiments.

    An input may change before the first reading: an experiment that begins at rest has zero there."""
    if policy != "auto":
        return policy == "free"
    return any(
        len(e.time) > 1
        and np.median(np.diff(e.time)) <= 5.0 * abs(limit)
        and any(np.any(np.diff(signal.values)) for signal in e.inputs if name in (None, signal.name))
        for e in experiments
    )


def recording_suffix(recordings: Sequence[Recording], index: int) -> str:
    """End of the names of a recording's own parameters."""
    return "" if len(recordings) == 1 else f"[{recordings[index].name}]"

"""What is fitted to what: a model, recordings, free parameters and nuisances, and the problem a simulator gets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from aero_bayes.data import Recording, to_experiment
from aero_bayes.errors import InputError
from aero_bayes.inference.noise import NoiseModel
from aero_bayes.inference.parameters import Parameter, ParameterSet
from aero_bayes.inference.priors import Normal, Uniform
from aero_bayes.simulation.interface import (
    DelayTarget,
    Experiment,
    ParameterTarget,
    Problem,
    SolverSettings,
    StartTarget,
    Target,
)
from aero_bayes.simulation.model import Model

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class CalibrationSettings:
    """How recordings are turned into a problem.

    Parameters
    ----------
    outputs : tuple of str, optional
        Outputs to fit; all that were recorded and that the model has by default.
    delay : {"auto", "free", "none"}
        A delay of each recording's input: a nuisance parameter. ``auto`` frees it where the input jumps and the
        samples are closer than five times ``delay_limit``.
    delay_limit : float
        Upper bound of the delay in s.
    start : {"auto", "reading", "estimated"}
        Initial value of the states in ``resting``: their first reading, or estimated about it; ``auto`` estimates
        where the readings carry noise. Other states start at the model's own values unless the recording begins in
        mid-motion; then those that are outputs start at their reading.
    resting : tuple of str
        Outputs whose state starts at its first reading and whose rate of change starts at zero.
    solver : SolverSettings
    """

    outputs: tuple[str, ...] | None = None
    delay: Literal["auto", "free", "none"] = "auto"
    delay_limit: float = 0.02
    start: Literal["auto", "reading", "estimated"] = "auto"
    resting: tuple[str, ...] = ("theta",)
    solver: SolverSettings = field(default_factory=SolverSettings)


@dataclass(frozen=True)
class Calibration:
    """One fitting problem.

    Parameters
    ----------
    model : Model
    experiments : tuple of Experiment, length E
        All with the same ``outputs``; readings that a recording lacks are NaN.
    names : tuple of str, length E
        Names of the recordings.
    parameters : ParameterSet
        What is searched, nuisances included.
    fixed : mapping of str to float
        Model parameters held at other values than the model's own.
    noise : NoiseModel
    solver : SolverSettings
    recordings : tuple of Recording
        Where the experiments came from (empty if they were given directly).
    """

    model: Model
    experiments: tuple[Experiment, ...]
    names: tuple[str, ...]
    parameters: ParameterSet
    fixed: Mapping[str, float] = field(default_factory=dict)
    noise: NoiseModel = field(default_factory=NoiseModel)
    solver: SolverSettings = field(default_factory=SolverSettings)
    recordings: tuple[Recording, ...] = ()

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.experiments[0].outputs

    @property
    def measured(self) -> tuple[FloatArray, ...]:
        """Measurements of each experiment, shape (n, m)."""
        return tuple(_measured(e) for e in self.experiments)

    @property
    def scale(self) -> FloatArray:
        """Range of each output over all recordings, shape (m,): what its errors are compared with before any fit."""
        stacked = np.concatenate(self.measured)
        spread = np.nanmax(stacked, axis=0) - np.nanmin(stacked, axis=0)
        return np.where(spread > 0.0, spread, 1.0)

    @property
    def counts(self) -> NDArray[np.int64]:
        """Number of readings of each output, shape (m,)."""
        return np.asarray(sum(np.isfinite(y).sum(axis=0) for y in self.measured), dtype=np.int64)

    def problem(self) -> Problem:
        """What a simulator runs; the columns are ``parameters`` in order."""
        targets = tuple(
            tuple(p.target if p.recording in (None, e) else None for p in self.parameters)
            for e in range(len(self.experiments))
        )
        return Problem(self.model, self.experiments, targets, dict(self.fixed), self.solver)

    def thinned(self, samples: int) -> Calibration:
        """The same problem on at most about ``samples`` sample times a recording; inputs stay as they are."""
        return replace(self, experiments=tuple(_thin(e, samples) for e in self.experiments))

    def with_parameters(self, parameters: ParameterSet) -> Calibration:
        """The same problem with other free parameters."""
        return replace(self, parameters=parameters)


def _measured(experiment: Experiment) -> FloatArray:
    if experiment.measured is None:
        raise InputError("an experiment without measurements cannot be fitted")
    return experiment.measured


def _thin(experiment: Experiment, samples: int) -> Experiment:
    every = -(-experiment.time.size // samples)
    if every <= 1:
        return experiment
    rows = np.arange(0, experiment.time.size, every)
    return replace(experiment, time=experiment.time[rows], measured=_measured(experiment)[rows])


def calibrate(
    recordings: Sequence[Recording],
    model: Model,
    parameters: ParameterSet,
    *,
    fixed: Mapping[str, float] | None = None,
    noise: NoiseModel | None = None,
    settings: CalibrationSettings | None = None,
) -> Calibration:
    """Put recordings and a model together, with a nuisance delay and start for each recording that needs them.

    Raises
    ------
    InputError
        If nothing was recorded that the model can predict, or the model lacks an input that was recorded.
    """
    settings = settings or CalibrationSettings()
    if not recordings:
        raise InputError("no recording was given")
    outputs = _outputs(recordings, model, settings)
    driven = {variable.name for variable in model.inputs}
    experiments, nuisances = [], []
    for index, recording in enumerate(recordings):
        missing = [name for name in recording.inputs if name not in driven]
        if missing:
            raise InputError(f"{recording.name}: model {model.name} has no input {missing[0]}")
        experiment, extra = _experiment(recording, index, model, outputs, settings, alone=len(recordings) == 1)
        experiments.append(experiment)
        nuisances += extra
    return Calibration(
        model,
        tuple(experiments),
        tuple(recording.name for recording in recordings),
        parameters.extended(nuisances),
        dict(fixed or {}),
        noise or NoiseModel(),
        settings.solver,
        tuple(recordings),
    )


def _outputs(recordings: Sequence[Recording], model: Model, settings: CalibrationSettings) -> tuple[str, ...]:
    known = tuple(variable.name for variable in model.outputs)
    seen = {name for recording in recordings for name, y in recording.outputs.items() if np.isfinite(y).any()}
    wanted = settings.outputs if settings.outputs is not None else tuple(name for name in known if name in seen)
    for name in wanted:
        if name not in known:
            raise InputError(f"model {model.name} has no output {name}; it has {', '.join(known)}")
        if name not in seen:
            raise InputError(f"no recording has readings of {name}")
    if not wanted:
        raise InputError(f"no output of model {model.name} ({', '.join(known)}) was recorded")
    return tuple(wanted)


def _experiment(
    recording: Recording,
    index: int,
    model: Model,
    outputs: tuple[str, ...],
    settings: CalibrationSettings,
    *,
    alone: bool,
) -> tuple[Experiment, list[Parameter]]:
    own = [name for name in outputs if name in recording.outputs]
    base = to_experiment(recording, own)
    measured = np.full((recording.rows, len(outputs)), np.nan)
    for column, name in enumerate(outputs):
        if name in recording.outputs:
            measured[:, column] = recording.outputs[name]
    suffix = "" if alone else f"[{recording.name}]"
    start: dict[str, float] = {}
    nuisances: list[Parameter] = []
    in_motion = any(signal.values[0] != 0.0 and signal.time[0] >= recording.time[0] for signal in base.inputs)
    for column, name in enumerate(outputs):
        state = _state_of(model, name)
        reading = _first_reading(measured[:, column], recording)
        if state is None or reading is None or not (name in settings.resting or in_motion):
            continue
        start[state] = reading
        floor = _white_floor(measured[:, column])
        if name in settings.resting and (settings.start == "estimated" or (settings.start == "auto" and floor > 0.0)):
            nuisances.append(_start_parameter(name, state, reading, floor, measured[:, column], index, model, suffix))
    if _delay_wanted(base, recording, settings):
        nuisances.append(
            Parameter(
                f"input_delay{suffix}", "s", 0.3 * settings.delay_limit, 0.0, settings.delay_limit,
                Uniform(0.0, settings.delay_limit), "linear", "delay of the input", DelayTarget(), index,
            )
        )  # fmt: skip
    return replace(base, outputs=outputs, measured=measured, start=start), nuisances


def _state_of(model: Model, output: str) -> str | None:
    """The state that an output is an alias of, if it is one."""
    if any(s.name == output for s in model.states):
        return output
    index = model.copied_state(output)
    return None if index is None else model.states[index].name


def _first_reading(values: FloatArray, recording: Recording) -> float | None:
    """The reading at the first samples; None if they are gaps (within a hundredth of the recording)."""
    seen = np.flatnonzero(np.isfinite(values))
    if seen.size == 0 or recording.time[seen[0]] - recording.time[0] > 0.01 * recording.duration:
        return None
    return float(values[seen[0]])


def _white_floor(values: FloatArray) -> float:
    """Standard deviation of white noise by third differences, robust; zero for a quantised sensor at rest."""
    seen = values[np.isfinite(values)]
    if seen.size < 8:
        return 0.0
    return float(1.4826 * np.median(np.abs(np.diff(seen, 3))) / 20.0**0.5)


def _start_parameter(
    name: str,
    state: str,
    reading: float,
    floor: float,
    values: FloatArray,
    index: int,
    model: Model,
    suffix: str,
) -> Parameter:
    width = max(floor, 1e-4 * float(np.nanmax(values) - np.nanmin(values)), 1e-12)
    unit = next(v.unit for v in model.outputs if v.name == name)
    low, high = reading - 8.0 * width, reading + 8.0 * width
    return Parameter(
        f"{name}_start{suffix}", unit, reading, low, high, Normal(reading, width, low, high), "linear",
        f"initial value of {name}", StartTarget(state), index,
    )  # fmt: skip


def _delay_wanted(experiment: Experiment, recording: Recording, settings: CalibrationSettings) -> bool:
    if settings.delay == "none" or settings.delay == "free":
        return settings.delay == "free"
    jumps = any(s.interpolation == "hold" and s.values.size > 1 for s in experiment.inputs)
    return jumps and recording.rate_hz >= 0.2 / settings.delay_limit


def split_targets(parameters: ParameterSet) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Columns of model parameters, and columns of nuisances."""
    physical = tuple(j for j, p in enumerate(parameters) if isinstance(p.target, ParameterTarget))
    return physical, tuple(j for j in range(len(parameters)) if j not in physical)


def describe_target(target: Target) -> str:
    """What a column means, for a report."""
    return type(target).__name__.removesuffix("Target").lower()

"""A fitting problem: model, recordings, free and nuisance parameters, and the problem that a simulator gets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from aero_bayes.checkpoint import digest
from aero_bayes.data import Recording, to_experiment
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration_settings import CalibrationSettings
from aero_bayes.estimate.initial_states import start_parameters
from aero_bayes.estimate.nuisances import check_inputs, largest_delay, nuisance_parameters, recording_suffix
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.plausible import check_plausible
from aero_bayes.estimate.process_noise import process_parameters, uncertain_start
from aero_bayes.estimate.recording_parameters import for_recordings, with_started_states
from aero_bayes.estimate.thinning import rows_of_first_readings, thin
from aero_bayes.sensors.noise import NoiseModel
from aero_bayes.sensors.quantisation import quantum, thin_constant_readings
from aero_bayes.sensors.reading_spread import SpreadModel
from aero_bayes.simulation.interface import (
    Experiment,
    Interpolation,
    Problem,
    ProcessNoise,
    SolverSettings,
    StartTarget,
)
from aero_bayes.simulation.model import Model

FloatArray = NDArray[np.float64]

#: Largest number of solver steps for each change of an input.
MAX_STEPS_PER_CHANGE = 60


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
    floors : mapping of str to float
        Least standard deviation of the noise by output, where a sensor counts.
    spreads : mapping of str to SpreadModel
        By output, where the noise is not equally large at each reading; the experiments hold the spreads.
    process : ProcessNoise, optional
        Process noise of the states; what is estimated of it is among the ``parameters``.
    """

    model: Model
    experiments: tuple[Experiment, ...]
    names: tuple[str, ...]
    parameters: ParameterSet
    fixed: Mapping[str, float] = field(default_factory=dict)
    noise: NoiseModel = field(default_factory=NoiseModel)
    solver: SolverSettings = field(default_factory=SolverSettings)
    recordings: tuple[Recording, ...] = ()
    floors: Mapping[str, float] = field(default_factory=dict)
    process: ProcessNoise | None = None
    spreads: Mapping[str, SpreadModel] = field(default_factory=dict)

    @cached_property
    def identity(self) -> str:
        """Hash of what makes the problem this one: model, data, parameters, noise, solver."""
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("model", "recordings")}
        return digest(self.model.sha256, own)

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.experiments[0].outputs

    @property
    def interpolation(self) -> dict[str, Interpolation]:
        """What each input does between its samples, by name."""
        return {signal.name: signal.interpolation for e in self.experiments for signal in e.inputs}

    @property
    def measured(self) -> tuple[FloatArray, ...]:
        """Measurements of each experiment, shape (n, m)."""
        return tuple(_measured(e) for e in self.experiments)

    @property
    def readings(self) -> tuple[FloatArray, ...]:
        """Everything that was read at the experiments' times, (n, m), also what does not count (a standing encoder)."""
        if not self.recordings:
            return self.measured
        found = []
        for recording, experiment, measured in zip(self.recordings, self.experiments, self.measured, strict=True):
            rows = np.searchsorted(recording.time, experiment.time)
            every = measured.copy()
            for column, name in enumerate(experiment.outputs):
                if name in recording.outputs:
                    gaps = np.isnan(measured[:, column])
                    every[gaps, column] = recording.outputs[name][rows[gaps]]
            found.append(every)
        return tuple(found)

    @property
    def raw_readings(self) -> tuple[FloatArray, ...]:
        """What was recorded at the experiments' times, (n, m), ripple included."""
        if not self.recordings:
            return self.measured
        found = []
        for recording, experiment in zip(self.recordings, self.experiments, strict=True):
            rows = np.searchsorted(recording.time, experiment.time)
            gap = np.full(recording.rows, np.nan)
            found.append(np.column_stack([recording.outputs.get(o, gap)[rows] for o in experiment.outputs]))
        return tuple(found)

    @property
    def scale(self) -> FloatArray:
        """Range of each output over all recordings, shape (m,): what its errors are compared with before any fit."""
        stacked = np.concatenate(self.measured)
        spread = np.nanmax(stacked, axis=0) - np.nanmin(stacked, axis=0)
        return np.where(spread > 0.0, spread, 1.0)

    @property
    def stop(self) -> float:
        """When the longest recording ends, in s."""
        return max(float(e.time[-1]) for e in self.experiments)

    @cached_property
    def intervals(self) -> tuple[float, ...]:
        """Sample interval of each experiment in s."""
        return tuple(float(np.median(np.diff(e.time))) for e in self.experiments)

    @property
    def counts(self) -> NDArray[np.int64]:
        """Number of readings of each output, shape (m,)."""
        return np.asarray(sum(np.isfinite(y).sum(axis=0) for y in self.measured), dtype=np.int64)

    def problem(self) -> Problem:
        """Return what a simulator runs; the columns are ``parameters`` in order."""
        targets = tuple(
            tuple(p.target if p.acts_in(e) else None for p in self.parameters) for e in range(len(self.experiments))
        )
        changes = max((s.time.size for e in self.experiments for s in e.inputs), default=0)
        if self.process is not None:
            changes += max(e.time.size for e in self.experiments)
        # An engine starts anew wherever an input changes, and a filter at every reading.
        steps = max(self.solver.max_steps, MAX_STEPS_PER_CHANGE * changes)
        solver = replace(self.solver, max_steps=steps)
        return Problem(self.model, self.experiments, targets, dict(self.fixed), solver, self.process)

    def beginning(self, share: float) -> Calibration:
        """Keep the first ``share`` of each recording's samples, at least twenty readings an output."""
        shorter = []
        for e, measured in zip(self.experiments, self.measured, strict=True):
            stop = max(int(share * e.time.size), rows_of_first_readings(measured))
            shorter.append(e.at_samples(slice(stop)))
        return replace(self, experiments=tuple(shorter))

    def thinned(self, samples: int) -> Calibration:
        """Return the same problem on at most about ``samples`` sample times a recording; inputs stay as they are."""
        return replace(self, experiments=tuple(thin(e, samples) for e in self.experiments))

    def with_process_noise(self, noise: NoiseModel) -> Calibration:
        """Return the same problem with process noise.

        Initial values of recordings are integrated out in place of estimated.

        Raises
        ------
        InputError
            For a state that the model does not have.
        """
        starts = [p for p in self.parameters if p.recording is not None and isinstance(p.target, StartTarget)]
        experiments = []
        for index, e in enumerate(self.experiments):
            own = [p for p in starts if p.recording == index]
            start, start_sd = uncertain_start(e.start, own, e, self.model, noise.initial_sd)
            experiments.append(replace(e, start=start, start_sd=start_sd))
        process, new = process_parameters(noise, self.model, experiments, self.floors)
        taken = {p.target for p in self.parameters}
        kept = [p for p in self.parameters if p not in starts] + [p for p in new if p.target not in taken]
        return replace(
            self, experiments=tuple(experiments), parameters=ParameterSet(tuple(kept)), noise=noise, process=process
        )


def _measured(experiment: Experiment) -> FloatArray:
    if experiment.measured is None:
        raise InputError("an experiment without measurements cannot be fitted")
    return experiment.measured


def calibrate(
    recordings: Sequence[Recording],
    model: Model,
    parameters: ParameterSet,
    *,
    fixed: Mapping[str, float] | None = None,
    noise: NoiseModel | None = None,
    settings: CalibrationSettings | None = None,
) -> Calibration:
    """Combine recordings and a model, with a nuisance delay and initial values for each recording that needs them.

    Parameters
    ----------
    recordings : sequence of Recording
    model : Model
    parameters : ParameterSet
        What is searched.
    fixed : mapping of str to float, optional
        Model parameters held at other values than the model's own, in SI units.
    noise : NoiseModel, optional
    settings : CalibrationSettings, optional

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If nothing was recorded that the model can predict, or the inputs recorded are not those of the model.
    """
    settings, noise = settings or CalibrationSettings(), noise or NoiseModel()
    if not recordings:
        raise InputError("no recording was given")
    check_plausible(recordings, model)
    limit = largest_delay(recordings, model, settings)
    outputs = _outputs(recordings, model, settings)
    if isinstance(settings.interpolation, Mapping):
        check_inputs(recordings, settings.interpolation, "interpolation")
    parameters = for_recordings(with_started_states(parameters, model), model, recordings)
    floors: dict[str, float] = {}
    at_rest = model.declared.recording.zero_at_rest
    whole = [_experiment(recording, outputs, floors, settings, at_rest) for recording in recordings]
    started = _with_starts(whole, recordings, model, settings, parameters)
    nuisances = nuisance_parameters(whole, [starts for _, starts in started], recordings, limit, settings.delay)
    # What the caller searches as a parameter of his own is no nuisance beside it.
    taken = {(p.target, p.recording) for p in parameters}
    new = [n for n in nuisances if (n.target, None) not in taken and (n.target, n.recording) not in taken]
    found = Calibration(
        model,
        tuple(replace(_thinned(e, settings), start=start) for e, (start, _) in zip(whole, started, strict=True)),
        tuple(recording.name for recording in recordings),
        parameters.extended(new),
        dict(fixed or {}),
        noise,
        settings.solver,
        tuple(recordings),
        floors,
    )
    return found.with_process_noise(noise) if noise.process else found


def _with_starts(
    experiments: Sequence[Experiment],
    recordings: Sequence[Recording],
    model: Model,
    settings: CalibrationSettings,
    parameters: ParameterSet,
) -> list[tuple[Mapping[str, float], list[Parameter]]]:
    """Return, for each recording, the values that states begin at, and the parameters of those that are estimated."""
    resting = model.declared.recording.resting
    may_start_at_rest = resting if settings.may_start_at_rest is None else settings.may_start_at_rest
    given = {state for p in parameters for state in p.starts}
    return [
        start_parameters(
            recording,
            experiment,
            model,
            settings.initial_states,
            may_start_at_rest,
            index,
            recording_suffix(recordings, index),
            given,
        )
        for index, (recording, experiment) in enumerate(zip(recordings, experiments, strict=True))
    ]


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
    outputs: tuple[str, ...],
    floors: dict[str, float],
    settings: CalibrationSettings,
    zero_at_rest: tuple[str, ...],
) -> Experiment:
    """Make an experiment of all ``outputs``, NaN where it has none.

    Of a count that stands still, few readings count.
    """
    measured = np.full((recording.rows, len(outputs)), np.nan)
    for column, name in enumerate(outputs):
        if name in recording.outputs:
            values = recording.outputs[name].copy()
            step = quantum(values)
            if step > 0.0:
                # A little less than the count's own spread, which a motion through many counts may undercut.
                floors[name] = max(0.9 * step / 12.0**0.5, floors.get(name, 0.0))
                if not settings.keep_standstill_readings:
                    values[~thin_constant_readings(recording.time, values)] = np.nan
            measured[:, column] = values
    own = [name for name in outputs if name in recording.outputs]
    between = "hold" if settings.interpolation == "auto" else settings.interpolation
    base = to_experiment(recording, own, zero_at_rest=zero_at_rest, interpolation=between)
    return replace(base, outputs=outputs, measured=measured)


def _thinned(experiment: Experiment, settings: CalibrationSettings) -> Experiment:
    return experiment if settings.most_readings is None else thin(experiment, settings.most_readings)

"""A fitting problem: model, recordings, free and nuisance parameters, and the problem that a simulator gets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from aero_bayes.checkpoint import digest
from aero_bayes.data import Recording, to_experiment
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration_settings import CalibrationSettings
from aero_bayes.estimate.initial_states import start_parameters
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.nuisances import check_inputs, largest_delay, nuisance_parameters, recording_suffix
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.plausible import check_plausible
from aero_bayes.estimate.process_noise import process_parameters, uncertain_start
from aero_bayes.estimate.recording_parameters import for_recordings, with_started_states
from aero_bayes.estimate.thinning import thin
from aero_bayes.sensors.noise import NoiseModel, OutputNoise
from aero_bayes.sensors.quantisation import quantum, thin_constant_readings
from aero_bayes.simulation.interface import (
    Experiment,
    Problem,
    ProcessNoise,
    SolverSettings,
    StartTarget,
)
from aero_bayes.simulation.model import Model

#: Largest number of solver steps for each change of an input.
MAX_STEPS_PER_CHANGE = 60


@dataclass(frozen=True)
class SimulatedModel:
    """A model and how it is simulated."""

    model: Model
    fixed: Mapping[str, float] = field(default_factory=dict)
    solver: SolverSettings = field(default_factory=SolverSettings)
    process: ProcessNoise | None = None


@dataclass(frozen=True)
class Calibration:
    """One fitting problem."""

    data: MeasuredData
    simulated: SimulatedModel
    parameters: ParameterSet
    noise: NoiseModel = field(default_factory=NoiseModel)

    @property
    def model(self) -> Model:
        return self.simulated.model

    @cached_property
    def identity(self) -> str:
        """Hash of what makes the problem this one: model, data, parameters, noise, solver."""
        run = self.simulated
        data = replace(self.data, recordings=())
        return digest(run.model.sha256, data, run.fixed, run.solver, run.process, self.parameters, self.noise)

    @property
    def known_noise(self) -> dict[str, OutputNoise]:
        """The noise of outputs whose standard deviation is declared: it is not estimated."""
        data = self.data
        return {
            o: OutputNoise(data.spreads[o].base, white_identified=False) for o in data.outputs if o in self.noise.sd
        }

    def problem(self) -> Problem:
        """Return what a simulator runs; the columns are ``parameters`` in order."""
        run, experiments = self.simulated, self.data.experiments
        targets = tuple(
            tuple(p.target if p.acts_in(e) else None for p in self.parameters) for e in range(len(experiments))
        )
        changes = max((s.time.size for e in experiments for s in e.inputs), default=0)
        if run.process is not None:
            changes += max(e.time.size for e in experiments)
        # An engine starts anew wherever an input changes, and a filter at every reading.
        steps = max(run.solver.max_steps, MAX_STEPS_PER_CHANGE * changes)
        solver = replace(run.solver, max_steps=steps)
        return Problem(run.model, experiments, targets, dict(run.fixed), solver, run.process)

    def with_process_noise(self, noise: NoiseModel) -> Calibration:
        """Return the same problem with process noise.

        Initial values of recordings are integrated out in place of estimated."""
        starts = [p for p in self.parameters if p.recording is not None and isinstance(p.target, StartTarget)]
        experiments = []
        for index, e in enumerate(self.data.experiments):
            own = [p for p in starts if p.recording == index]
            start, start_sd = uncertain_start(e.start, own, e, self.model, noise.initial_sd)
            experiments.append(replace(e, start=start, start_sd=start_sd))
        process, new = process_parameters(noise, self.model, experiments, self.data.floors)
        taken = {p.target for p in self.parameters}
        kept = [p for p in self.parameters if p not in starts] + [p for p in new if p.target not in taken]
        data, simulated = self.data.with_experiments(experiments), replace(self.simulated, process=process)
        return Calibration(data, simulated, ParameterSet(tuple(kept)), noise)


def calibrate(
    recordings: Sequence[Recording],
    model: Model,
    parameters: ParameterSet,
    *,
    fixed: Mapping[str, float] | None = None,
    noise: NoiseModel | None = None,
    settings: CalibrationSettings | None = None,
) -> Calibration:
    """Combine recordings and a model, with a nuisance delay and initial values for each recording that needs them."""
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
    data = MeasuredData(
        tuple(replace(_thinned(e, settings), start=start) for e, (start, _) in zip(whole, started, strict=True)),
        tuple(recording.name for recording in recordings),
        tuple(recordings),
        floors,
    )
    data = data.with_known_noise(noise) if noise.sd else data
    simulated = SimulatedModel(model, dict(fixed or {}), settings.solver)
    found = Calibration(data, simulated, parameters.extended(new), noise)
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

    Of a count that stands still, few readings count."""
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

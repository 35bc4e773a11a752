"""One fitting problem: recordings, a model and its parameters, those of single recordings among them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.checkpoint import digest
from aero_bayes.data.noise_floor import quantisation_step
from aero_bayes.data.recording import Recording, to_experiment
from aero_bayes.errors import InputError
from aero_bayes.estimate.initial_states import (
    CalibrationSettings,
    DelayPolicy,
    check_plausible,
    first_reading_of,
    process_parameters,
    start_parameters,
    state_of,
    uncertain_start,
)
from aero_bayes.estimate.measured_data import MeasuredData, thin
from aero_bayes.estimate.noise import NoiseModel, OutputNoise
from aero_bayes.estimate.noise_estimation import thin_constant_readings
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.priors import Uniform
from aero_bayes.simulation.interface import (
    DelayTarget,
    Experiment,
    ParameterTarget,
    Problem,
    ProcessNoise,
    Simulator,
    SolverSettings,
    StartTarget,
)
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.probed_facts import start_parameters as parameters_that_start_states


def with_started_states(parameters: ParameterSet, model: Model) -> ParameterSet:
    """Return the parameters, with those that are nothing but the initial value of states marked as such."""
    names = [p.target.name for p in parameters if isinstance(p.target, ParameterTarget) and p.recording is None]
    found = parameters_that_start_states(model, names)
    return ParameterSet(tuple(replace(p, starts=found.get(_target_name(p), p.starts)) for p in parameters))


def for_recordings(parameters: ParameterSet, model: Model, recordings: Sequence[Recording]) -> ParameterSet:
    """Put one parameter a recording, ``C@recording``, in the place of each that has a value of its own in each.

    The parts of a recording that was cut at a gap share one, unless it is an initial value. An initial value keeps its
    own name where there is one recording, and is searched from the first reading."""
    found: list[Parameter] = []
    for p in parameters:
        if p.recording is not None or not (p.per_recording or p.starts):
            found.append(p)
            continue
        alone = len(recordings) == 1 and not p.per_recording
        for name, (index, *others) in _groups(p, recordings).items():
            own = p.name if alone else f"{p.name}@{name}"
            start = _start(p, model, recordings[index])
            found.append(replace(p, name=own, recording=index, start=start, shared_with=tuple(others)))
    return ParameterSet(tuple(found))


def _groups(p: Parameter, recordings: Sequence[Recording]) -> dict[str, list[int]]:
    """Group recordings that share a value, by the name of the value: the parts of one, or each its own."""
    found: dict[str, list[int]] = {}
    for index, recording in enumerate(recordings):
        shared = recording.part_of and not p.starts
        found.setdefault(recording.part_of if shared else recording.name, []).append(index)
    return found


def templates(parameters: Iterable[Parameter]) -> list[Parameter]:
    """Return the parameters that :func:`for_recordings` made those with a recording of; the others as they are.

    Nuisances of recordings (delays, initial values without a parameter) are left out."""
    found: dict[str, Parameter] = {}
    for p in parameters:
        if p.recording is None:
            found[p.name] = p
        elif p.per_recording or p.starts:
            found.setdefault(_target_name(p), replace(p, name=_target_name(p), recording=None, shared_with=()))
    return list(found.values())


def values_of_recordings(parameters: Iterable[Parameter], values: Iterable[float]) -> Mapping[str, dict[str, float]]:
    """List values that differ by recording, by the name of the model's parameter, then by their own."""
    found: dict[str, dict[str, float]] = {}
    for p, value in zip(parameters, values, strict=True):
        if p.recording is not None and isinstance(p.target, ParameterTarget):
            found.setdefault(p.target.name, {})[p.name] = value
    return found


def _target_name(p: Parameter) -> str:
    return p.target.name if isinstance(p.target, ParameterTarget) else ""


def _start(p: Parameter, model: Model, recording: Recording) -> float:
    """Return where the search starts: an initial value that was read starts at the first reading."""
    readings = [
        first for output, values in recording.outputs.items()
        if (state := state_of(model, output)) is not None and state.name in p.starts
        and (first := first_reading_of(values, recording)) is not None
    ]  # fmt: skip
    return float(np.clip(readings[0], p.lower, p.upper)) if readings else p.start


def _delays(
    experiments: Sequence[Experiment], recordings: Sequence[Recording], model: Model, settings: CalibrationSettings
) -> list[Parameter]:
    """List the delays that are searched: of all inputs by one time in each recording, or of single ones in all."""
    declared, policy = model.declared.recording.max_input_delay, settings.delay
    limit = declared if settings.max_input_delay is None else settings.max_input_delay
    if policy == "free" and not limit:
        raise InputError(f"model {model.name} declares no input delay: give its max_input_delay")
    if not isinstance(limit, Mapping):
        wanted = [k for k, e in enumerate(experiments) if _delay_wanted([e], policy, limit)]
        names = {k: f"input_delay{recording_suffix(recordings, k)}" for k in wanted}
        return [_delay(name, limit, "delay of the input", DelayTarget(), k) for k, name in names.items()]
    check_inputs(recordings, limit, "delay")
    return [
        _delay(f"{name}_delay", most, f"delay of {name}", DelayTarget(name))
        for name, most in limit.items()
        if _delay_wanted(experiments, policy, most, name)
    ]


def _delay(name: str, limit: float, about: str, target: DelayTarget, recording: int | None = None) -> Parameter:
    """Return a delay by up to ``limit`` s; below zero, the input acts before it is logged."""
    low, high = min(limit, 0.0), max(limit, 0.0)
    return Parameter(name, "s", 0.3 * limit, low, high, Uniform(low, high), "linear", about, target, recording)


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
    if policy != "auto" or not limit:
        return policy == "free" and limit != 0.0
    return any(
        len(e.time) > 1
        and np.median(np.diff(e.time)) <= 5.0 * abs(limit)
        and any(np.any(np.diff(signal.values)) for signal in e.inputs if name in (None, signal.name))
        for e in experiments
    )


def recording_suffix(recordings: Sequence[Recording], index: int) -> str:
    """End of the names of a recording's own parameters."""
    return "" if len(recordings) == 1 else f"[{recordings[index].name}]"


#: Largest number of solver steps for each change of an input.
MAX_STEPS_PER_CHANGE = 60


@dataclass(frozen=True)
class Calibration:
    """One fitting problem: what was measured, a model and how it is simulated, its parameters and the noise.

    ``settings`` are those by which recordings were turned into it, and by which others will be."""

    data: MeasuredData
    model: Model
    parameters: ParameterSet
    noise: NoiseModel = field(default_factory=NoiseModel)
    fixed: Mapping[str, float] = field(default_factory=dict)
    solver: SolverSettings = field(default_factory=SolverSettings)
    process: ProcessNoise | None = None
    settings: CalibrationSettings = field(default_factory=CalibrationSettings)

    @cached_property
    def identity(self) -> str:
        """Hash of what makes the problem this one: model, data, parameters, noise, solver."""
        data = replace(self.data, recordings=())
        return digest(self.model.sha256, data, self.fixed, self.solver, self.process, self.parameters, self.noise)

    @property
    def known_noise(self) -> dict[str, OutputNoise]:
        """The noise of outputs whose standard deviation is declared: it is not estimated."""
        data = self.data
        return {
            o: OutputNoise(data.spreads[o].base, white_identified=False) for o in data.outputs if o in self.noise.sd
        }

    def problem(self) -> Problem:
        """Return what a simulator runs; the columns are ``parameters`` in order."""
        experiments = self.data.experiments
        targets = tuple(
            tuple(p.target if p.acts_in(e) else None for p in self.parameters) for e in range(len(experiments))
        )
        changes = max((s.time.size for e in experiments for s in e.inputs), default=0)
        if self.process is not None:
            changes += max(e.time.size for e in experiments)
        # An engine starts anew wherever an input changes, and a filter at every reading.
        steps = max(self.solver.max_steps, MAX_STEPS_PER_CHANGE * changes)
        solver = replace(self.solver, max_steps=steps)
        return Problem(self.model, experiments, targets, dict(self.fixed), solver, self.process)

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
        data, parameters = self.data.with_experiments(experiments), ParameterSet(tuple(kept))
        return replace(self, data=data, parameters=parameters, noise=noise, process=process)


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
    driven = {variable.name for variable in model.inputs}
    for recording in recordings:
        if unknown := [name for name in recording.inputs if name not in driven]:
            other = ", which may be no array and no text" if model.causality_of(unknown[0]) == "input" else ""
            raise InputError(f"{recording.name}: model {model.name} has no input {unknown[0]}{other}")
    outputs = _outputs(recordings, model, settings)
    if isinstance(settings.interpolation, Mapping):
        check_inputs(recordings, settings.interpolation, "interpolation")
    found = assemble(recordings, model, parameters, fixed, noise, replace(settings, outputs=outputs))
    return replace(found, settings=settings)


def assemble(
    recordings: Sequence[Recording], model: Model, parameters: ParameterSet, fixed: Mapping[str, float] | None,
    noise: NoiseModel, settings: CalibrationSettings,
) -> Calibration:  # fmt: skip
    """Return :func:`calibrate` for recordings that are known to belong to the model, and perhaps have no readings."""
    outputs = settings.outputs or ()
    parameters = for_recordings(with_started_states(parameters, model), model, recordings)
    floors: dict[str, float] = {}
    at_rest = model.declared.recording.zero_at_rest
    whole = [_experiment(recording, outputs, floors, settings, at_rest) for recording in recordings]
    given = {state for p in parameters for state in p.starts}
    started = [
        start_parameters(recording, e, model, settings, k, recording_suffix(recordings, k), given)
        for k, (recording, e) in enumerate(zip(recordings, whole, strict=True))
    ]
    delays = _delays(whole, recordings, model, settings)
    nuisances = [p for k, (_, own) in enumerate(started) for p in (*own, *(d for d in delays if d.recording == k))]
    nuisances += [d for d in delays if d.recording is None]
    # What the caller searches as a parameter of his own is no nuisance beside it.
    taken = {(p.target, p.recording) for p in parameters}
    new = [n for n in nuisances if (n.target, None) not in taken and (n.target, n.recording) not in taken]
    data = MeasuredData(
        tuple(
            replace(thin(e, settings.most_readings) if settings.most_readings else e, start=start)
            for e, (start, _) in zip(whole, started, strict=True)
        ),
        tuple(recording.name for recording in recordings),
        tuple(recordings),
        floors,
    )
    data = data.with_known_noise(noise) if noise.sd else data
    found = Calibration(
        data, model, parameters.extended(new), noise, dict(fixed or {}), settings.solver, settings=settings
    )
    return found.with_process_noise(noise) if noise.process else found


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
            if (step := quantisation_step(values) or 0.0) > 0.0:
                # A little less than the count's own spread, which a motion through many counts may undercut.
                floors[name] = max(0.9 * step / 12.0**0.5, floors.get(name, 0.0))
                if not settings.keep_standstill_readings:
                    values[~thin_constant_readings(recording.time, values)] = np.nan
            measured[:, column] = values
    own = [name for name in outputs if name in recording.outputs]
    between = "hold" if settings.interpolation == "auto" else settings.interpolation
    base = to_experiment(recording, own, zero_at_rest=zero_at_rest, interpolation=between)
    return replace(base, outputs=outputs, measured=measured)


#: Steps of a candidate over those of the first model on the same recording. Dry friction needs about ten times as many.
MOST_STEPS_RATIO = 20
#: Steps of the first model that count at least: a run without any may lack just what moves it.
LEAST_STEPS = 100


def steps_taken(calibration: Calibration, simulator: Simulator, coordinates: FloatArray) -> tuple[int, ...]:
    """Return the steps that one run of each recording takes; none where the simulator does not count them."""
    steps = simulator.simulate(calibration.parameters.from_search(coordinates)[None]).steps
    return () if steps is None else tuple(int(n) for n in steps[0])


def with_step_budget(calibration: Calibration, steps: Sequence[int]) -> Calibration:
    """Return a calibration whose runs end as too slow beyond a multiple of the first model's ``steps``."""
    if not steps:
        return calibration
    pairs = zip(calibration.data.experiments, steps, strict=True)
    limited = (replace(e, most_steps=MOST_STEPS_RATIO * max(n, LEAST_STEPS)) for e, n in pairs)
    return replace(calibration, data=calibration.data.with_experiments(limited))

"""What a calibration is made by: its settings, checks of recordings, initial values of states, and process noise.

Diffusion and reading noise hang together in the likelihood, so that both are searched and sampled with the parameters.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from aero_bayes.arguments import names_of
from aero_bayes.arrays import FloatArray
from aero_bayes.data.columns import ColumnMap, noise_size
from aero_bayes.data.mend import mend
from aero_bayes.data.noise_floor import output_noise_floor
from aero_bayes.data.read import column_names
from aero_bayes.data.recording import Recording
from aero_bayes.display import SettingsDisplay
from aero_bayes.errors import InputError
from aero_bayes.estimate.measured_data import readings_of
from aero_bayes.estimate.noise import NoiseModel
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.priors import LogNormal, Normal
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import (
    DiffusionTarget,
    Experiment,
    Interpolation,
    Outcome,
    Problem,
    ProcessNoise,
    ReadingNoiseTarget,
    SolverSettings,
    StartTarget,
)
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.model_description import Variable
from aero_bayes.simulation.problem_checks import check_process
from aero_bayes.unknown_names import closest_name

#: ``reading``: states that are outputs start at their first reading; ``estimated``: every state's start is estimated;
#: ``auto``: those that are outputs and may start anywhere are estimated about their reading, but where this agrees with
#: a start that the model fixes.
StartPolicy = Literal["auto", "reading", "estimated"]

#: Prior standard deviation of an initial value about its reading: this many of the largest plausible standard
#: deviations of the noise, limited to shares of the output's range.
NOISE_DEVIATIONS, MIN_SPREAD_SHARE, MAX_SPREAD_SHARE = 5.0, 0.002, 0.1
#: Standard deviations of the noise within which a first reading agrees with a start that the model fixes.
HELD_WITHIN = 3.0
#: Readings at the beginning whose noise counts, too.
FIRST_READINGS = 20
#: Bounds of an initial value about its expectation, in prior standard deviations.
MAX_DEVIATION = 8.0


def start_parameters(
    recording: Recording, experiment: Experiment, model: Model, settings: CalibrationSettings, index: int, suffix: str,
    given: Collection[str] = (),
) -> tuple[dict[str, float], list[Parameter]]:  # fmt: skip
    """Choose initial values of states by name, and those that are estimated."""
    assert experiment.measured is not None
    policy = "estimated" if recording.resumes else settings.initial_states
    resting = model.declared.recording.resting
    may_start_at_rest = resting if settings.may_start_at_rest is None else settings.may_start_at_rest
    start: dict[str, float] = {}
    found: list[Parameter] = []
    seen: set[str] = set()
    in_motion = any(signal.values[0] != 0.0 and signal.time[0] >= recording.time[0] for signal in experiment.inputs)
    for column, name in enumerate(experiment.outputs):
        state = state_of(model, name)
        values = experiment.measured[:, column]
        reading = first_reading_of(values, recording)
        free = may_start_at_rest is None or name in may_start_at_rest
        if state is None or state.name in given or reading is None or not (free or in_motion or policy == "estimated"):
            continue
        held = policy == "auto" and may_start_at_rest is None
        if held and starts_as_fixed(model, state, recording, name, reading):
            continue
        start[state.name] = reading
        seen.add(state.name)
        if policy == "estimated" or (policy == "auto" and free):
            spread = _reading_spread(recording, name, values)
            found.append(_start(_named(name, model) + suffix, name, state, reading, spread, index))
    if policy == "estimated":
        rest = [state for state in model.states if state.name not in seen and state.name not in given]
        spreads = state_sizes(model, experiment, rest)
        found += [held_start(model, s, spreads[s.name], suffix, index) for s in rest]
    return start, found


def starts_as_fixed(model: Model, state: Variable, recording: Recording, output: str, reading: float) -> bool:
    """Return whether a state starts where the model fixes it: a reading that contradicts that counts for more."""
    if state.name not in model.fixed_starts:
        return False
    noise = output_noise_floor(recording, output).sd or 0.0
    return abs(reading - (state.start or 0.0)) <= HELD_WITHIN * noise


def _reading_spread(recording: Recording, name: str, values: FloatArray) -> float:
    """Return how far a first reading may be off: some deviations of the noise, between two shares of the range."""
    moved = _range(values)
    # Noise that grows with the reading may be larger at the first ones than on the whole.
    first = noise_size(values[np.isfinite(values)][:FIRST_READINGS])
    noise = NOISE_DEVIATIONS * max(output_noise_floor(recording, name).at_most, first)
    return max(min(max(noise, MIN_SPREAD_SHARE * moved), MAX_SPREAD_SHARE * moved), 1e-9)


def with_free_starts(parameters: ParameterSet, experiments: Sequence[Experiment], model: Model) -> ParameterSet:
    """Widen the priors of initial values that were taken from a reading to a tenth of the output's range.

    A first fit trusts its readings; later checks of it must allow for a sensor with an offset."""
    return ParameterSet(
        tuple(p if p.recording is None else _with_free_start(p, experiments[p.recording], model) for p in parameters)
    )


def _with_free_start(p: Parameter, experiment: Experiment, model: Model) -> Parameter:
    """Return the initial value of a state that is an output with a wider prior; any other parameter unchanged."""
    if not isinstance(p.target, StartTarget) or not isinstance(p.prior, Normal) or experiment.measured is None:
        return p
    for column, name in enumerate(experiment.outputs):
        state = state_of(model, name)
        if state is not None and state.name == p.target.state:
            spread = max(p.prior.sd, MAX_SPREAD_SHARE * _range(experiment.measured[:, column]))
            low, high, prior = _start_prior(state, p.prior.mean, spread)
            return replace(p, lower=low, upper=high, prior=prior)
    return p


def _range(values: FloatArray) -> float:
    """Compute the range of readings, gaps left out; zero of none."""
    return float(np.nanmax(values) - np.nanmin(values)) if np.isfinite(values).any() else 0.0


def state_of(model: Model, output: str) -> Variable | None:
    """Return the state that an output is an alias of, if it is one."""
    own = next((s for s in model.states if s.name == output), None)
    if own is not None:
        return own
    index = model.copied_state(output)
    return None if index is None else model.states[index]


def _named(state: str, model: Model) -> str:
    """Name of a state's initial value, different from the model's own parameters (``y_start`` of a block)."""
    taken = any(p.name == f"{state}_start" for p in model.parameters)
    return f"{state}_initial" if taken else f"{state}_start"


def _start(name: str, of: str, state: Variable, expected: float, spread: float, index: int) -> Parameter:
    low, high, prior = _start_prior(state, expected, spread)
    return Parameter(
        name, state.unit, expected, low, high, prior, "linear", f"initial value of {of}", StartTarget(state.name), index
    )


def held_start(model: Model, state: Variable, size: float, suffix: str, index: int) -> Parameter:
    """Return the initial value of a state that the model fixes, as it is estimated; ``size`` is that of the state."""
    return _start(_named(state.name, model) + suffix, state.name, state, state.start or 0.0, size, index)


def _start_prior(state: Variable, expected: float, spread: float) -> tuple[float, float, Normal]:
    """Choose bounds and prior of a state's initial value."""
    low, high = expected - MAX_DEVIATION * spread, expected + MAX_DEVIATION * spread
    if state.minimum is not None and state.minimum < expected:
        low = max(low, state.minimum)
    if state.maximum is not None and state.maximum > expected:
        high = min(high, state.maximum)
    return low, high, Normal(expected, spread, low, high)


def state_sizes(model: Model, experiment: Experiment, states: list[Variable]) -> Mapping[str, float]:
    """Return a natural size of each state: its range in a simulation of the model as it is."""
    if not states:
        return {}
    names = tuple(state.name for state in states)
    watched = replace(experiment, outputs=names, measured=None, spread=None)
    with open_simulator(Problem(model, (watched,), ((),)), workers=0) as simulator:
        result = simulator.simulate(np.empty((1, 0)))
    spreads = {}
    for k, state in enumerate(states):
        sizes = [abs(state.start or 0.0), abs(state.nominal or 0.0)]
        if result.outcomes[0, 0] == Outcome.OK:
            sizes.append(float(np.ptp(result.outputs[0][0, :, k])))
        spreads[state.name] = max(*sizes, 0.0) or 1.0
    return spreads


def first_reading_of(values: FloatArray, recording: Recording) -> float | None:
    """Return the first reading; None if the first hundredth of the recording is a gap."""
    seen = np.flatnonzero(np.isfinite(values))
    if seen.size == 0 or recording.time[seen[0]] - recording.time[0] > 0.01 * recording.duration:
        return None
    return float(values[seen[0]])


DelayPolicy = Literal["auto", "free", "none"]


@dataclass(frozen=True, repr=False)
class CalibrationSettings(SettingsDisplay):
    """How recordings are turned into a problem.

    Parameters
    ----------
    outputs : tuple of str, optional
        Outputs to fit; all that were recorded and that the model has by default.
    delay : {"auto", "free", "none"}
        A delay of the inputs: of all by one time, a nuisance parameter of each recording, or of single ones, a
        parameter of the rig. ``auto`` frees it where the input changes and the samples are closer than five times
        ``max_input_delay``.
    max_input_delay : float or mapping of str to float, optional
        Upper bound of the delay in s, or of the delays of single inputs by name; one below zero is a lower bound, for
        an input that acts before it is logged. A delay moves the recorded signal, so that it is exact however long. By
        default what the model's package declares, and where it declares none there
        is no delay.
    initial_states : {"auto", "reading", "estimated"}
        Initial values of states, see :class:`StartPolicy`. With ``auto``, ``fixed = true`` in the Modelica model holds
        the start of a state that is read, too, where its first reading does not contradict it.
    may_start_at_rest : tuple of str, optional
        Outputs whose state may start anywhere, at rest; other states start at the model's own values unless the
        recording begins in mid-motion. By default what the model's package declares, else every output that is a
        state.
    most_readings : int, optional
        Readings of an output that a recording keeps; beyond it every n-th is kept.
    keep_standstill_readings : bool
        Whether all readings of a counter at standstill are fitted. Comparisons of models use few of them.
    interpolation : {"auto", "hold", "linear"} or mapping
        Whether inputs hold from a sample to the next or run in straight lines, all of them or by name; ``auto`` lets
        the fit decide for each that moves from sample to sample.
    solver : SolverSettings

    Examples
    --------
    >>> settings = aero_bayes.FitSettings(calibration=aero_bayes.CalibrationSettings(delay="none"))
    >>> list(aero_bayes.fit(recording, model, parameters=free, settings=settings, workers=0).parameters)
    ['k', 'd']
    """

    outputs: tuple[str, ...] | None = None
    delay: DelayPolicy = "auto"
    max_input_delay: float | Mapping[str, float] | None = None
    initial_states: StartPolicy = "auto"
    may_start_at_rest: tuple[str, ...] | None = None
    most_readings: int | None = None
    keep_standstill_readings: bool = True
    interpolation: Literal["auto", "hold", "linear"] | Mapping[str, Interpolation] = "hold"
    solver: SolverSettings = field(default_factory=SolverSettings)

    def __post_init__(self) -> None:
        for name in ("outputs", "may_start_at_rest"):
            if (given := getattr(self, name)) is not None:
                object.__setattr__(self, name, names_of(given, name))


def in_units_of(model: Model, recording: Recording) -> Recording:
    """Return a recording in the units of a model: what it says its columns are in is converted, the rest taken so."""
    wanted = {v.name: v.unit for v in (*model.inputs, *model.outputs)}
    units = {**wanted, **recording.units}

    def converted(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        return {name: ColumnMap(name, units[name]).convert(values, name, wanted[name])
                if wanted.get(name, "") not in ("", units.get(name, "")) and units[name] else values
                for name, values in columns.items()}  # fmt: skip

    own = {name: wanted.get(name) or unit for name, unit in units.items()}
    if units == recording.units == own:
        return recording
    try:
        return replace(recording, inputs=converted(recording.inputs), outputs=converted(recording.outputs), units=own)
    except InputError as error:
        raise InputError(f"{recording.path or recording.name}, {error}") from None


#: If the model starts above the first temperature in K, readings that begin below the second must be degrees Celsius.
MIN_KELVIN_START, MAX_CELSIUS_READING = 200.0, 150.0


def check_plausible(recordings: Iterable[Recording], model: Model) -> None:
    """Refuse recordings that lack an input of the model, or whose temperatures are in another unit."""
    for recording in recordings:
        _check_inputs(recording, model)
        _check_temperatures(recording, model)


def mended_recordings(recordings: Sequence[Recording], model: Model) -> tuple[Recording, ...]:
    """Mend and tell faults of recordings that were not mended yet, and cut these at gaps; in the model's units."""
    found: list[Recording] = []
    for recording in recordings:
        own = in_units_of(model, recording)
        found += [own] if own.mended else [replace(part, mended=True) for part in mend(own)]
    return tuple(found)


def _check_inputs(recording: Recording, model: Model) -> None:
    # a switch that nobody recorded keeps the value at which the FMU starts
    missing = [v.name for v in model.inputs if v.name not in recording.inputs and (v.kind == "real" or v.start is None)]
    if missing:
        path = recording.path
        there = column_names(path) if path is not None and path.is_file() else [*recording.inputs, *recording.outputs]
        close = closest_name(missing[0], there)
        meant = f"; did you mean {close}?" if close else ""
        lacks = (
            f"{path or recording.name}: the input {missing[0]} of model {model.name} has no column (there are "
            f"{', '.join(there)}{meant})"
        )
        raise InputError(
            f"{lacks}; name it among the inputs that are read, or add it with its values",
            f"{lacks}; name it in [data] inputs and [data.columns.{missing[0]}], or give it a value: [data] constants "
            f"= {{{missing[0]} = ...}}",
        )


def _check_temperatures(recording: Recording, model: Model) -> None:
    warm = max((s.start or 0.0 for s in model.states if s.unit == "K"), default=0.0)
    for v in (*model.inputs, *model.outputs):
        values = {**recording.inputs, **recording.outputs}.get(v.name)
        if v.unit != "K" or values is None or not np.isfinite(values).any():
            continue
        start, first = (state_of(model, v.name) or v).start or warm, float(values[np.isfinite(values)][0])
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        if start > MIN_KELVIN_START and first < MAX_CELSIUS_READING:
            what = (
                f"{recording.path or recording.name}, column {v.name}: reads {low:.4g} to {high:.4g}, where the model "
                f"starts at {start:.4g} K: looks like degC or degF; say so, as by"
            )
            raise InputError(f'{what} units={{"{v.name}": "degC"}}', f'{what} [data.columns.{v.name}] unit = "degC"')


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
        values = np.concatenate([readings_of(e)[:, column] for e in experiments])
        found.append(
            _parameter(
                f"noise.{output}.sd_white", model.units[output], READING_SHARE * (_range(values) or 1.0),
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
            sd[state.name] = MAX_SPREAD_SHARE * (_range(readings_of(experiment)[:, column]) or 1.0)
    for name, value in given.items():
        state_name = model.states[model.state_index(name)].name
        mean.pop(state_name, None)
        sd[state_name] = value
    return mean, sd


def _parameter(
    name: str, unit: str, median: float, about: str, target: DiffusionTarget | ReadingNoiseTarget, floor: float = 0.0
) -> Parameter:
    """Return a positive number of which little more than the order of magnitude is known."""
    low, high = max(median * math.exp(-LIMIT), floor), median * math.exp(LIMIT)
    return Parameter(name, unit, max(median, 1.01 * floor), low, high, LogNormal(median, SIGMA), "log", about, target)

"""Initial values of the states in each recording: fixed at a reading, or estimated beside the parameters."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording, output_noise_floor
from aero_bayes.data.runs import noise_size
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.priors import Normal
from aero_bayes.simulation import Model, Variable, open_simulator
from aero_bayes.simulation.interface import Experiment, Outcome, Problem, StartTarget

#: ``reading``: states that are outputs start at their first reading; ``estimated``: every state's start is estimated;
#: ``auto``: those that are outputs and may start anywhere are estimated about their reading.
StartPolicy = Literal["auto", "reading", "estimated"]

#: Prior standard deviation of an initial value about its reading: this many of the largest plausible standard
#: deviations of the noise, limited to shares of the output's range.
NOISE_DEVIATIONS, MIN_SPREAD_SHARE, MAX_SPREAD_SHARE = 5.0, 0.002, 0.1
#: Readings at the beginning whose noise counts, too.
FIRST_READINGS = 20
#: Bounds of an initial value about its expectation, in prior standard deviations.
MAX_DEVIATION = 8.0


def start_parameters(
    recording: Recording,
    experiment: Experiment,
    model: Model,
    policy: StartPolicy,
    may_start_at_rest: tuple[str, ...] | None,
    index: int,
    suffix: str,
    given: Collection[str] = (),
) -> tuple[dict[str, float], list[Parameter]]:
    """Choose initial values of states by name, and those that are estimated."""
    assert experiment.measured is not None
    policy = "estimated" if recording.resumes else policy
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
        start[state.name] = reading
        seen.add(state.name)
        if policy == "estimated" or (policy == "auto" and free):
            spread = _reading_spread(recording, name, values)
            found.append(_start(_named(name, model) + suffix, name, state, reading, spread, index))
    if policy == "estimated":
        rest = [state for state in model.states if state.name not in seen and state.name not in given]
        spreads = state_sizes(model, experiment, rest)
        found += [
            _start(_named(s.name, model) + suffix, s.name, s, s.start or 0.0, spreads[s.name], index) for s in rest
        ]
    return start, found


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
    """Compute the range of readings, gaps left out."""
    return float(np.nanmax(values) - np.nanmin(values))


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
    watched = replace(experiment, outputs=names, measured=None)
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

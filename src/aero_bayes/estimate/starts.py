"""Where the states of a model start in each recording: held at a reading, or estimated beside the parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from aero_bayes.data import Recording, noise_of
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.priors import Normal
from aero_bayes.simulation import open_simulator
from aero_bayes.simulation.interface import Experiment, Outcome, Problem, StartTarget
from aero_bayes.simulation.model import Model, Variable

FloatArray = NDArray[np.float64]

#: ``reading``: states that are outputs start at their first reading; ``estimated``: every state's start is estimated;
#: ``auto``: those that are outputs and may start anywhere are estimated about their reading.
StartPolicy = Literal["auto", "reading", "estimated"]

#: Spread of a start about its reading, in standard deviations that the noise has at most, and its least and most as
#: shares of its range: a reading tells where its state is.
FLOORS, LEAST, MOST = 5.0, 0.002, 0.1
#: How far a start may lie from where it is expected, in spreads.
REACH = 8.0


def start_parameters(
    recording: Recording,
    experiment: Experiment,
    model: Model,
    policy: StartPolicy,
    resting: tuple[str, ...] | None,
    index: int,
    suffix: str,
) -> tuple[dict[str, float], list[Parameter]]:
    """Initial values of states by name, and those that are estimated.

    Parameters
    ----------
    recording : Recording
    experiment : Experiment
        Of the recording, with ``measured``.
    model : Model
    policy : {"auto", "reading", "estimated"}
    resting : tuple of str, optional
        Outputs whose state may start anywhere; all by default.
    index : int
        Of the recording.
    suffix : str
        What the names of its parameters end in.
    """
    assert experiment.measured is not None
    start: dict[str, float] = {}
    found: list[Parameter] = []
    seen: set[str] = set()
    in_motion = any(signal.values[0] != 0.0 and signal.time[0] >= recording.time[0] for signal in experiment.inputs)
    for column, name in enumerate(experiment.outputs):
        state = state_of(model, name)
        values = experiment.measured[:, column]
        reading = _first_reading(values, recording)
        free = resting is None or name in resting
        if state is None or reading is None or not (free or in_motion or policy == "estimated"):
            continue
        start[state.name] = reading
        seen.add(state.name)
        if policy == "estimated" or (policy == "auto" and free):
            moved = _range(values)
            spread = max(min(max(FLOORS * noise_of(recording, name).at_most, LEAST * moved), MOST * moved), 1e-9)
            found.append(_start(_named(name, model) + suffix, name, state, reading, spread, index))
    if policy == "estimated":
        rest = [state for state in model.states if state.name not in seen]
        spreads = _spreads(model, experiment, rest)
        found += [
            _start(_named(s.name, model) + suffix, s.name, s, s.start or 0.0, spreads[s.name], index) for s in rest
        ]
    return start, found


def loosened(parameters: ParameterSet, experiments: Sequence[Experiment], model: Model) -> ParameterSet:
    """Starts that a reading tells closely, let go by a tenth of what the output moves: its sensor may be off.

    A first fit is led by its readings; what is held against it may say that they are wrong.
    """
    return ParameterSet(
        tuple(p if p.recording is None else _let_go(p, experiments[p.recording], model) for p in parameters)
    )


def _let_go(p: Parameter, experiment: Experiment, model: Model) -> Parameter:
    """The start of a state that is an output, let go; any other parameter as it is."""
    if not isinstance(p.target, StartTarget) or not isinstance(p.prior, Normal) or experiment.measured is None:
        return p
    for column, name in enumerate(experiment.outputs):
        state = state_of(model, name)
        if state is not None and state.name == p.target.state:
            spread = max(p.prior.sd, MOST * _range(experiment.measured[:, column]))
            low, high, prior = _about(state, p.prior.mean, spread)
            return replace(p, lower=low, upper=high, prior=prior)
    return p


def _range(values: FloatArray) -> float:
    """How far readings move, gaps left out."""
    return float(np.nanmax(values) - np.nanmin(values))


def state_of(model: Model, output: str) -> Variable | None:
    """The state that an output is an alias of, if it is one."""
    own = next((s for s in model.states if s.name == output), None)
    if own is not None:
        return own
    index = model.copied_state(output)
    return None if index is None else model.states[index]


def _named(state: str, model: Model) -> str:
    """What the initial value of a state is called: not as a parameter of the model (``y_start`` of a block)."""
    taken = any(p.name == f"{state}_start" for p in model.parameters)
    return f"{state}_initial" if taken else f"{state}_start"


def _start(name: str, of: str, state: Variable, expected: float, spread: float, index: int) -> Parameter:
    low, high, prior = _about(state, expected, spread)
    return Parameter(
        name, state.unit, expected, low, high, prior, "linear", f"initial value of {of}", StartTarget(state.name), index
    )


def _about(state: Variable, expected: float, spread: float) -> tuple[float, float, Normal]:
    """Bounds and prior of a state's start."""
    low, high = expected - REACH * spread, expected + REACH * spread
    if state.minimum is not None and state.minimum < expected:
        low = max(low, state.minimum)
    if state.maximum is not None and state.maximum > expected:
        high = min(high, state.maximum)
    return low, high, Normal(expected, spread, low, high)


def _spreads(model: Model, experiment: Experiment, states: list[Variable]) -> Mapping[str, float]:
    """How far each state may start from the model's own value: as far as it moves in a simulation."""
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


def _first_reading(values: FloatArray, recording: Recording) -> float | None:
    """The reading at the first samples; None if they are gaps (within a hundredth of the recording)."""
    seen = np.flatnonzero(np.isfinite(values))
    if seen.size == 0 or recording.time[seen[0]] - recording.time[0] > 0.01 * recording.duration:
        return None
    return float(values[seen[0]])

"""Parameters that are the initial value of a state, as in ``T(start = T0)``, found by running the FMU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.simulation.interface import Experiment, InputSignal, Outcome, ParameterTarget, Problem, SolverSettings
from aero_bayes.simulation.model_description import ModelDescription
from aero_bayes.simulation.native_simulator import NativeSimulator

#: By how much a parameter is moved, as a share of its size, and how exactly a state's start has to follow it.
STEP_SHARE, FOLLOWS_WITHIN = 1e-3, 1e-9
#: Seconds over which a parameter may have another effect than on the start, in time constants that nobody knows: three
#: horizons, of which the longest that the model runs counts.
HORIZONS = (1e-2, 1.0, 1e3)
#: A fact about a file and names in it, looked up once; by the FMU's checksum and the names.
_known: dict[tuple[str, tuple[str, ...]], Mapping[str, tuple[str, ...]]] = {}
_lock = Lock()


def start_parameters(model: ModelDescription, names: Sequence[str]) -> Mapping[str, tuple[str, ...]]:
    """Parameters that set the initial value of states one to one and do nothing else, with the names of these states.

    Of the ``names`` that have the unit of a state. Runs the FMU in a worker process, once for each file."""
    units = {_kind_of_unit(state.unit) for state in model.states}
    asked = tuple(p.name for p in model.parameters if p.name in names and _kind_of_unit(p.unit) in units)
    if not asked:
        return {}
    with _lock:
        if (model.sha256, asked) not in _known:
            _known[model.sha256, asked] = _find(model, asked)
        return _known[model.sha256, asked]


def _kind_of_unit(unit: str) -> str:
    return "K" if unit == "degC" else unit


def _find(model: ModelDescription, names: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    parameters = [p for p in model.parameters if p.name in names and p.start is not None]
    own = np.array([p.start or 0.0 for p in parameters])
    step = STEP_SHARE * np.where(own == 0.0, 1.0, np.abs(own))
    rows = np.vstack([own, own + np.diag(step)])
    moved = _run(model, rows, tuple(p.name for p in parameters), {}, 1e-6)
    if moved is None:
        return {}
    count = len(model.states)
    shift = moved[1:, 0, :count] - moved[0, 0, :count]
    follows = np.abs(shift - step[:, None]) <= FOLLOWS_WITHIN * np.maximum(np.abs(moved[0, 0, :count]), step[:, None])
    found = {k: np.flatnonzero(row) for k, row in enumerate(follows) if row.any()}
    return {
        parameters[k].name: tuple(model.states[s].name for s in states)
        for k, states in found.items()
        if np.array_equal(np.flatnonzero(shift[k]), states)
        and _only_starts(model, parameters[k].name, rows[[0, k + 1], k], states, moved[0, 0])
    }


def _only_starts(
    model: ModelDescription, name: str, values: FloatArray, states: NDArray[np.intp], at: FloatArray
) -> bool:
    """Return whether a parameter changes nothing once the states that it starts are given.

    ``at`` (n,) are their starts."""
    starts = {model.states[s].name: float(at[s]) for s in states}
    found = [_run(model, values[:, None], (name,), starts, horizon) for horizon in HORIZONS]
    ran = [y for y in found if y is not None]
    return bool(ran) and all(np.array_equal(y[0], y[1]) for y in ran)


def _run(
    model: ModelDescription, rows: FloatArray, names: tuple[str, ...], start: Mapping[str, float], horizon: float
) -> FloatArray | None:
    """Return all states, then outputs, of parameter rows (n, p) at three times: shape (n, 3, m).

    None where a run fails."""
    watched = tuple(dict.fromkeys([*(s.name for s in model.states), *(v.name for v in model.outputs)]))
    time = np.linspace(0.0, horizon, 3)
    inputs = tuple(InputSignal(u.name, time[:1], np.array([u.start or 0.0])) for u in model.inputs)
    experiment = Experiment(time, watched, inputs, start)
    targets = (tuple(ParameterTarget(name) for name in names),)
    plain = replace(model, candidate_copies=())
    problem = Problem(plain, (experiment,), targets, settings=SolverSettings(1e-4, 1e-4, 10_000, 1.0))
    with NativeSimulator(problem, workers=1) as simulator:
        found = simulator.simulate(rows)
    return None if np.any(found.outcomes != Outcome.OK) else found.outputs[0]

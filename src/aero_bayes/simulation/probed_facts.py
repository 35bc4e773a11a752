"""What only running an FMU can tell: which outputs copy a state, and which parameters are the start of one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from threading import Lock
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.simulation.interface import (
    Experiment,
    InputSignal,
    Outcome,
    ParameterTarget,
    Problem,
    ProblemTarget,
    SolverSettings,
    StartTarget,
    Trajectories,
)
from aero_bayes.simulation.model_description import ModelDescription
from aero_bayes.simulation.native_simulator import NativeSimulator

T = TypeVar("T")
#: By how much a parameter is moved, as a share of its size, and how exactly a state's start has to follow it.
STEP_SHARE, FOLLOWS_WITHIN = 1e-3, 1e-9
#: Seconds over which a parameter may have another effect than on the start, in time constants that nobody knows: three
#: horizons, of which the longest that the model runs counts.
HORIZONS = (1e-2, 1.0, 1e3)
_PROBE_POINTS = 6
#: Facts about files, each looked up once; by the FMU's checksum and what was asked.
_known: dict[tuple[str, tuple[str, ...]], object] = {}
_lock = Lock()


def _once(model: ModelDescription, asked: tuple[str, ...], find: Callable[[], Mapping[str, T]]) -> Mapping[str, T]:
    with _lock:
        key = model.sha256, asked
        if key not in _known:
            _known[key] = find()
        return _known[key]  # type: ignore[return-value]


def _run(
    model: ModelDescription, experiments: tuple[Experiment, ...], targets: tuple[ProblemTarget, ...], rows: FloatArray
) -> Trajectories:
    """Run parameter rows (n, p) in a worker process; every output is asked of the FMU."""
    plain, settings = replace(model, candidate_copies=()), SolverSettings(1e-4, 1e-4, 10_000, 1.0)
    problem = Problem(plain, experiments, (targets,) * len(experiments), settings=settings)
    with NativeSimulator(problem, workers=1) as simulator:
        return simulator.simulate(rows)


def _inputs(model: ModelDescription, shift: float = 0.0) -> tuple[InputSignal, ...]:
    moved = {u.name: (u.start or 0.0) + shift * (u.kind == "real") for u in model.inputs}
    return tuple(InputSignal(name, np.zeros(1), np.array([value])) for name, value in moved.items())


def verified_copies(model: ModelDescription) -> Mapping[str, int]:
    """Return the candidates that equalled a state in every run, and the position of that state.

    Runs the FMU in a worker process, once for each file."""
    return _once(model, (), lambda: _verify(model)) if model.candidate_copies else {}


def _verify(model: ModelDescription) -> dict[str, int]:
    candidates = dict(model.candidate_copies)
    parameters = [p for p in model.parameters if p.start is not None]
    starts, others = [StartTarget(s.name) for s in model.states], [ParameterTarget(p.name) for p in parameters]
    names = (*candidates, *(model.states[state].name for state in candidates.values()))
    time = np.array([0.0, 1e-6, 2e-6])
    experiments = tuple(Experiment(time, names, _inputs(model, shift)) for shift in (0.0, 1e-3))
    found = _run(model, experiments, (*starts, *others), _points(model, [p.start or 0.0 for p in parameters]))
    verified = {}
    for place, (name, state) in enumerate(candidates.items()):
        ran, same = False, True
        for outputs, outcome in zip(found.outputs, found.outcomes.T, strict=True):
            good = outcome == Outcome.OK
            a, b = outputs[good, :, place], outputs[good, :, len(candidates) + place]
            ran |= bool(good[1:].any())
            same &= bool(np.allclose(a, b, rtol=1e-9, atol=1e-12))
        if ran and same:
            verified[name] = state
    return verified


def _points(model: ModelDescription, parameters: list[float]) -> FloatArray:
    """Return the model's own values, then others nearby: states and parameters, all moved at once."""
    rng = np.random.default_rng(0)
    own = np.array([*((s.start or 0.0) for s in model.states), *parameters])
    size = np.array([*((s.nominal or abs(s.start or 0.0) or 1.0) for s in model.states), *np.abs(parameters)])
    moved = own + 1e-3 * size * rng.uniform(0.5, 1.0, (_PROBE_POINTS, own.size)) * rng.choice(
        [-1.0, 1.0], (_PROBE_POINTS, own.size)
    )
    moved[: _PROBE_POINTS // 2, len(model.states) :] = parameters  # where the model does not run with other parameters
    return np.vstack([own, moved])


def start_parameters(model: ModelDescription, names: Sequence[str]) -> Mapping[str, tuple[str, ...]]:
    """Parameters that set the initial value of states one to one and do nothing else, with the names of these states.

    Of the ``names`` that have the unit of a state. Runs the FMU in a worker process, once for each file."""
    units = {_kind_of_unit(state.unit) for state in model.states}
    asked = tuple(p.name for p in model.parameters if p.name in names and _kind_of_unit(p.unit) in units)
    return _once(model, asked, lambda: _find(model, asked)) if asked else {}


def _kind_of_unit(unit: str) -> str:
    return "K" if unit == "degC" else unit


def _find(model: ModelDescription, names: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    parameters = [p for p in model.parameters if p.name in names and p.start is not None]
    own = np.array([p.start or 0.0 for p in parameters])
    step = STEP_SHARE * np.where(own == 0.0, 1.0, np.abs(own))
    rows = np.vstack([own, own + np.diag(step)])
    moved = _horizon(model, rows, tuple(p.name for p in parameters), {}, 1e-6)
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
    found = [_horizon(model, values[:, None], (name,), starts, horizon) for horizon in HORIZONS]
    ran = [y for y in found if y is not None]
    return bool(ran) and all(np.array_equal(y[0], y[1]) for y in ran)


def _horizon(
    model: ModelDescription, rows: FloatArray, names: tuple[str, ...], start: Mapping[str, float], horizon: float
) -> FloatArray | None:
    """Return all states, then outputs, of parameter rows (n, p) at three times: shape (n, 3, m).

    None where a run fails."""
    watched = tuple(dict.fromkeys([*(s.name for s in model.states), *(v.name for v in model.outputs)]))
    experiment = Experiment(np.linspace(0.0, horizon, 3), watched, _inputs(model), start)
    found = _run(model, (experiment,), tuple(ParameterTarget(name) for name in names), rows)
    return None if np.any(found.outcomes != Outcome.OK) else found.outputs[0]

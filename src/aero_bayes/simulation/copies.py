"""Outputs that copy a state under a value reference of their own, as OpenModelica writes them.

What an FMU says of this is a guess (its model structure tells on what an output depends, not how), so the guess is held
against runs from several starts, with the parameters and inputs moved.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from threading import Lock

import numpy as np

from aero_bayes.simulation.description2 import OUTPUT_ALIAS
from aero_bayes.simulation.interface import (
    Experiment,
    FloatArray,
    InputSignal,
    Outcome,
    ParameterTarget,
    Problem,
    ProblemTarget,
    SolverSettings,
    StartTarget,
)
from aero_bayes.simulation.model import Model

_PROBE_POINTS = 6
_found: dict[str, Mapping[str, int]] = {}  # by the FMU's checksum: a fact about a file, looked up once
_lock = Lock()


def true_copies(model: Model) -> Mapping[str, int]:
    """The outputs that were seen to copy a state, and that state's position."""
    with _lock:
        if model.sha256 not in _found:
            _found[model.sha256] = _look(model) if model.said_copies else {}
        return _found[model.sha256]


def named_copies(model: Model) -> Mapping[str, int]:
    """Those of :func:`true_copies` after which the state is named: copies always and everywhere, not only nearby."""
    named = {m["output"] for state in model.states if (m := OUTPUT_ALIAS.fullmatch(state.name))}
    if named.isdisjoint(dict(model.said_copies)):
        return {}
    return {output: state for output, state in true_copies(model).items() if output in named}


def _look(model: Model) -> dict[str, int]:
    from aero_bayes.simulation.native import NativeSimulator

    said = dict(model.said_copies)
    parameters = [p for p in model.parameters if p.start is not None]
    targets: tuple[ProblemTarget, ...] = (
        *(StartTarget(state.name) for state in model.states),
        *(ParameterTarget(parameter.name) for parameter in parameters),
    )
    names = (*said, *(model.states[state].name for state in said.values()))
    time = np.array([0.0, 1e-6, 2e-6])
    experiments = tuple(
        Experiment(
            time,
            names,
            tuple(InputSignal(u.name, time[:1], np.array([(u.start or 0.0) + shift])) for u in model.inputs),
        )
        for shift in (0.0, 1e-3)
    )
    plain = replace(model, said_copies=())  # every output is asked of the FMU
    problem = Problem(plain, experiments, (targets,) * 2, settings=SolverSettings(1e-4, 1e-4, 1000, 1.0))
    with NativeSimulator(problem, workers=1) as simulator:
        found = simulator.simulate(_points(model, [p.start or 0.0 for p in parameters]))
    true = {}
    for place, (name, state) in enumerate(said.items()):
        ran, same = False, True
        for outputs, outcome in zip(found.outputs, found.outcomes.T, strict=True):
            good = outcome == Outcome.OK
            a, b = outputs[good, :, place], outputs[good, :, len(said) + place]
            ran |= bool(good[1:].any())
            same &= bool(np.allclose(a, b, rtol=1e-9, atol=1e-12))
        if ran and same:
            true[name] = state
    return true


def _points(model: Model, parameters: list[float]) -> FloatArray:
    """The model's own values, then others nearby: states and parameters, all moved at once."""
    rng = np.random.default_rng(0)
    own = np.array([*((s.start or 0.0) for s in model.states), *parameters])
    size = np.array([*((s.nominal or abs(s.start or 0.0) or 1.0) for s in model.states), *np.abs(parameters)])
    moved = own + 1e-3 * size * rng.uniform(0.5, 1.0, (_PROBE_POINTS, own.size)) * rng.choice(
        [-1.0, 1.0], (_PROBE_POINTS, own.size)
    )
    moved[: _PROBE_POINTS // 2, len(model.states) :] = parameters  # where the model does not run with other parameters
    return np.vstack([own, moved])

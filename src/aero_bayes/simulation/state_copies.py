"""Outputs that copy a state under a value reference of their own, as OpenModelica writes them.

The model structure of an FMU tells on which state an output depends, not how. So a candidate is verified: it must equal
its state in runs from several starts, with other parameters and inputs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from threading import Lock

import numpy as np

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
)
from aero_bayes.simulation.model_description import ModelDescription
from aero_bayes.simulation.native_simulator import NativeSimulator

_PROBE_POINTS = 6
_known: dict[str, Mapping[str, int]] = {}  # by the FMU's checksum: a fact about a file, looked up once
_lock = Lock()


def verified_copies(model: ModelDescription) -> Mapping[str, int]:
    """Return the candidates that equalled a state in every run, and the position of that state.

    Runs the FMU in a worker process, once for each file."""
    with _lock:
        if model.sha256 not in _known:
            _known[model.sha256] = _verify(model) if model.candidate_copies else {}
        return _known[model.sha256]


def _verify(model: ModelDescription) -> dict[str, int]:
    candidates = dict(model.candidate_copies)
    parameters = [p for p in model.parameters if p.start is not None]
    targets: tuple[ProblemTarget, ...] = (
        *(StartTarget(state.name) for state in model.states),
        *(ParameterTarget(parameter.name) for parameter in parameters),
    )
    names = (*candidates, *(model.states[state].name for state in candidates.values()))
    time = np.array([0.0, 1e-6, 2e-6])
    experiments = tuple(
        Experiment(
            time,
            names,
            tuple(InputSignal(u.name, time[:1], np.array([(u.start or 0.0) + shift])) for u in model.inputs),
        )
        for shift in (0.0, 1e-3)
    )
    plain = replace(model, candidate_copies=())  # every output is asked of the FMU
    problem = Problem(plain, experiments, (targets,) * 2, settings=SolverSettings(1e-4, 1e-4, 1000, 1.0))
    with NativeSimulator(problem, workers=1) as simulator:
        found = simulator.simulate(_points(model, [p.start or 0.0 for p in parameters]))
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

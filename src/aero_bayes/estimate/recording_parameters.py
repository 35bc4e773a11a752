"""Parameters that have a value of their own in each recording: those that are said to, and initial values of states."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from aero_bayes.data.recording import Recording
from aero_bayes.estimate.initial_states import first_reading_of, state_of
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.simulation.interface import ParameterTarget
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.start_parameters import start_parameters


def with_started_states(parameters: ParameterSet, model: Model) -> ParameterSet:
    """Return the parameters, with those that are nothing but the initial value of states marked as such."""
    names = [p.target.name for p in parameters if isinstance(p.target, ParameterTarget) and p.recording is None]
    found = start_parameters(model, names)
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

"""A problem as one flat file of 8-byte words, which workers map into memory (read by native/problem_file.c)."""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.simulation.interface import (
    DelayTarget,
    DiffusionTarget,
    Experiment,
    InputTarget,
    ParameterTarget,
    Problem,
    ProblemTarget,
    ReadingNoiseTarget,
    StartTarget,
)
from aero_bayes.simulation.model_description import ModelDescription
from aero_bayes.simulation.problem_checks import signal_index, target_scale

_MAGIC = 0x4142535045430007
_KINDS = {"real": 0, "integer": 1, "boolean": 2}


class _Writer:
    def __init__(self) -> None:
        self.parts: list[bytes] = []

    def integer(self, *values: int) -> None:
        self.parts.append(struct.pack(f"<{len(values)}q", *values))

    def real(self, *values: float) -> None:
        self.parts.append(struct.pack(f"<{len(values)}d", *values))

    def text(self, value: str) -> None:
        data = value.encode() + b"\0"
        data += b"\0" * (-len(data) % 8)
        self.integer(len(data))
        self.parts.append(data)

    def integers(self, values: ArrayLike) -> None:
        self._array(np.asarray(values, dtype="<i8").ravel())

    def reals(self, values: ArrayLike) -> None:
        self._array(np.asarray(values, dtype="<f8").ravel())

    def _array(self, values: NDArray[np.int64] | FloatArray) -> None:
        self.integer(values.size)
        self.parts.append(values.tobytes())


def color_columns(pattern: tuple[tuple[int, ...], ...]) -> list[int]:
    """Greedy colouring: columns of one colour share no row (Curtis, Powell and Reid, 1974)."""
    taken: list[set[int]] = []
    colors: list[int] = []
    for rows in pattern:
        color = next((i for i, used in enumerate(taken) if used.isdisjoint(rows)), len(taken))
        if color == len(taken):
            taken.append(set())
        taken[color].update(rows)
        colors.append(color)
    return colors


def _target(
    model: ModelDescription, experiment: Experiment, target: ProblemTarget | None
) -> tuple[int, int, int, float]:
    scale = target_scale(model, experiment, target)
    if isinstance(target, ParameterTarget):
        return 1, model.parameter(target.name).value_reference, 0, scale
    if isinstance(target, StartTarget):
        return 2, model.state_index(target.state), 0, scale
    if isinstance(target, DelayTarget):
        return 3, -1 if target.input is None else signal_index(experiment, target.input), 0, scale
    if isinstance(target, InputTarget):
        return 4, signal_index(experiment, target.input), target.index, scale
    if isinstance(target, DiffusionTarget):
        return 5, model.state_index(target.state), 0, scale
    if isinstance(target, ReadingNoiseTarget):
        return 6, experiment.outputs.index(target.output), 0, scale
    return 0, 0, 0, scale


def _write_experiment(
    w: _Writer, model: ModelDescription, experiment: Experiment, row: tuple[ProblemTarget | None, ...]
) -> None:
    variables = [model.output(name) for name in experiment.outputs]
    references = {state.value_reference: i for i, state in reversed(list(enumerate(model.states)))}
    copies = model.copies_by_name()
    w.reals(experiment.time)
    w.integers([v.value_reference for v in variables])
    w.integers([_KINDS[v.kind] for v in variables])
    w.integers(
        [references.get(v.value_reference, copies.get(v.name, -1)) if v.kind == "real" else -1 for v in variables]
    )
    w.integer(len(experiment.inputs))
    for signal in experiment.inputs:
        w.integer(model.input(signal.name).value_reference, int(signal.interpolation == "linear"))
        w.reals(signal.time)
        w.reals(signal.values)
    w.integers([model.state_index(name) for name in experiment.start])
    w.reals(list(experiment.start.values()))
    w.integers([model.parameter(name).value_reference for name in experiment.known])
    w.reals(list(experiment.known.values()))
    w.reals(experiment.measured.T if experiment.measured is not None else [])
    w.reals(experiment.spread.T if experiment.spread is not None else [])
    w.integer(experiment.most_steps)
    for target in row:
        kind, a, b, scale = _target(model, experiment, target)
        w.integer(kind, a, b)
        w.real(scale)


def _by_state(model: ModelDescription, values: Mapping[str, float]) -> FloatArray:
    row = np.zeros(len(model.states))
    for name, value in values.items():
        row[model.state_index(name)] = value
    return row


def _write_process(w: _Writer, problem: Problem) -> None:
    process = problem.process
    w.integer(int(process is not None))
    if process is None:
        return
    w.reals(_by_state(problem.model, process.diffusion))
    for experiment in problem.experiments:
        w.reals(_by_state(problem.model, experiment.start_sd))
        w.reals([process.reading_sd.get(name, 0.0) for name in experiment.outputs])


def write_problem(problem: Problem, binary: Path, path: Path) -> None:
    """Write `problem`, whose FMU is unpacked around `binary`, to `path` (by way of a temporary name)."""
    model = problem.model
    n = len(model.states)
    everything = tuple(tuple(range(n)) for _ in range(n))
    pattern = model.jacobian_pattern if model.jacobian_pattern is not None else everything
    colors = color_columns(pattern)
    w = _Writer()
    w.integer(_MAGIC)
    w.text(str(binary))
    resources = binary.parents[2] / "resources"
    w.text(f"{resources}/" if model.fmi_version == 3 else resources.as_uri())
    w.text(model.guid)
    w.text(model.identifier)
    w.integer(model.fmi_version)
    w.integer(int(model.has_directional_derivatives), int(model.wants_step_callback))
    w.integer(int(model.needs_instance_per_process), model.event_indicators)
    w.integers([v.value_reference for v in model.states])
    w.integers(model.derivatives)
    w.integers([int(v.settable_start) for v in model.states])
    w.integer(max(colors, default=-1) + 1)
    w.integers(colors)
    w.integers(np.cumsum([0, *(len(rows) for rows in pattern)]))
    w.integers([row for rows in pattern for row in rows])
    w.integers([model.parameter(name).value_reference for name in problem.fixed])
    w.reals(list(problem.fixed.values()))
    settings = problem.settings
    w.real(settings.relative_tolerance, settings.absolute_tolerance)
    w.integer(settings.max_steps)
    w.real(settings.time_limit)
    w.integer(len(problem.targets[0]), len(problem.experiments))
    for experiment, row in zip(problem.experiments, problem.targets, strict=True):
        _write_experiment(w, model, experiment, row)
    _write_process(w, problem)
    partial = path.with_suffix(".part")
    with partial.open("wb") as stream:
        stream.writelines(w.parts)
    os.replace(partial, path)

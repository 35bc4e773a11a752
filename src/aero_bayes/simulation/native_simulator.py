"""The fast simulator: a compiled engine drives the FMU's own binary in worker processes."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.simulation.batches import FILTER, FILTER_LIKELIHOOD, FILTER_STATES, LIKELIHOOD, Batches
from aero_bayes.simulation.interface import (
    ClosedAtExit,
    Experiment,
    Filtered,
    FilteredStates,
    Likelihoods,
    Outcome,
    Problem,
    ProblemTarget,
    Trajectories,
)
from aero_bayes.simulation.model_description import MEMORIES, DescribedOperator, ModelDescription
from aero_bayes.simulation.problem_checks import (
    check_active,
    check_noise,
    check_problem,
    check_values,
    target_code,
    target_scale,
)
from aero_bayes.simulation.workers import WorkerPool

_MAGIC = 0x414253504543000C
_KINDS = {"real": 0, "integer": 1, "boolean": 2, "enumeration": 3}


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


def _write_experiment(
    w: _Writer,
    model: ModelDescription,
    experiment: Experiment,
    row: tuple[ProblemTarget | None, ...],
    operators: Mapping[int, DescribedOperator],
) -> None:
    acting = {o.signal: k for k, o in enumerate(operators.values()) if o.raw is not None}
    raw = {o.signal: o.raw for o in operators.values()}
    variables = [model.output(name) for name in experiment.outputs]
    references = {state.value_reference: i for i, state in reversed(list(enumerate(model.states)))}
    copies = model.copies_by_name()
    w.reals(experiment.time)
    read = [v.value_reference if (own := raw.get(v.name)) is None else own for v in variables]
    w.integers(read)
    w.integers([_KINDS[v.kind] for v in variables])
    w.integers(
        [
            references.get(at, copies.get(v.name, -1)) if v.kind == "real" else -1
            for v, at in zip(variables, read, strict=True)
        ]
    )
    w.integers([acting.get(v.name, -1) for v in variables])
    w.integer(len(experiment.inputs))
    for signal in experiment.inputs:
        variable = model.input(signal.name)
        w.integer(variable.value_reference, int(signal.interpolation == "linear"), _KINDS[variable.kind])
        w.integer(next((k for k, o in enumerate(operators.values()) if o.signal == signal.name and o.raw is None), -1))
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
        w.integer(*target_code(model, experiment, target))
        w.real(target_scale(model, target))


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


def operators_in_use(problem: Problem) -> dict[int, DescribedOperator]:
    """Return operators that act on signals, by their numbers: on inputs if all of these are recorded, then on outputs.

    Process noise leaves them in the equations: its readings come between."""
    if problem.process is not None:
        return {}
    recorded = set[str].intersection(*({s.name for s in e.inputs} for e in problem.experiments))
    before = {k: o for k, o in enumerate(problem.model.operators) if o.raw is None}
    behind = {k: o for k, o in enumerate(problem.model.operators) if o.raw is not None}
    return (before if all(o.signal in recorded for o in before.values()) else {}) | behind


def _without_memories(model: ModelDescription, operators: Iterable[DescribedOperator]) -> ModelDescription:
    """Return a model without the states of laws that act on the signals themselves."""
    left = {k for o in operators for k in o.states}
    if not left:
        return model
    kept = [k for k in range(len(model.states)) if k not in left]
    pattern = model.jacobian_pattern
    return replace(
        model,
        states=tuple(model.states[k] for k in kept),
        derivatives=tuple(model.derivatives[k] for k in kept),
        candidate_copies=tuple((name, kept.index(k)) for name, k in model.candidate_copies if k in kept),
        jacobian_pattern=pattern and tuple(tuple(kept.index(i) for i in pattern[k] if i not in left) for k in kept),
    )


def write_problem(problem: Problem, binary: Path, path: Path) -> None:
    """Write `problem`, whose FMU is unpacked around `binary`, to `path` (by way of a temporary name)."""
    operators = operators_in_use(problem)
    model = _without_memories(problem.model, operators.values())
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
    w.integer(len(operators), sum(o.raw is None for o in operators.values()))
    for k, o in operators.items():
        w.integer(k, MEMORIES.index(o.memory))
        w.integers([model.parameter(name).value_reference for name in o.parameters])
    relay = model.relay if problem.process is None else None
    w.integers([state for state, _ in relay.speed] if relay else [])
    w.reals([gain for _, gain in relay.speed] if relay else [])
    w.integer(*((relay.held, relay.direction) if relay else (0, 0)))
    w.integer(len(problem.targets[0]), len(problem.experiments))
    for experiment, row in zip(problem.experiments, problem.targets, strict=True):
        _write_experiment(w, model, experiment, row, operators)
    _write_process(w, problem)
    partial = path.with_suffix(".part")
    with partial.open("wb") as stream:
        stream.writelines(w.parts)
    os.replace(partial, path)


class NativeSimulator(ClosedAtExit):
    """Runs a problem with the compiled engine."""

    def __init__(self, problem: Problem, workers: int | None = None, pool: WorkerPool | None = None) -> None:
        if problem.model.interface != "model exchange":
            raise InputError(f"{problem.model.path}: has no Model Exchange, which the native engine needs")
        check_problem(problem)
        self.problem = problem
        self._owns_pool = pool is None
        self.pool = WorkerPool(workers) if pool is None else pool
        self._path = self.pool.new_path()
        write_problem(problem, self.pool.binary(problem.model), self._path)
        self._batches = Batches(problem, self.pool, self._path)
        self._closed = False

    def _open_batches(self) -> Batches:
        if self._closed:
            raise InputError("the simulator is closed")
        return self._batches

    def close(self) -> None:
        """Stop the workers (own ones) and free the model."""
        if self._closed:
            return
        self._closed = True
        self.pool.forget(self._path)
        if self._owns_pool:
            self.pool.close()

    def simulate(self, values: FloatArray, *, active: Sequence[int] | None = None) -> Trajectories:
        """Trajectories; with ``active`` also sensitivities to those columns. See :class:`Simulator`."""
        values = check_values(self.problem, values)
        return self._open_batches().trajectories(values, None if active is None else check_active(self.problem, active))

    def log_likelihood(self, values: FloatArray, noise: FloatArray) -> Likelihoods:
        """Gaussian log-likelihood of the measurements, reduced inside the engine. See :class:`Simulator`."""
        values = check_values(self.problem, values)
        n, experiments = len(values), len(self.problem.experiments)
        noise = check_noise(self.problem, noise, n)
        batches = self._open_batches()
        result = np.full((n, experiments), -np.inf)
        outcomes = np.zeros((n, experiments), dtype=np.uint8)
        none = np.zeros(0, dtype=np.int64)
        mode = LIKELIHOOD if self.problem.process is None else FILTER_LIKELIHOOD
        for part, block in batches.blocks(mode, values, none, noise, experiments):
            outcomes[part] = block.outcomes
            result[part] = np.where(block.outcomes == Outcome.OK, block.result[..., 0], -np.inf)
        return Likelihoods(result, outcomes)

    def filter(self, values: FloatArray, *, active: Sequence[int] = ()) -> Filtered:
        """Predictions of the readings by an extended Kalman filter, with their slopes by the ``active`` columns."""
        values, columns = self._check_filter(values), check_active(self.problem, active)
        found = self._open_batches().trajectories(values, columns, FILTER)
        assert found.sensitivities is not None
        halves = [len(e.outputs) for e in self.problem.experiments]
        y, slopes = found.outputs, found.sensitivities
        return Filtered(
            tuple(a[..., :m] for a, m in zip(y, halves, strict=True)),
            tuple(a[..., m:] for a, m in zip(y, halves, strict=True)),
            tuple(a[:, :, :m] for a, m in zip(slopes, halves, strict=True)),
            tuple(a[:, :, m:] for a, m in zip(slopes, halves, strict=True)),
            found.outcomes,
        )

    def filtered_states(self, values: FloatArray) -> tuple[FilteredStates, ...]:
        """Return the states in each recording at one parameter vector (p,); CannotFinishError where a run fails."""
        values = self._check_filter(np.asarray(values)[np.newaxis])
        found = self._open_batches().trajectories(values, None, FILTER_STATES)
        for outcome in found.outcomes[0]:
            if outcome != Outcome.OK:
                raise CannotFinishError(f"the filter of process noise failed: {Outcome(outcome).text}")
        s = len(self.problem.model.states)
        return tuple(
            _filtered_states(rows[0], len(e.outputs), s)
            for rows, e in zip(found.outputs, self.problem.experiments, strict=True)
        )

    def _check_filter(self, values: FloatArray) -> FloatArray:
        if self.problem.process is None:
            raise InputError("the problem has no process noise to filter")
        return check_values(self.problem, values)


def _filtered_states(rows: FloatArray, m: int, s: int) -> FilteredStates:
    """Return the numbers (n, ...) that the engine gives for each sample, by what they are."""
    n = len(rows)
    predicted, variance, mean, covariance, transition, slopes = np.split(
        rows, list(accumulate((m, m, s, s * s, s * s))), axis=1
    )
    return FilteredStates(
        mean, covariance.reshape(n, s, s), transition.reshape(n, s, s), slopes.reshape(n, m, s), predicted, variance
    )

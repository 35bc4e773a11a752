"""Before and after: error on what was fitted and on what was not, and what the missing effect had done to the rest."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.data import Recording, noise_floor, to_experiment
from aero_bayes.discrepancy.baseline import nuisance_parameters, prepare
from aero_bayes.discrepancy.refit import Refit
from aero_bayes.discrepancy.residual import autocorrelation
from aero_bayes.discrepancy.study import problem_of
from aero_bayes.errors import CannotFinishError
from aero_bayes.inference.parameters import Parameter, ParameterSet
from aero_bayes.simulation import Model, WorkerPool, open_simulator
from aero_bayes.simulation.interface import DelayTarget, InputSignal, SolverSettings, StartTarget

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Error:
    """Root mean square of a residual, its standard deviation with correlation counted, and the readings."""

    rms: float
    sd: float
    readings: int


@dataclass(frozen=True, eq=False)
class Prediction:
    """A model's prediction of whole recordings.

    ``train`` and ``test`` hold an :class:`Error` by recording and output; ``fitted`` the outputs (n,) by recording and
    output, on the recording's own samples.
    """

    train: Mapping[tuple[str, str], Error]
    test: Mapping[tuple[str, str], Error]
    fitted: Mapping[tuple[str, str], FloatArray]

    def pooled(self, role: str) -> dict[str, float]:
        """RMS by output over all recordings of a role."""
        errors = self.train if role == "train" else self.test
        squares: dict[str, list[tuple[float, int]]] = {}
        for (_, output), error in errors.items():
            squares.setdefault(output, []).append((error.rms**2 * error.readings, error.readings))
        return {o: math.sqrt(sum(s for s, _ in items) / sum(n for _, n in items)) for o, items in squares.items()}

    def uncertainty(self, role: str) -> dict[str, float]:
        """Standard deviation of :meth:`pooled`."""
        errors = self.train if role == "train" else self.test
        weights: dict[str, list[tuple[float, int]]] = {}
        for (_, output), error in errors.items():
            weights.setdefault(output, []).append((error.sd, error.readings))
        return {
            o: math.sqrt(sum((sd * n) ** 2 for sd, n in items)) / sum(n for _, n in items)
            for o, items in weights.items()
        }


@dataclass(frozen=True)
class Shift:
    """How far a parameter moved when the missing effect was added, in its own unit and in standard deviations after."""

    name: str
    before: float
    before_sd: float
    after: float
    after_sd: float

    @property
    def in_sd(self) -> float:
        return abs(self.after - self.before) / self.after_sd if self.after_sd > 0.0 else 0.0


def rms_error(residual: FloatArray, interval: float) -> Error:
    """RMS of a residual (n,) with its uncertainty; correlated readings count for less."""
    n = residual.size
    if n == 0:
        return Error(math.nan, math.nan, 0)
    rms = float(np.sqrt(np.mean(residual**2)))
    if n < 10:
        return Error(rms, rms / math.sqrt(2.0 * n), n)
    _, acf = autocorrelation(residual**2, interval, min(n // 3, 2000))
    negative = np.flatnonzero(acf <= 0.0)
    last = int(negative[0]) if negative.size else acf.size
    time = max(1.0, 2.0 * float(acf[:last].sum()) - 1.0)
    spread = float(np.std(residual**2)) * math.sqrt(time / n)
    return Error(rms, 0.5 * spread / max(rms, 1e-300), n)


def predict(
    model: Model,
    parameters: ParameterSet,
    fit: Refit,
    train: Sequence[Recording],
    test: Sequence[Recording],
    outputs: Sequence[str],
    fixed: Mapping[str, float],
    settings: SolverSettings,
    pool: WorkerPool,
    held_from: Mapping[str, float],
    extra: Mapping[int, InputSignal] | None = None,
) -> Prediction:
    """Run a fitted model over whole recordings.

    A recording that was not fitted gets the fitted recordings' mean input delay, and starts at its own first readings,
    off by as much as theirs were. ``held_from`` gives, by training recording, the time (s) from which readings count as
    unseen; ``extra`` an input beside the recorded ones, by the index of a training recording.
    """
    values = dict(zip(parameters.names, parameters.from_search(fit.coordinates), strict=True))
    shared = [p for p in parameters if p.recording is None]
    columns: list[Parameter] = list(shared)
    row = [values[p.name] for p in shared]
    everything = [*train, *test]
    delays = [values[p.name] for p in parameters if isinstance(p.target, DelayTarget)]
    offsets = []
    for p in parameters:
        if isinstance(p.target, StartTarget) and p.recording is not None:
            offsets.append(_first_pitch(train[p.recording]) - values[p.name])
    own = {(p.recording, type(p.target)): values[p.name] for p in parameters if p.recording is not None}
    prepared = prepare(everything, outputs, most=10**9)
    for p in nuisance_parameters(prepared, model):
        assert p.recording is not None
        if (p.recording, type(p.target)) in own and p.recording < len(train):
            value = own[p.recording, type(p.target)]
        elif isinstance(p.target, DelayTarget):
            value = float(np.mean(delays)) if delays else 0.0
        else:
            value = _first_pitch(everything[p.recording]) - (float(np.mean(offsets)) if offsets else 0.0)
        columns.append(replace(p, name=f"{p.name}#{p.recording}"))
        row.append(float(np.clip(value, p.lower, p.upper)))
    experiments = []
    for e, recording in enumerate(everything):
        seen = tuple(output for output in outputs if output in recording.outputs)
        experiment = to_experiment(recording, seen)
        if extra is not None and e in extra:
            experiment = replace(experiment, inputs=(*experiment.inputs, extra[e]))
        experiments.append(experiment)
    everywhere = ParameterSet(tuple(columns))
    problem = problem_of(model, experiments, everywhere, fixed, settings)
    with open_simulator(problem, pool=pool) as simulator:
        found = simulator.simulate(np.array([row]))
    if np.any(found.outcomes[0] != 0):
        raise CannotFinishError("the fitted model cannot be simulated over the whole recordings")
    errors: tuple[dict[tuple[str, str], Error], dict[tuple[str, str], Error]] = ({}, {})
    fitted: dict[tuple[str, str], FloatArray] = {}
    for e, (recording, experiment) in enumerate(zip(everything, experiments, strict=True)):
        for column, output in enumerate(experiment.outputs):
            predicted = found.outputs[e][0, :, column]
            key = (recording.name, output)
            fitted[key] = predicted
            residual = recording.outputs[output] - predicted
            interval = float(np.median(np.diff(recording.time)))
            unseen = recording.time >= held_from.get(recording.name, math.inf) if e < len(train) else None
            seen_readings = np.isfinite(residual)
            if unseen is None:
                errors[1][key] = rms_error(residual[seen_readings], interval)
            else:
                errors[0][key] = rms_error(residual[seen_readings & ~unseen], interval)
                if unseen.any():
                    errors[1][key] = rms_error(residual[seen_readings & unseen], interval)
    return Prediction(errors[0], errors[1], fitted)


def floors_of(recordings: Sequence[Recording], outputs: Sequence[str]) -> dict[tuple[str, str], float]:
    """Noise floor of every output of every recording, from its readings alone."""
    floors = {}
    for recording in recordings:
        jumps = np.concatenate(
            [recording.time[1:][np.diff(values) != 0.0] for values in recording.inputs.values()] or [np.empty(0)]
        )
        for output in outputs:
            if output in recording.outputs:
                floors[recording.name, output] = noise_floor(recording.outputs[output], recording.time, jumps).sd
    return floors


def shifts(parameters: ParameterSet, before: Refit, after_parameters: ParameterSet, after: Refit) -> tuple[Shift, ...]:
    """Change of every parameter that both fits share, the recordings' own excepted."""
    found = []
    first, second = parameters.from_search(before.coordinates), after_parameters.from_search(after.coordinates)
    slope_1, slope_2 = parameters.jacobian(first), after_parameters.jacobian(second)
    for j in before.free:
        item = parameters.items[j]
        if item.recording is not None or item.name not in after_parameters:
            continue
        k = after_parameters.index(item.name)
        if k in after.free:
            found.append(
                Shift(
                    item.name, float(first[j]), float(before.sd(j) * slope_1[j]), float(second[k]),
                    float(after.sd(k) * slope_2[k]),
                )
            )  # fmt: skip
    return tuple(found)


def _first_pitch(recording: Recording) -> float:
    """Mean pitch before the input first changes, over at most one second."""
    values = recording.outputs.get("theta")
    if values is None:
        return 0.0
    until = recording.time[0] + 1.0
    for signal in recording.inputs.values():
        changed = np.flatnonzero(np.diff(signal) != 0.0)
        before = recording.time[changed[0] + 1] if changed.size else until
        until = min(until, before if signal[0] == 0.0 else recording.time[0])
    chosen = values[(recording.time < until) | (np.arange(values.size) < 3)]
    chosen = chosen[np.isfinite(chosen)]
    return float(chosen.mean()) if chosen.size else 0.0

"""Predict whole recordings with a fitted model: its errors on training, validation and test readings."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.columns import Mask
from aero_bayes.data.recording import Recording
from aero_bayes.data.split import ROLES, Recordings, Role
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration, calibrate, for_recordings, templates
from aero_bayes.estimate.initial_states import CalibrationSettings, with_free_starts
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, local_fit
from aero_bayes.estimate.noise import residual_correlation_time
from aero_bayes.estimate.objective import objective_of
from aero_bayes.estimate.outliers import outlier_rows
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.simulate import first_moves_in, first_reading, interpolation_for, typical, with_interpolation
from aero_bayes.simulation.interface import ParameterTarget, Problem, Simulator, StartTarget
from aero_bayes.simulation.model import Model


@dataclass(frozen=True)
class RmsError:
    """Root mean square of a residual, its standard deviation with correlation counted, and the readings."""

    rms: float
    sd: float
    readings: int


@dataclass(frozen=True, eq=False)
class Prediction:
    """A model's prediction of whole recordings.

    ``train``, ``validation`` and ``test`` hold an :class:`RmsError` by recording and output; ``fitted`` the outputs
    (n,) by recording and output, on the recording's own samples."""

    train: Mapping[tuple[str, str], RmsError]
    validation: Mapping[tuple[str, str], RmsError]
    test: Mapping[tuple[str, str], RmsError]
    fitted: Mapping[tuple[str, str], FloatArray]

    def by_role(self, role: Role) -> Mapping[tuple[str, str], RmsError]:
        """Errors by recording and output of the readings that have a role."""
        return {"train": self.train, "validation": self.validation, "test": self.test}[role]

    @property
    def judged(self) -> Role:
        """The role whose errors are told first: the test part, or what is nearest to one."""
        return "test" if self.test else "validation" if self.validation else "train"

    def pooled(self, role: Role) -> dict[str, float]:
        """RMS by output over all recordings of a role."""
        errors = self.by_role(role)
        squares: dict[str, list[tuple[float, int]]] = {}
        for (_, output), error in errors.items():
            squares.setdefault(output, []).append((error.rms**2 * error.readings, error.readings))
        return {o: math.sqrt(sum(s for s, _ in items) / sum(n for _, n in items)) for o, items in squares.items()}

    def uncertainty(self, role: Role) -> dict[str, float]:
        """Standard deviation of :meth:`pooled`: each error moves it by its share of the squares, to first order."""
        errors, pooled = self.by_role(role), self.pooled(role)
        counts, squares = dict.fromkeys(pooled, 0), dict.fromkeys(pooled, 0.0)
        for (_, output), error in errors.items():
            counts[output] += error.readings
            squares[output] += (error.readings * error.rms * error.sd) ** 2
        return {o: math.sqrt(squares[o]) / max(counts[o] * pooled[o], 1e-300) for o in pooled}


@dataclass(frozen=True)
class Shift:
    """How far a parameter moved when the missing effect was added, in its unit and in combined standard deviations."""

    JSON_KEYS: ClassVar = "before before_sd after after_sd in_sd"

    name: str
    before: float
    before_sd: float
    after: float
    after_sd: float

    @property
    def in_sd(self) -> float:
        sd = math.hypot(self.before_sd, self.after_sd)
        return abs(self.after - self.before) / sd if sd > 0.0 else 0.0


def rms_error(residual: FloatArray) -> RmsError:
    """RMS of a residual (n,) and its standard deviation, corrected for autocorrelation."""
    n = residual.size
    if n == 0:
        return RmsError(math.nan, math.nan, 0)
    rms = float(np.sqrt(np.mean(residual**2)))
    if n < 10:
        return RmsError(rms, rms / math.sqrt(2.0 * n), n)
    return RmsError(rms, 0.5 * _sd_of_mean(residual**2) / max(rms, 1e-300), n)


def _sd_of_mean(series: FloatArray) -> float:
    """Standard deviation of the mean of a series (n,), with its correlation counted."""
    return float(np.std(series)) * math.sqrt(residual_correlation_time([series]) / series.size)


def shifts(before: Fit, after: Fit) -> tuple[Shift, ...]:
    """Change of every parameter that both fits determine, the recordings' own excepted."""
    shared = (e for n, e in before.parameters.items() if n in after.parameters and not e.recording)
    pairs = ((e, after.parameters[e.name]) for e in shared)
    return tuple(
        Shift(e.name, e.value, e.sd, now.value, now.sd) for e, now in pairs if e.sd is not None and now.sd is not None
    )


#: Share of the information on its initial states that the beginning of a test recording holds, from which they are
#: estimated, and the most of its readings that this may be.
START_INFORMATION, MOST_FOR_STARTS = 0.95, 0.5
#: Samples of a recording that is not looked at, and fewest that tell its initial states.
FIRST_ROWS = 20


class ModelFamily(Protocol):
    """A model, and the same model with laws added."""

    def base_model(self) -> Model:
        """Return the model without any law."""

    def transfer(self, calibration: Calibration, model: Model) -> Calibration:
        """Return a calibration of the base model with an extended one in its place."""


@dataclass(frozen=True, eq=False)
class Predictor:
    """Predict whole recordings with models of a family.

    A recording that was not fitted gets the mean input delay of the fitted recordings. Its initial states come from its
    validation readings, or, where it has none, from its beginning."""

    recordings: Recordings
    settings: CalibrationSettings
    family: ModelFamily
    open_simulator: Callable[[Problem], Simulator]

    @property
    def _fitted(self) -> int:
        """Number of recordings that were fitted."""
        return len(self.recordings.train)

    def predict(self, calibration: Calibration, fit: Optimum) -> Prediction:
        """Predict all recordings with a fitted model."""
        outputs = self.outputs(calibration, fit, range(len(self.recordings.everything)))
        if outputs is None:
            raise CannotFinishError("the fitted model cannot be simulated over the whole recordings")
        errors: dict[Role, dict[tuple[str, str], RmsError]] = {role: {} for role in ROLES}
        fitted: dict[tuple[str, str], FloatArray] = {}
        for e, recording in enumerate(self.recordings.everything):
            for column, output in enumerate(self.recordings.outputs):
                if output not in recording.outputs:
                    continue
                predicted = fitted[recording.name, output] = outputs[e][:, column]
                counted = counted_readings(recording, output, predicted)
                for part in self.recordings.parts_of(recording):
                    if np.any(counted & part.within):
                        left = (recording.outputs[output] - predicted)[counted & part.within]
                        errors[part.role][recording.name, output] = rms_error(left)
        return Prediction(errors["train"], errors["validation"], errors["test"], fitted)

    def outputs(
        self, calibration: Calibration, fit: Optimum, chosen: Collection[int], *, test: bool = True
    ) -> list[FloatArray] | None:
        """Outputs (n, m) of the ``chosen`` recordings, of others their first samples; without ``test`` NaN in its part.

        None where one of them cannot be simulated."""
        whole, row, starts = self._on_whole_recordings(calibration, fit)
        row = self._with_estimated_starts(whole, row, starts, fit)
        rows = [
            _rows_until(r, None if test else self._end_of_validation(r)) if k in chosen else FIRST_ROWS
            for k, r in enumerate(self.recordings.everything)
        ]
        with self.open_simulator(_beginnings(whole, rows).problem()) as simulator:
            found = simulator.simulate(row[np.newaxis])
        if np.any(found.outcomes[0] != 0):
            return None
        filled = [np.full((r.rows, len(self.recordings.outputs)), np.nan) for r in self.recordings.everything]
        for here, there in zip(filled, found.outputs, strict=True):
            here[: there.shape[1]] = there[0]
        return filled

    def _end_of_validation(self, recording: Recording) -> float | None:
        """The time (s) at which the test part of a recording begins."""
        return next((part.begin for part in self.recordings.parts_of(recording, "test")), None)

    def _on_whole_recordings(self, calibration: Calibration, fit: Optimum) -> tuple[Calibration, FloatArray, list[int]]:
        """The calibration on whole recordings, SI values (p,), and columns of the initial states to estimate."""
        named = tuple(replace(r, name=f"{r.name}#{k}") for k, r in enumerate(self.recordings.everything))
        plain = self.family.base_model()
        known = {v.name for v in plain.parameters}
        shared = templates(calibration.parameters)
        new = [
            p for p in shared
            if (p.target.name not in known if isinstance(p.target, ParameterTarget) else bool(p.starts))
        ]  # fmt: skip
        kept = ParameterSet(tuple(p for p in shared if p not in new))
        own = replace(
            self.settings, outputs=self.recordings.outputs, most_readings=None, keep_standstill_readings=True,
            interpolation=calibration.data.interpolation, solver=calibration.solver,
        )  # fmt: skip
        # Only the base model shows which states start at a reading: in an extended one a law may act on it.
        fixed = {name: value for name, value in calibration.fixed.items() if name in known}
        base_named = calibrate(named, plain, kept, fixed=fixed, settings=own)
        starts = with_free_starts(base_named.parameters, base_named.data.experiments, plain)
        own_starts = for_recordings(ParameterSet(tuple(new)), plain, named)
        base_named = replace(base_named, parameters=starts.extended(own_starts.items))
        whole = self.family.transfer(base_named, calibration.model)
        whole = replace(whole, fixed=calibration.fixed)
        row = _values(
            _renamed(calibration, base_named, whole), fit, base_named, self.recordings.everything, self._fitted
        )
        if self.settings.interpolation == "auto":
            whole = self._each_as_its_inputs_move(whole, calibration, row)
        # A law at an output hides the initial value of its state.
        hidden = [p.target for p in base_named.parameters] != [p.target for p in whole.parameters]
        all_starts, added = self.settings.initial_states == "estimated" or hidden, {p.name for p in own_starts}
        return whole, row, [
            j for j, p in enumerate(whole.parameters)
            if p.recording is not None and p.recording >= self._fitted
            and ((all_starts and isinstance(p.target, StartTarget)) or (p.starts and (all_starts or p.name in added)))
        ]  # fmt: skip

    def _each_as_its_inputs_move(self, whole: Calibration, calibration: Calibration, row: FloatArray) -> Calibration:
        """Return the calibration with each recording's inputs read as they move in it.

        Where an input moves in recordings that were not fitted only, the reading that predicts the better is taken."""
        fitted, model = self._fitted, calibration.model
        for k, recording in enumerate(self.recordings.everything):
            whole = with_interpolation(whole, interpolation_for(recording, calibration.data, model), {k})
        names, where = first_moves_in(whole, fitted)
        if not names:
            return whole
        linear = with_interpolation(whole, dict.fromkeys(names, "linear"), where)
        errors = []
        for one in (whole, linear):
            with self.open_simulator(one.problem()) as simulator:
                found = simulator.simulate(row[np.newaxis]).outputs
            left = [np.nanmean((y - f[0]) ** 2, axis=0) for y, f in zip(one.data.measured, found, strict=True)]
            errors.append([float(np.nansum(np.log(np.maximum(squares, 1e-300)))) for squares in left])
        better = {k for k in where if errors[1][k] < errors[0][k]}
        return with_interpolation(whole, dict.fromkeys(names, "linear"), better)

    def _with_estimated_starts(
        self, whole: Calibration, row: FloatArray, starts: Sequence[int], fit: Optimum
    ) -> FloatArray:
        """Values (p,) with initial states estimated from validation readings, or from the beginnings of recordings."""
        if not starts:
            return row
        rows = [FIRST_ROWS] * self._fitted
        for recording in self.recordings.everything[self._fitted :]:
            confirms = self.recordings.parts_of(recording, "validation")
            rows.append(_rows_until(recording, confirms[-1].end) if confirms else recording.rows)
        at = whole.parameters.to_search(row)
        if self.recordings.validation and self.recordings.test:
            rows = self._informative_rows(_beginnings(whole, rows), at, starts, rows)
        beginning = _beginnings(whole, rows)
        with self.open_simulator(beginning.problem()) as simulator, suppress(CannotFinishError):
            objective = objective_of(beginning, simulator)
            end = local_fit(objective, at, starts, noise=fit.noise, settings=LocalFitSettings(hold_noise=True))
            return whole.parameters.from_search(end.coordinates)
        return row

    def _informative_rows(
        self, whole: Calibration, at: FloatArray, starts: Sequence[int], rows: Sequence[int]
    ) -> list[int]:
        """Samples of each test recording that hold most of the information on its initial states."""
        with self.open_simulator(whole.problem()) as simulator:
            objective = objective_of(whole, simulator)
            found, kept = objective.evaluate(at, starts), list(rows)
        for k, recording in enumerate(self.recordings.everything):
            if not any(recording is r for r in self.recordings.test):
                continue
            least = FIRST_ROWS
            for series, slopes in zip(objective.series, (found.slopes or ()) if found else (), strict=False):
                if series.experiment == k:
                    seen = np.cumsum(slopes**2, axis=1)
                    enough = np.argmax(seen >= START_INFORMATION * seen[:, -1:], axis=1)
                    least = max(least, int(series.sampling.index[enough.max(initial=0)]) + 1)
            kept[k] = min(least, max(int(MOST_FOR_STARTS * rows[k]), FIRST_ROWS))
        return kept


def counted_readings(recording: Recording, output: str, predicted: FloatArray) -> Mask:
    """Readings (n,) of an output that count: those that are no outliers of a prediction."""
    read = recording.outputs[output]
    return np.isfinite(read - predicted) & ~outlier_rows(read, predicted, recording.inputs)


def _rows_until(recording: Recording, end: float | None) -> int:
    """Number of samples before a time (s); all for None."""
    return recording.rows if end is None else int(np.searchsorted(recording.time, end))


def _beginnings(whole: Calibration, rows: Sequence[int]) -> Calibration:
    """The calibration on the first ``rows`` samples of each recording."""
    experiments = (e.at_samples(slice(n)) for e, n in zip(whole.data.experiments, rows, strict=True))
    return replace(whole, data=whole.data.with_experiments(experiments))


def _renamed(calibration: Calibration, base_named: Calibration, whole: Calibration) -> Calibration:
    """The calibration of an extended model with its states named as in the base model."""
    old = {there.target: here.target for here, there in zip(base_named.parameters, whole.parameters, strict=True)}
    items = tuple(replace(p, target=old.get(p.target, p.target)) for p in calibration.parameters)
    return replace(calibration, model=base_named.model, parameters=ParameterSet(items))


def _values(
    calibration: Calibration, fit: Optimum, whole: Calibration, everything: Sequence[Recording], fitted: int
) -> FloatArray:
    """SI values of all parameters of ``whole``; those of recordings that were not fitted follow the fitted ones."""
    values = calibration.parameters.from_search(fit.coordinates)
    own = {(p.recording, p.target): v for p, v in zip(calibration.parameters, values.tolist(), strict=True)}
    follow = typical(calibration, values, everything)
    by_name = dict(zip(calibration.parameters.names, values.tolist(), strict=True))
    row = []
    for p in whole.parameters:
        if p.recording is None:
            row.append(by_name[p.name])
            continue
        value = own.get((p.recording, p.target)) if p.recording < fitted else None
        if value is None:
            first = first_reading(everything[p.recording], p.target, whole)
            known, otherwise = (0.0, p.start) if first is None else (first.level, 0.0)
            value = known + float(follow.get(p.target, otherwise))
        row.append(float(np.clip(value, p.lower, p.upper)))
    return np.array(row)

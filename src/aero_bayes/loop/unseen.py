"""Simulate a fitted model over whole recordings, unseen ones too, and propagate its uncertainty to the prediction."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.recording import Recording
from aero_bayes.data.split import Recordings
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration, calibrate, for_recordings, templates
from aero_bayes.estimate.initial_states import CalibrationSettings, with_free_starts
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, local_fit
from aero_bayes.estimate.noise import residual_correlation_time
from aero_bayes.estimate.objective import objective_of
from aero_bayes.estimate.outliers import outlier_rows
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.simulate import (
    first_moves_in,
    first_reading,
    interpolation_for,
    typical,
    with_interpolation,
)
from aero_bayes.simulation.interface import ParameterTarget, Problem, Simulator, StartTarget
from aero_bayes.structure.modelica_family import ModelicaFamily


@dataclass(frozen=True)
class RmsError:
    """Root mean square of a residual, its standard deviation with correlation counted, and the readings."""

    rms: float
    sd: float
    readings: int


@dataclass(frozen=True, eq=False)
class Prediction:
    """A model's prediction of whole recordings.

    ``train`` and ``test`` hold an :class:`Error` by recording and output; ``fitted`` the outputs (n,) by recording and
    output, on the recording's own samples."""

    train: Mapping[tuple[str, str], RmsError]
    test: Mapping[tuple[str, str], RmsError]
    fitted: Mapping[tuple[str, str], FloatArray]

    def pooled(self, role: str) -> dict[str, float]:
        """RMS by output over all recordings of a role."""
        errors = self.train if role == "train" else self.test
        squares: dict[str, list[tuple[float, int]]] = {}
        for (_, output), error in errors.items():
            squares.setdefault(output, []).append((error.rms**2 * error.readings, error.readings))
        return {o: math.sqrt(sum(s for s, _ in items) / sum(n for _, n in items)) for o, items in squares.items()}

    def uncertainty(self, role: str) -> dict[str, float]:
        """Standard deviation of :meth:`pooled`: each error moves it by its share of the squares, to first order."""
        errors, pooled = self.train if role == "train" else self.test, self.pooled(role)
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


#: Share of a recording that was not fitted from which its initial states are estimated.
INITIAL_STATE_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class Unseen:
    """Predict whole recordings with models of a family.

    A recording that was not fitted gets the mean input delay of the fitted recordings. Its initial states are its first
    readings plus the mean offset that the fitted recordings have."""

    recordings: Recordings
    settings: CalibrationSettings
    family: ModelicaFamily
    open_simulator: Callable[[Problem], Simulator]

    @property
    def _all_recordings(self) -> tuple[Recording, ...]:
        return *self.recordings.train, *self.recordings.test

    @property
    def _fitted(self) -> int:
        """Number of recordings that were fitted."""
        return len(self.recordings.train)

    def predict(self, calibration: Calibration, fit: Optimum) -> Prediction:
        """Predict all recordings with a fitted model."""
        whole, row, starts = self._on_whole_recordings(calibration, fit)
        row = self._with_estimated_starts(whole, row, starts, fit)
        with self.open_simulator(whole.problem()) as simulator:
            found = simulator.simulate(row[np.newaxis])
        if np.any(found.outcomes[0] != 0):
            raise CannotFinishError("the fitted model cannot be simulated over the whole recordings")
        errors: tuple[dict[tuple[str, str], RmsError], dict[tuple[str, str], RmsError]] = ({}, {})
        fitted: dict[tuple[str, str], FloatArray] = {}
        for e, recording in enumerate(self._all_recordings):
            unseen = recording.time >= self.recordings.unseen_from.get(recording.name, math.inf)
            for column, output in enumerate(self.recordings.outputs):
                if output not in recording.outputs:
                    continue
                predicted = found.outputs[e][0, :, column]
                key = (recording.name, output)
                fitted[key] = predicted
                residual = recording.outputs[output] - predicted
                seen = np.isfinite(residual) & ~outlier_rows(recording.outputs[output], predicted, recording.inputs)
                if e >= self._fitted:
                    errors[1][key] = rms_error(residual[seen])
                    continue
                errors[0][key] = rms_error(residual[seen & ~unseen])
                if unseen.any():
                    errors[1][key] = rms_error(residual[seen & unseen])
        return Prediction(errors[0], errors[1], fitted)

    def _on_whole_recordings(self, calibration: Calibration, fit: Optimum) -> tuple[Calibration, FloatArray, list[int]]:
        """The calibration on whole recordings, SI values (p,), and columns of the initial states to estimate."""
        named = tuple(replace(r, name=f"{r.name}#{k}") for k, r in enumerate(self._all_recordings))
        plain = self.family.base_model()
        known = {v.name for v in plain.parameters}
        shared = templates(calibration.parameters)
        new = [p for p in shared if isinstance(p.target, ParameterTarget) and p.target.name not in known]
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
        row = _values(_renamed(calibration, base_named, whole), fit, base_named, self._all_recordings, self._fitted)
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
        for k, recording in enumerate(self._all_recordings):
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
        """Values (p,) with initial states estimated from the beginnings of the recordings."""
        beginning = replace(whole, data=whole.data.beginning(INITIAL_STATE_SHARE))
        settings, at = LocalFitSettings(hold_noise=True), whole.parameters.to_search(row)
        if starts:
            with self.open_simulator(beginning.problem()) as simulator, suppress(CannotFinishError):
                objective = objective_of(beginning, simulator)
                end = local_fit(objective, at, starts, noise=fit.noise, settings=settings)
                return whole.parameters.from_search(end.coordinates)
        return row


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

"""Simulate a fitted model over whole recordings, unseen ones too, and propagate its uncertainty to the prediction."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration, calibrate
from aero_bayes.estimate.calibration_settings import CalibrationSettings
from aero_bayes.estimate.filter_objective import objective_of
from aero_bayes.estimate.initial_states import with_free_starts
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, local_fit
from aero_bayes.estimate.new_recording import first_reading, typical
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.recording_parameters import for_recordings, templates
from aero_bayes.judge.prediction import Prediction, RmsError, rms_error
from aero_bayes.judge.recordings import Recordings
from aero_bayes.laws.model_family import ModelFamily
from aero_bayes.simulation.interface import ParameterTarget, Problem, Simulator, StartTarget

#: Share of a recording that was not fitted from which its initial states are estimated.
INITIAL_STATE_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class Unseen:
    """Predict whole recordings with models of a family.

    A recording that was not fitted gets the mean input delay of the fitted recordings. Its initial states are its first
    readings plus the mean offset that the fitted recordings have."""

    recordings: Recordings
    settings: CalibrationSettings
    family: ModelFamily
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
        rows, _ = self._with_estimated_starts(whole, row[np.newaxis], starts, fit)
        with self.open_simulator(whole.problem()) as simulator:
            found = simulator.simulate(rows)
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
                seen = np.isfinite(residual)
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
            interpolation=calibration.data.interpolation, solver=calibration.simulated.solver,
        )  # fmt: skip
        # Only the base model shows which states start at a reading: in an extended one a law may act on it.
        fixed = {name: value for name, value in calibration.simulated.fixed.items() if name in known}
        base_named = calibrate(named, plain, kept, fixed=fixed, settings=own)
        starts = with_free_starts(base_named.parameters, base_named.data.experiments, plain)
        own_starts = for_recordings(ParameterSet(tuple(new)), plain, named)
        base_named = replace(base_named, parameters=starts.extended(own_starts.items))
        whole = self.family.transfer(base_named, calibration.model)
        whole = replace(whole, simulated=replace(whole.simulated, fixed=calibration.simulated.fixed))
        row = _values(_renamed(calibration, base_named, whole), fit, base_named, self._all_recordings, self._fitted)
        # A law at an output hides the initial value of its state.
        hidden = [p.target for p in base_named.parameters] != [p.target for p in whole.parameters]
        all_starts, added = self.settings.initial_states == "estimated" or hidden, {p.name for p in own_starts}
        return whole, row, [
            j for j, p in enumerate(whole.parameters)
            if p.recording is not None and p.recording >= self._fitted
            and ((all_starts and isinstance(p.target, StartTarget)) or (p.starts and (all_starts or p.name in added)))
        ]  # fmt: skip

    def _with_estimated_starts(
        self, whole: Calibration, rows: FloatArray, starts: Sequence[int], fit: Optimum
    ) -> tuple[FloatArray, list[Optimum]]:
        """Values (n, p) with initial states estimated from the beginnings of the recordings, and these optima."""
        if not starts:
            return rows, []
        settled, ends = rows.copy(), []
        beginning = replace(whole, data=whole.data.beginning(INITIAL_STATE_SHARE))
        with self.open_simulator(beginning.problem()) as simulator:
            objective = objective_of(beginning, simulator)
            for k, at in enumerate(whole.parameters.to_search(rows)):
                with suppress(CannotFinishError):
                    settings = LocalFitSettings(hold_noise=True)
                    ends.append(local_fit(objective, at, starts, noise=fit.noise, settings=settings))
                    settled[k] = whole.parameters.from_search(ends[-1].coordinates)
        return settled, ends


def _renamed(calibration: Calibration, base_named: Calibration, whole: Calibration) -> Calibration:
    """The calibration of an extended model with its states named as in the base model."""
    old = {there.target: here.target for here, there in zip(base_named.parameters, whole.parameters, strict=True)}
    items = tuple(replace(p, target=old.get(p.target, p.target)) for p in calibration.parameters)
    simulated = replace(calibration.simulated, model=base_named.model)
    return replace(calibration, simulated=simulated, parameters=ParameterSet(items))


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

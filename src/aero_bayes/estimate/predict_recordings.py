"""Predict whole recordings with a fitted model: its errors on training, validation and test readings."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.columns import Mask
from aero_bayes.data.recording import Recording
from aero_bayes.data.split import ROLES, Recordings, Role
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.noise import residual_correlation_time
from aero_bayes.estimate.outliers import outlier_rows
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.simulate import FEWEST_ROWS, ModelFamily, Place, beginnings, on_recordings
from aero_bayes.plain import INTERNAL, Number
from aero_bayes.simulation.interface import Problem, Simulator


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

    name: str = field(metadata=INTERNAL)
    before: Number
    before_sd: Number
    after: Number
    after_sd: Number
    in_sd: Number


def rms_error(residual: FloatArray) -> RmsError:
    """RMS of a residual (n,) and its standard deviation, corrected for autocorrelation."""
    n = residual.size
    if n == 0:
        return RmsError(math.nan, math.nan, 0)
    rms = float(np.sqrt(np.mean(residual**2)))
    if n < 10:
        return RmsError(rms, rms / math.sqrt(2.0 * n), n)
    squares = residual**2
    sd_of_mean = float(np.std(squares)) * math.sqrt(residual_correlation_time([squares]) / n)
    return RmsError(rms, 0.5 * sd_of_mean / max(rms, 1e-300), n)


def shifts(before: Fit, after: Fit) -> tuple[Shift, ...]:
    """Change of every parameter that both fits determine, the recordings' own excepted."""
    shared = (e for n, e in before.parameters.items() if n in after.parameters and not e.recording)
    found = []
    for e, now in ((e, after.parameters[e.name]) for e in shared):
        if e.sd is not None and now.sd is not None:
            sd = math.hypot(e.sd, now.sd)
            in_sd = abs(now.value - e.value) / sd if sd > 0.0 else 0.0
            found.append(Shift(e.name, e.value, e.sd, now.value, now.sd, in_sd))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Predictor:
    """Predict whole recordings with models of a family, by the rule of :mod:`aero_bayes.estimate.simulate`.

    Initial states that are estimated come from validation readings or, where there are none, from the beginning."""

    recordings: Recordings
    family: ModelFamily
    open_simulator: Callable[[Problem], Simulator]

    def predict(self, calibration: Calibration, fit: Optimum) -> Prediction:
        """Predict all recordings with a fitted model."""
        outputs = self.outputs(calibration, fit, range(len(self.recordings.everything)), also_without_test=False)
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
        self, calibration: Calibration, fit: Optimum, chosen: Collection[int], *, also_without_test: bool = True
    ) -> list[FloatArray] | None:
        """Outputs (n, m) of the ``chosen`` recordings, of others their first samples.

        Where one of them cannot be simulated, NaN in the test parts, and None where even that fails."""
        everything, count = self.recordings.everything, len(self.recordings.train)
        confirms = [self.recordings.parts_of(r, "validation") for r in everything]
        places = [
            Place(k) if k < count else Place(confirming=_rows_until(r, own[-1].end) if own else None)
            for k, (r, own) in enumerate(zip(everything, confirms, strict=True))
        ]
        whole, values = on_recordings(
            calibration, calibration.parameters.from_search(fit.coordinates)[np.newaxis], everything, fit.noise,
            self.open_simulator, family=self.family, places=places,
        )  # fmt: skip
        begins = [next((p.begin for p in self.recordings.parts_of(r, "test")), None) for r in everything]
        for ends in ([None] * len(everything), begins)[: 1 + also_without_test]:
            rows = [
                _rows_until(r, end) if k in chosen else FEWEST_ROWS
                for k, (r, end) in enumerate(zip(everything, ends, strict=True))
            ]
            with self.open_simulator(beginnings(whole, rows).problem()) as simulator:
                found = simulator.simulate(values)
            if not np.any(found.outcomes[0]):
                filled = [np.full((r.rows, len(self.recordings.outputs)), np.nan) for r in everything]
                for here, there in zip(filled, found.outputs, strict=True):
                    here[: there.shape[1]] = there[0]
                return filled
        return None


def counted_readings(recording: Recording, output: str, predicted: FloatArray) -> Mask:
    """Readings (n,) of an output that count: those that are no outliers of a prediction."""
    read = recording.outputs[output]
    return np.isfinite(read - predicted) & ~outlier_rows(read, predicted, recording.inputs)


def _rows_until(recording: Recording, end: float | None) -> int:
    """Number of samples before a time (s); all for None."""
    return recording.rows if end is None else int(np.searchsorted(recording.time, end))

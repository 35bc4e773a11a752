"""Errors of a model before and after its extension, on fitted and on unseen data, and the shift of its parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.display import with_unit
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.sensors.whiteness import residual_correlation_time

#: Ratio of two errors above which the error is said to grow.
MIN_GROWTH_RATIO = 1.05


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
    """How far a parameter moved when the missing effect was added, in its own unit and in standard deviations after."""

    name: str
    before: float
    before_sd: float
    after: float
    after_sd: float

    @property
    def in_sd(self) -> float:
        return abs(self.after - self.before) / self.after_sd if self.after_sd > 0.0 else 0.0


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


def describe_error_change(before: Prediction, after: Prediction, units: Mapping[str, str]) -> str:
    """Say how far the error of one output falls, the one where it falls most, and which other errors grow."""
    role = "test" if before.test else "train"
    first, second = before.pooled(role), after.pooled(role)
    most = max(first, key=lambda o: first[o] / max(second[o], 1e-300))
    where = "data that was not fitted" if role == "test" else "the fitted data"

    def change(output: str, verb: str) -> str:
        after_it = with_unit(f"{second[output]:.3g}", units.get(output, ""))
        return f"of {output} {verb} from {first[output]:.3g} to {after_it}"

    verb = "falls" if second[most] < first[most] else "changes"
    grown = [change(o, "grows") for o in first if o != most and second[o] > MIN_GROWTH_RATIO * first[o]]
    return f"on {where} the error {change(most, verb)}{''.join(f', but {text}' for text in grown)}."


def shifts(
    parameters: ParameterSet, before: Optimum, after_parameters: ParameterSet, after: Optimum
) -> tuple[Shift, ...]:
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

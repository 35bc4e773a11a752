"""Outputs on another clock than the inputs: ahead of them, or on a clock that runs a constant share faster or slower.

The fitted trajectory is compared with the readings at other times, its parameters moved by one Newton step. Nothing is
simulated. An output that comes late is no fault of a clock: sensors lag and inputs are delayed. A clock that runs at
another rate is told where the inputs keep changing, since a single response runs faster with other parameters, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.objective import Series
from aero_bayes.estimate.result import Fit

#: Samples by which an output may be ahead, and shares by which a clock may be off.
MAX_AHEAD, RATES = 4, tuple(np.geomspace(5e-5, 0.05, 31).tolist())
#: Readings of a series that are looked at, share of the squares that has to go before a refit tries it (the parameters
#: have taken up much of it, and come back by more than one step), and most that are tried.
MOST_READINGS, MIN_GONE, MAX_TRIED = 2000, 0.1, 6
#: Parts of a recording in each of which an input has to change before its clock is compared with the outputs'.
PARTS = 3


@dataclass(frozen=True)
class Misalignment:
    """Outputs read at other times than their stamps: ``rate`` and ``ahead`` (s) of one of them, or of all (empty)."""

    output: str
    rate: float
    ahead: float
    samples: int = 0

    @property
    def what(self) -> str:
        """What is told of it, up to what the residual does."""
        if self.rate:
            side, whose = "slow" if self.rate > 0.0 else "fast", self.output or "the outputs"
            return (
                f"The clock of {whose} looks {100.0 * abs(self.rate):.2g} % {side} beside that of the inputs: "
                "with one clock"
            )
        return f"{self.output} looks {self.ahead:.3g} s ({self.samples} samples) ahead of the inputs: moved back"

    @property
    def done(self) -> str:
        if self.rate:
            return "Put both on one clock: each of two loggers has its own."
        return f"Shift its column, or let the fit do so by [fit] max_input_delay = -{1.5 * self.ahead:.2g}."

    def aligned(self, calibration: Calibration) -> Calibration:
        """Return the calibration with inputs on the outputs' clock, or with an output's readings at their times."""
        experiments = []
        for e in calibration.data.experiments:
            begin, rate = e.time[0], 1.0 + self.rate
            if not self.output:
                moved = tuple(replace(s, time=begin + (s.time - begin) / rate) for s in e.inputs)
                experiments.append(replace(e, inputs=moved))
                continue
            assert e.measured is not None
            measured, column = e.measured.copy(), e.outputs.index(self.output)
            seen = np.isfinite(measured[:, column])
            stamps = begin + (e.time[seen] - begin - self.ahead) / rate
            if seen.any():
                measured[seen, column] = np.interp(
                    stamps, e.time[seen], measured[seen, column], left=np.nan, right=np.nan
                )
            experiments.append(replace(e, measured=measured))
        return replace(calibration, data=calibration.data.with_experiments(experiments))


def misalignments(fit: Fit) -> list[Misalignment]:
    """List outputs that are ahead, and clocks that are off, where the squares of an output fall: the best first."""
    data = fit.calibration.data
    if not any(e.inputs for e in data.experiments):
        return []
    interval = min(data.intervals)
    found: list[tuple[float, Misalignment]] = []
    own_clocks = {o: {k for k, s in enumerate(fit.series) if s.output == o} for o in data.outputs}
    for output, own in own_clocks.items():
        for n in range(1, MAX_AHEAD + 1):
            found.append((_left(fit, 0.0, n * interval, own), Misalignment(output, 0.0, n * interval, n)))
    if _inputs_keep_changing(fit):
        every = {"": set(range(len(fit.series)))}
        for output, moved in (every | own_clocks if len(own_clocks) > 1 else every).items():
            rates = [(_left(fit, sign * rate, 0.0, moved), sign * rate) for rate in RATES for sign in (-1.0, 1.0)]
            _, rate = min(rates)
            finer = [(_left(fit, r, 0.0, moved), r) for r in (rate * np.linspace(0.8, 1.25, 19)).tolist()]
            left, rate = min(finer)
            found.append((left, Misalignment(output, rate, 0.0)))
    found.sort(key=lambda pair: pair[0])
    likely = [one for left, one in found if left < 1.0 - MIN_GONE]
    early = {one.output for one in likely if not one.rate}
    first = next((one.output for one in likely if one.output in early), None)
    # All shifts of an output: the step from a fit that has taken up much of a shift tells little of how large it is.
    shifts = [one for _, one in found if not one.rate and one.output == first]
    return [*shifts, *(one for one in likely if one.rate)][:MAX_TRIED]


def _inputs_keep_changing(fit: Fit) -> bool:
    """Return whether an input changes in each part of the longest recording."""
    longest = max(fit.calibration.data.experiments, key=lambda e: float(e.time[-1] - e.time[0]))
    edges = np.linspace(longest.time[0], longest.time[-1], PARTS + 1)
    return any(np.all(np.histogram(s.time[1:][np.diff(s.values) != 0.0], edges)[0] > 0) for s in longest.inputs)


def _left(fit: Fit, rate: float, ahead: float, moved: set[int]) -> float:
    """Compute the share of an output's squares that is left at best, with some series at other times.

    The parameters take one Newton step of least squares."""
    slopes, predicted = fit.optimum.evaluation.slopes, fit.optimum.evaluation.predicted
    assert slopes is not None
    rows, columns = [], []
    for k, series in enumerate(fit.series):
        every = -(-series.sampling.size // MOST_READINGS)
        time = series.sampling.time
        at = time[::every]
        if k in moved:
            at = time[0] + (at - time[0]) * (1.0 + rate) + ahead
        sd = fit.noise[series.output].sd
        rows.append((series.measured[::every] - np.interp(at, time, predicted[k])) / sd)
        columns.append(np.array([np.interp(at, time, row) for row in slopes[k]]).reshape(len(slopes[k]), -1) / sd)
    residual, design = np.concatenate(rows), np.concatenate(columns, axis=1)
    step = np.linalg.lstsq(design.T, residual, rcond=1e-8)[0] if len(design) else np.zeros(0)
    after = residual - step @ design
    return _least_share(fit.series, rows, after)


def _least_share(series: tuple[Series, ...], rows: list[FloatArray], after: FloatArray) -> float:
    """Compute the least share of squares left over outputs; the present residual is of unit size in each."""
    ends = np.cumsum([r.size for r in rows])[:-1]
    by_output: dict[str, list[FloatArray]] = {}
    for s, left in zip(series, np.split(after, ends), strict=True):
        by_output.setdefault(s.output, []).append(left)
    return min(float(np.mean(np.concatenate(parts) ** 2)) for parts in by_output.values())

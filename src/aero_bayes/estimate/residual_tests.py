"""Tests of a residual, and the error of a model on each recording, judged by that recording's own noise."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.special import chdtrc

from aero_bayes.arrays import FloatArray
from aero_bayes.data.recording import Recording
from aero_bayes.data.split import Part, Role
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.noise import (
    FALSE_ALARM_RATE,
    OutputNoise,
    autocorrelation,
    correlation_p_value,
    is_rotor_speed,
    ripple_means,
)
from aero_bayes.estimate.noise_estimation import innovations, is_model_error, whiten
from aero_bayes.estimate.objective import Series
from aero_bayes.estimate.outliers import outlier_rows
from aero_bayes.estimate.reading_spread import SpreadModel
from aero_bayes.plain import INTERNAL, Number
from aero_bayes.simulation.interface import SolverSettings

ResidualVerdict = Literal["adequate", "structured"]

#: Residual, as a share of what an output moves, up to which it is rounding, and up to which it may be the solver's
#: error: no sensor is that good, and simulated data without noise leave less.
ROUNDING_SHARE, SOLVER_SHARE = 1e-6, 1e-4
#: Residual over the step of readings from which their rounding is in it: that of a register that counts far.
MIN_STEP_SHARE = 0.2
#: Ratio of a residual to the noise floor above which it is structured, regardless of the tests.
MAX_FLOOR_RATIO = 2.0


@dataclass(frozen=True, eq=False)
class ResidualReport:
    """The residual of one output of one recording; ``correlations`` are with inputs and fitted states.

    ``tests`` has the probabilities that independent noise is as structured, by what was looked for; ``p_value`` is the
    smallest, corrected for their number. ``ratio`` is over the noise floor, where that is known."""

    rms: Number
    white: bool
    verdict: ResidualVerdict
    noise_floor: float | None = None
    ratio: Number = math.nan
    p_value: Number = math.nan
    exact: bool = False
    tests: Mapping[str, Number] = field(default_factory=dict)
    correlations: Mapping[str, Number] = field(default_factory=dict)
    worst_time: tuple[Number, ...] = ()
    worst_share: Number = math.nan
    recording: str = field(default="", metadata=INTERNAL)
    output: str = field(default="", metadata=INTERNAL)
    noise: float = field(default=math.nan, metadata=INTERNAL)

    @property
    def over_noise(self) -> float:
        """Residual over the noise floor, or over the fitted noise if no floor is known."""
        return _over(self.rms, self.noise if self.noise_floor is None else self.noise_floor)


def _over(rms: float, size: float) -> float:
    return rms / size if size > 0.0 else math.inf


def exact_level(solver: SolverSettings, series: Series) -> float:
    """Compute the RMS residual, in the output's unit, up to which there is only rounding and the solver's error."""
    size, moved = float(np.max(np.abs(series.measured))), float(np.ptp(series.measured))
    error = solver.relative_tolerance * size + solver.absolute_tolerance
    return max(ROUNDING_SHARE * moved, min(error, SOLVER_SHARE * moved))


def _resolution(values: FloatArray) -> float:
    """Return the step that readings are multiples of; infinity for readings with all their digits."""
    steps = np.diff(np.unique(np.diff(values)))
    steps = steps[steps > 64.0 * np.finfo(float).eps * np.max(np.abs(values))]
    count = steps / steps.min(initial=math.inf)
    return float(steps.min()) if count.size and np.mean(np.abs(count - np.rint(count)) < 0.05) > 0.95 else math.inf


def structured_residuals(reports: Iterable[ResidualReport]) -> list[ResidualReport]:
    """Return the reports of structured residuals."""
    return [report for report in reports if report.verdict == "structured"]


def reports_by_recording(reports: Sequence[ResidualReport]) -> dict[str, dict[str, ResidualReport]]:
    """Return reports by recording and output, as result.json holds them."""
    table: dict[str, dict[str, ResidualReport]] = {}
    for report in reports:
        table.setdefault(report.recording, {})[report.output] = report
    return table


def smooth_dependence_test(
    over: FloatArray, innovations: FloatArray, series: Series, noise: OutputNoise, slopes: FloatArray
) -> float:
    """Test for a smooth dependence of a residual on ``over`` (n,), such as a state or the time."""
    low, high = float(over.min()), float(over.max())
    if not high > low:
        return 1.0
    # Half of the weight of the knots is by rank, so that most of them are where the data are.
    knots = 0.5 * (np.linspace(low, high, 8) + np.quantile(over, np.linspace(0.0, 1.0, 8)))
    knots = knots[np.concatenate(([True], np.diff(knots) > 1e-6 * (high - low)))]
    basis = np.stack([np.interp(over, knots, row) for row in np.eye(knots.size)])
    rows, _ = whiten(basis, series.sampling, noise)
    return _chi_square(rows, innovations, slopes)


def slow_variation_test(
    innovations: FloatArray, series: Series, noise: OutputNoise, slopes: FloatArray, waves: int = 12
) -> float:
    """Test for the ``waves`` slowest cosines over the recording."""
    n = innovations.size
    phase = np.pi * (np.arange(n) + 0.5) / n
    rows, _ = whiten(np.cos(np.outer(np.arange(1, waves + 1), phase)), series.sampling, noise)
    return _chi_square(rows, innovations, slopes)


def _chi_square(rows: FloatArray, innovations: FloatArray, slopes: FloatArray) -> float:
    if slopes.size:
        gram = slopes @ slopes.T
        gram[np.diag_indices_from(gram)] *= 1.0 + 1e-9
        gram[np.diag_indices_from(gram)] += 1e-12
        rows = rows - (np.linalg.solve(gram, slopes @ rows.T).T) @ slopes
    norms = np.linalg.norm(rows, axis=1)
    rows = rows[norms > 1e-6 * max(float(norms.max(initial=0.0)), 1e-300)]
    if rows.size == 0:
        return 1.0
    values, vectors = np.linalg.eigh(rows @ rows.T)
    keep = values > 1e-6 * values[-1]
    scores = (vectors[:, keep].T @ (rows @ innovations)) / np.sqrt(values[keep])
    return float(chdtrc(int(keep.sum()), float(scores @ scores)))


def check_residuals(
    calibration: Calibration,
    series: Sequence[Series],
    fit: Optimum,
    floors: Mapping[tuple[str, str], float],
) -> tuple[ResidualReport, ...]:
    """Test the residual of every output of every recording."""
    reports = []
    units = calibration.model.units
    for k, own in enumerate(series):
        residual, noise, slopes = fit.evaluation.residual[k], fit.noise[own.output], fit.evaluation.slopes
        assert slopes is not None
        rows = np.vstack([residual[None], slopes[k]])
        floor, size = floors.get((calibration.data.names[own.experiment], own.output)), noise.sd
        if own.sampling.spread is not None and np.ptp(own.sampling.spread) > 0.0:
            floor = None  # it is that of noise that is equally large at each reading
        if fit.evaluation.sd is not None:  # a filter's innovations, whose size is not the sensor's alone
            sd = fit.evaluation.sd[k]
            rows, noise, floor, size = rows / sd, OutputNoise(1.0), None, float(np.sqrt(np.mean(sd**2)))
        else:
            rows, _ = whiten(rows, own.sampling, noise)
        innovations, white = rows[0], rows[1:]
        states = _states(calibration.data, series, fit, own, units)
        turning = any(
            s.experiment == own.experiment and is_rotor_speed(s.measured, units.get(s.output, "")) for s in series
        )
        means = ripple_means(innovations, own.sampling.interval) if turning else innovations
        tests = {
            "autocorrelation": correlation_p_value(means, means),
            "slow": slow_variation_test(innovations, own, noise, white),
            **{name: smooth_dependence_test(over, innovations, own, noise, white) for name, over in states.items()},
        }
        rms = float(np.sqrt(np.mean(residual**2)))
        within = rms <= exact_level(calibration.solver, own)
        beyond = floor is not None and rms > MAX_FLOOR_RATIO * max(floor, 1e-300)
        longest = max(s.sampling.duration for s in series if s.output == own.output)
        lasting = is_model_error(noise, longest)
        p_value = min(1.0, len(tests) * min(tests.values(), default=1.0))
        structured = not within and (p_value < FALSE_ALARM_RATE or beyond or lasting)
        window, share = _worst_window(own.sampling.time, innovations)
        correlations = {name: _correlation(residual, over) for name, over in states.items()}
        reports.append(
            ResidualReport(
                rms, p_value >= FALSE_ALARM_RATE, "structured" if structured else "adequate", floor,
                math.nan if floor is None else _over(rms, floor), p_value,
                within and rms < MIN_STEP_SHARE * _resolution(own.measured), tests, correlations, window, share,
                calibration.data.names[own.experiment], own.output, size,
            )
        )  # fmt: skip
    return tuple(reports)


def _states(
    data: MeasuredData, series: Sequence[Series], fit: Optimum, own: Series, units: Mapping[str, str]
) -> dict[str, FloatArray]:
    """Compute fitted outputs, derivatives of outputs that are positions, and inputs, at the samples of one output.

    An input has its value just before the sample: a controller computes the next value from the reading and its noise.
    So have the outputs of a filter, whose predictions follow the readings."""
    states: dict[str, FloatArray] = {}
    time, filtered = own.sampling.time, fit.evaluation.sd is not None
    for k, other in enumerate(series):
        if other.experiment != own.experiment:
            continue
        there, predicted = other.sampling.time, fit.evaluation.predicted[k]
        level = _until(time, there, predicted) if filtered else np.interp(time, there, predicted)
        states[other.output] = level
        if units.get(other.output) in ("rad", "m"):
            rate = np.gradient(level, time)
            if filtered:
                rate[1:] = np.diff(level) / np.diff(time)
                rate[0] = rate[1]
            states[f"der({other.output})"] = rate
    for signal in data.experiments[own.experiment].inputs:
        states[signal.name] = _until(time, signal.time, signal.values)
    return states


def _until(time: FloatArray, there: FloatArray, values: FloatArray) -> FloatArray:
    """Return the last of some values before each time."""
    return values[np.clip(np.searchsorted(there, time, side="left") - 1, 0, there.size - 1)]


def _correlation(a: FloatArray, b: FloatArray) -> float:
    a, b = a - a.mean(), b - b.mean()
    norm = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / norm if norm > 0.0 else 0.0


def _worst_window(time: FloatArray, innovations: FloatArray, parts: int = 10) -> tuple[tuple[float, float], float]:
    edges = np.linspace(time[0], time[-1], parts + 1)
    energy = np.histogram(time, edges, weights=innovations**2)[0]
    worst = int(np.argmax(energy))
    return (float(edges[worst]), float(edges[worst + 1])), float(energy[worst] / max(float(energy.sum()), 1e-300))


Verdict = Literal["noise", "structured", "too large"]
#: Error over noise above which it is too large: then more than two fifths of its square are no noise.
MAX_RATIO = 1.3
#: Least autocorrelation, at any of the lags that are tested, of a residual with structure: with many readings a
#: dependence that nobody would see in a plot fails the test, too.
MIN_CORRELATION, LAGS = 0.1, 20
#: Share of the output's range up to which an error is the solver's or rounding, whose structure says nothing.
EXACT_SHARE = 1e-6
#: Fewest readings that are judged.
MIN_READINGS = 16

Fitted = Mapping[tuple[str, str], FloatArray]


@dataclass(frozen=True)
class RecordingError:
    """Error of one output in one recording (RMS, SI) before and after; a part of it is from ``begin`` to ``end``, in s.

    ``noise`` is that of this recording, or, where it cannot be told from the readings, that of the fit
    (``noise_known`` is false). ``ratio`` to the noise, ``verdict`` and ``p_value`` (of a white residual) are of the
    model that came out."""

    recording: str
    role: Role
    output: str
    before: float | None
    after: Number
    noise: Number
    noise_known: bool
    ratio: Number
    p_value: Number
    verdict: Verdict
    begin: float | None = None
    end: float | None = None

    @property
    def change(self) -> float:
        """The error after over that before; not a number where there is none before."""
        return self.after / self.before if self.before else math.nan


def recording_errors(
    parts: Sequence[Part],
    before: Fitted | None,
    after: Fitted,
    floors: Mapping[tuple[str, str], float],
    noise: Mapping[str, OutputNoise],
    spreads: Mapping[str, SpreadModel] | None = None,
) -> tuple[RecordingError, ...]:
    """Judge models by each part of the recordings, outliers of the last model left out.

    ``before`` and ``after`` hold the outputs of the models on all samples, by recording and output, ``floors`` the
    noise that is known, ``spreads`` how it differs from reading to reading."""
    found = []
    for part in parts:
        recording, within = part.recording, part.within
        for output, fitted in ((o, y) for (name, o), y in after.items() if name == recording.name):
            read = recording.outputs[output]
            counted = within & ~outlier_rows(read, fitted, recording.inputs)
            residual = np.where(counted, read - fitted, np.nan)
            if np.isfinite(residual).sum() < MIN_READINGS:
                continue
            before_it = None if before is None else before[recording.name, output]
            was = None if before_it is None else _rms(np.where(counted, read - before_it, np.nan))
            floor = floors.get((recording.name, output))
            rms = _rms(residual)
            spread = (spreads or {}).get(output)
            if spread is not None and spread.kind == "relative":
                sd = spread.sd(fitted, 0)
                floor = _rms(np.where(np.isfinite(residual), sd, np.nan))
                residual = residual / sd * floor
            size = noise[output].sd if floor is None else floor
            p_value, structured = _whiteness(recording, output, residual, noise[output])
            structured = structured and rms > EXACT_SHARE * float(np.ptp(fitted))
            verdict: Verdict = "too large" if rms > MAX_RATIO * size else "structured" if structured else "noise"
            found.append(RecordingError(
                recording.name, part.role, output, was, rms, size, floor is not None,
                rms / size if size > 0.0 else math.inf, p_value, verdict, part.begin, part.end,
            ))  # fmt: skip
    return tuple(found)


def _rms(residual: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(residual**2)))


def _whiteness(recording: Recording, output: str, residual: FloatArray, noise: OutputNoise) -> tuple[float, bool]:
    """Return the p-value of a white residual, and whether its correlation can be seen as well."""
    white = innovations(recording.time, residual, noise)
    white = white[np.isfinite(white)]
    if is_rotor_speed(recording.outputs[output], recording.units.get(output, "")):
        white = ripple_means(white, float(np.median(np.diff(recording.time))))
    p_value = correlation_p_value(white, white, LAGS)
    seen = float(np.abs(autocorrelation(white, LAGS)[1:]).max(initial=0.0))
    return p_value, p_value < FALSE_ALARM_RATE and seen > MIN_CORRELATION

"""Estimates of the noise of an output from its residuals (by Whittle's likelihood, then exactly), and of rounding."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import scipy  # imports its parts when they are first used
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.data.noise_floor import quantisation_step
from aero_bayes.estimate.noise import NoiseKind, OutputNoise, SampleTimes
from aero_bayes.simulation.worker_group import engine_path

LOG_2PI = float(np.log(2.0 * np.pi))


@cache
def _compiled_filter() -> Any:
    whiten = ctypes.CDLL(str(engine_path())).ab_whiten
    array, count = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS"), ctypes.c_int64
    whiten.argtypes = [array, ctypes.c_double, count, array, count, array, count, array, array]
    whiten.restype = None
    return whiten


def whiten_rows(
    rows: FloatArray, time: FloatArray, noise: FloatArray, interval: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Compute innovations of rows over their standard deviations."""
    out = np.array(rows, dtype=np.float64, order="C")
    kinds = np.ascontiguousarray(np.atleast_2d(noise), dtype=np.float64)
    weight = np.empty((len(kinds), out.shape[1]))
    stamps = np.ascontiguousarray(time, dtype=np.float64)
    _compiled_filter()(stamps, interval, out.shape[1], kinds, len(kinds), out, len(out), np.zeros(len(out)), weight)
    return out, weight


def whiten(rows: FloatArray, sampling: SampleTimes, noise: OutputNoise) -> tuple[FloatArray, float]:
    """Whiten rows, and give the log-determinant of the noise covariance."""
    rows = sampling.equalised(rows)
    unequal = 0.0 if sampling.spread is None else 2.0 * float(np.sum(np.log(sampling.spread)))
    if noise.kind == "white":
        return rows / noise.sd_white, 2.0 * rows.shape[1] * math.log(noise.sd_white) + unequal
    white, weight = whiten_rows(
        rows, sampling.time, np.array(noise.as_row()), sampling.interval if sampling.even else 0.0
    )
    return white, unequal - 2.0 * float(np.sum(np.log(weight)))


def innovations(time: FloatArray, residual: FloatArray, noise: OutputNoise) -> FloatArray:
    """Compute one-step prediction errors over their standard deviations: white if the noise model is right."""
    sampling = SampleTimes.of(time, residual)
    out = np.full(residual.shape, np.nan)
    out[sampling.index] = whiten(residual[np.newaxis, sampling.index], sampling, noise)[0][0]
    return out


def log_density(time: FloatArray, residual: FloatArray, noise: OutputNoise) -> float:
    """Compute the Gaussian log-density of a residual."""
    sampling = SampleTimes.of(time, residual)
    return log_density_at(residual[sampling.index], sampling, noise)


def log_density_at(residual: FloatArray, sampling: SampleTimes, noise: OutputNoise) -> float:
    """Compute the Gaussian log-density of a residual (n,) at the readings of ``sampling``."""
    white, log_det = whiten(residual[np.newaxis], sampling, noise)
    return -0.5 * (float(white[0] @ white[0]) + log_det + residual.size * LOG_2PI)


def reading_log_density(time: FloatArray, residual: FloatArray, noise: FloatArray) -> FloatArray:
    """Compute the log-density of every reading given the earlier ones, for many residuals at once."""
    out = np.zeros(residual.shape)
    seen = np.flatnonzero(np.isfinite(residual).any(axis=0))
    white, weight = whiten_rows(residual[:, seen], time[seen], noise)
    out[:, seen] = np.log(weight) - 0.5 * (white**2 + LOG_2PI)
    return out


#: Alternating updates of the white and the correlated variance for each correlation time of a grid.
MULTIPLICATIVE_UPDATES = 40


def _binned_periodogram(
    residual: FloatArray, sampling: SampleTimes, bins: int = 80
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return frequencies in rad a sample, numbers of lines and their mean power; gaps of a residual (n,) are
    interpolated."""
    time, interval, values = sampling.time, sampling.interval, residual
    if not sampling.even:
        values = np.interp(np.arange(time[0], time[-1] + 0.5 * interval, interval), time, residual)
    n = values.size
    power = np.abs(np.fft.rfft(values)) ** 2 / n
    if n % 2 == 0:
        power = power[:-1]
    # The line at zero frequency has half the degrees of freedom of the others.
    weight = np.ones(power.size)
    weight[0] = 0.5
    weight *= residual.size / n
    line = np.arange(power.size)
    edges = np.unique(np.concatenate((np.arange(min(12, power.size)), np.geomspace(12, power.size, bins).astype(int))))
    edges = edges[edges < power.size]
    count = np.add.reduceat(weight, edges)
    angular = 2.0 * np.pi / n * np.add.reduceat(weight * line, edges) / count
    return angular, count, np.add.reduceat(weight * power, edges) / count


@dataclass(frozen=True, eq=False)
class _Spectrum:
    """Periodograms of all recordings, in bins whose width grows with frequency.

    ``angular`` (k,) are mean frequencies in rad a sample, ``count`` (k,) the number of lines, ``observed`` (k,) their
    mean power, and ``interval`` is the time step in s of the first recording."""

    angular: FloatArray
    count: FloatArray
    observed: FloatArray
    interval: float

    @classmethod
    def of(cls, residuals: Sequence[FloatArray], samplings: Sequence[SampleTimes]) -> _Spectrum:
        """Return the spectrum of residuals (n,) of some recordings."""
        pairs = zip(residuals, samplings, strict=True)
        parts = [_binned_periodogram(s.equalised(r), s) for r, s in pairs]
        angular, count, power = (np.concatenate(part) for part in zip(*parts, strict=True))
        return cls(angular, count, power, samplings[0].interval)

    @cached_property
    def cosine(self) -> FloatArray:
        """Cosine of the angle of each line."""
        return np.cos(self.angular)

    def mean(self, lines: NDArray[np.bool_] | None = None) -> float:
        """Compute the mean power of the readings, or of some lines (n,); zero for none."""
        count, observed = (self.count, self.observed) if lines is None else (self.count[lines], self.observed[lines])
        return float(np.sum(count * observed) / (np.sum(count) if lines is None else max(np.sum(count), 1.0)))

    def cost(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Compute Whittle's cost and its gradient (3,), at the logarithms of the two variances and of the time (3,)."""
        white, drift, tau = math.exp(x[0]), math.exp(x[1]), math.exp(x[2])
        phi = math.exp(-self.interval / tau)
        below = 1.0 + phi * phi - 2.0 * phi * self.cosine
        shape = (1.0 - phi * phi) / below
        model = white + drift * shape
        cost = float(np.sum(self.count * (np.log(model) + self.observed / model)))
        slope = self.count * (1.0 / model - self.observed / model**2)
        by_phi = drift * (-2.0 * phi * below - (1.0 - phi * phi) * (2.0 * phi - 2.0 * self.cosine)) / below**2
        gradient = np.array(
            [white * np.sum(slope), drift * np.sum(slope * shape), np.sum(slope * by_phi) * phi * self.interval / tau]
        )
        return cost, gradient


def _maximise_whittle(
    spectrum: _Spectrum, *, floor: float, longest: float, near: float | None
) -> tuple[float, float, float]:
    """Maximise Whittle's likelihood: ``sd_white``, ``sd_ou`` and ``tau`` in s (zero for white noise alone)."""
    total = spectrum.mean()
    if total <= 0.0:
        return max(floor, 1e-12), 0.0, 0.0
    smallest = max(floor**2, 1e-8 * total)
    low = np.array([math.log(smallest), math.log(1e-7 * total), math.log(0.8 * spectrum.interval)])
    high = np.array(
        [
            math.log(max(4.0 * total, 2.0 * smallest)),
            math.log(30.0 * total + 30 * smallest),
            math.log(max(longest, 4.0 * spectrum.interval)),
        ]
    )
    taus = np.geomspace(math.exp(low[2]), math.exp(high[2]), 9)
    if near is not None:
        taus = np.append(taus, np.clip(near, taus[0], taus[-1]))
    begin, cost = _best_of_grid(spectrum, taus, smallest, spectrum.mean(spectrum.angular > 1.0) or total)
    begin = np.clip(begin, low, high)
    found = scipy.optimize.minimize(
        spectrum.cost, begin, jac=True, method="L-BFGS-B", bounds=list(zip(low, high, strict=True)),
        options={"maxiter": 40},
    )  # fmt: skip
    white, drift, tau = np.exp(found.x if found.fun <= cost else begin)
    if drift < 1e-6 * total:
        return math.sqrt(max(total, smallest)), 0.0, 0.0
    return math.sqrt(white), math.sqrt(drift), float(tau)


def _best_of_grid(spectrum: _Spectrum, taus: FloatArray, smallest: float, fast: float) -> tuple[FloatArray, float]:
    """Return the best of a grid of correlation times (k,) in s.

    Logarithms of the variances and the time (3,), and the cost."""
    total, count = spectrum.mean(), spectrum.count
    phis = np.exp(-spectrum.interval / taus)[:, np.newaxis]
    shapes = (1.0 - phis**2) / (1.0 + phis**2 - 2.0 * phis * spectrum.cosine)
    whites = np.full((taus.size, 1), max(min(fast, total), smallest))
    drifts = np.full((taus.size, 1), max(total - fast, 0.02 * total))
    one, power = np.ones((count.size, 1)), count * spectrum.observed
    for step in range(MULTIPLICATIVE_UPDATES):
        inverse = 1.0 / (whites + drifts * shapes)
        push, pull = power * inverse * inverse, count * inverse
        # Multiplicative updates of both variances at once would overshoot.
        if step % 2:
            push, pull = push * shapes, pull * shapes
            drifts = np.maximum(drifts * ((push @ one) / (pull @ one)), 1e-7 * total)
        else:
            whites = np.maximum(whites * ((push @ one) / (pull @ one)), smallest)
    model = whites + drifts * shapes
    costs = np.sum(count * (np.log(model) + spectrum.observed / model), axis=1)
    k = int(np.argmin(costs))
    return np.log([whites[k, 0], drifts[k, 0], taus[k]]), float(costs[k])


#: Longest correlation time of noise, as a share of the longest recording: a longer one means model error.
MAX_CORRELATION_SHARE = 0.02
#: What stands for the noise of an output without readings, which weighs nothing and is not estimated.
UNSEEN = OutputNoise(1.0, white_identified=False)


def is_model_error(noise: OutputNoise, longest: float) -> bool:
    """Tell whether the correlated part of a noise lasts too long, and is too large, to be that of a sensor."""
    # A search limits the correlation time: at its limit it is too long.
    too_long = noise.tau >= (1.0 - 1e-6) * MAX_CORRELATION_SHARE * longest > 0.0
    return too_long and noise.sd_ou > noise.sd_white


def update_output_noise(
    residuals: Sequence[FloatArray],
    samplings: Sequence[SampleTimes],
    *,
    floor: float = 0.0,
    longest: float | None = None,
    start: OutputNoise | None = None,
) -> OutputNoise:
    """Find the noise of one output over several recordings that maximises Whittle's likelihood.

    This is the quick estimate with which a search updates the noise between its steps."""
    if not samplings:
        return UNSEEN
    limit = longest if longest is not None else MAX_CORRELATION_SHARE * max(s.duration for s in samplings)
    near = start.tau if start is not None and start.kind == "ou" else None
    return OutputNoise(*_maximise_whittle(_Spectrum.of(residuals, samplings), floor=floor, longest=limit, near=near))


def estimate_noise(
    times: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
    kind: NoiseKind = "auto",
    guess: OutputNoise | None = None,
    floor: float = 0.0,
) -> OutputNoise:
    """Estimate the noise of one output over several recordings by maximum likelihood."""
    samplings = [SampleTimes.of(t, r) for t, r in zip(times, residuals, strict=True)]
    pairs = [(r[s.index], s) for r, s in zip(residuals, samplings, strict=True) if s.size]
    count = sum(r.size for r, _ in pairs)
    if count == 0:
        return UNSEEN
    rms = math.sqrt(sum(float(r @ r) for r, _ in pairs) / count)
    white = OutputNoise(max(rms, floor, 1e-300))
    longest = max(s.duration for _, s in pairs)
    if kind == "white" or count < 10 or longest <= 0.0 or rms <= floor:
        return white

    def total(noise: OutputNoise) -> float:
        return sum(log_density_at(r, s, noise) for r, s in pairs)

    interval = min(s.interval for _, s in pairs if s.size > 1)
    low = np.log([max(floor, 1e-4 * rms), 1e-4 * rms, 0.2 * interval])
    high = np.log([2.0 * rms, 20.0 * rms, 10.0 * longest])
    first = update_output_noise([r for r, _ in pairs], [s for _, s in pairs], floor=floor, longest=longest, start=guess)
    if first.kind == "white":
        first = OutputNoise(0.7 * rms, 0.7 * rms, 3.0 * interval)
    found = scipy.optimize.minimize(
        lambda x: -total(OutputNoise(*np.exp(np.clip(x, low, high)))), np.clip(np.log(first.as_row()), low, high),
        method="L-BFGS-B", bounds=list(zip(low, high, strict=True)),
        options={"eps": 1e-5, "ftol": 1e-10, "maxiter": 40},
    )  # fmt: skip
    correlated = OutputNoise(*np.exp(np.clip(found.x, low, high)).tolist())
    likelihood = total(correlated)
    if kind == "auto" and 2.0 * (likelihood - total(white)) <= 2.0 * math.log(count):
        return white
    if kind == "auto" and is_model_error(correlated, longest):
        return OutputNoise(white.sd_white, model_error=True)
    new = correlated.sd_ou * math.sqrt(-math.expm1(-2.0 * interval / correlated.tau))
    unseen = OutputNoise(max(0.003 * new, floor), correlated.sd_ou, correlated.tau, white_identified=False)
    return unseen if total(unseen) > likelihood - 1.0 else correlated


def thin_constant_readings(
    time: FloatArray, values: FloatArray, longest: float = 0.5, keep: int = 3, spacing: float = 2.5
) -> NDArray[np.bool_]:
    """Return which readings to keep where a reading is constant for long, because equal readings
    are not independent."""
    use = np.isfinite(values)
    index = np.flatnonzero(use)
    if index.size == 0:
        return use
    seen = values[index]
    edges = np.concatenate(([0], np.flatnonzero(np.diff(seen) != 0.0) + 1, [seen.size]))
    for start, stop in pairwise(edges):
        lasted = float(time[index[stop - 1]] - time[index[start]])
        if lasted > longest:
            number = max(keep, round(lasted / spacing))
            kept = np.round(np.linspace(start, stop - 1, number)).astype(int)
            use[index[start:stop]] = False
            use[index[kept]] = True
    return use


def rounding_error(time: FloatArray, fitted: FloatArray, step: float, zero: float = 0.0) -> OutputNoise:
    """Estimate the rounding error of a signal (n,), as noise: the least noise that an encoder has.

    The error of a signal that crosses many steps between samples is white, with standard deviation ``step / sqrt(12)``.
    That of a slow signal is correlated for as long as the signal takes for a step."""
    error = zero + step * np.round((fitted - zero) / step) - fitted
    return estimate_noise([time], [error], "auto")


@dataclass(frozen=True)
class Encoder:
    """The step of an encoder's counts, and the share of the residual's variance that rounding to them is."""

    step: float
    share: float


@dataclass(frozen=True)
class Sensor:
    """Errors of a sensor."""

    encoder: Encoder | None = None


#: Share of the residual's variance below which quantisation is not reported.
MIN_VARIANCE_SHARE = 1e-3


def describe_sensors(
    outputs: Sequence[str], recordings: Sequence[tuple[FloatArray, FloatArray, FloatArray]]
) -> dict[str, Sensor]:
    """Describe quantisation by output, where there is any; times, readings and fit of each recording."""
    found = {
        output: next((c for t, y, f in recordings if (c := _counts(t, y[:, k], f[:, k]))), None)
        for k, output in enumerate(outputs)
    }
    return {output: Sensor(counts) for output, counts in found.items() if counts is not None}


def _counts(time: FloatArray, readings: FloatArray, fitted: FloatArray) -> Encoder | None:
    """Return the step of quantised readings, and the share of the residual's variance that is rounding; else None."""
    step, squares = quantisation_step(readings) or 0.0, (readings - fitted)[np.isfinite(readings)] ** 2
    variance = float(np.mean(squares)) if squares.size else math.inf
    if step == 0.0 or step**2 / 12.0 < MIN_VARIANCE_SHARE * variance:
        return None
    zero = float(readings[np.flatnonzero(np.isfinite(readings))[0]]) % step
    error = rounding_error(time, fitted, step, zero)
    return Encoder(step, min(1.0, error.sd**2 / max(variance, 1e-300)))

"""Sensor noise and slow model error: white noise plus an Ornstein-Uhlenbeck process, one pair for each output.

The covariance of n samples is ``K + s^2 I`` with ``K_ij = q^2 exp(-|t_i - t_j| / tau)``. The process is Markov, so the
inverse of K is tridiagonal for any sample times (gaps included), and everything here costs O(n): with T = K^-1,
``(K + s^2 I)^-1 = (I - (s^2 T + I)^-1) / s^2`` (Rybicki and Press, 1995, Phys. Rev. Lett. 74, 1060).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpttrf, dpttrs
from scipy.optimize import minimize
from scipy.stats import chi2

from aero_bayes.inference.diagnostics import slow_excess, whiteness

FloatArray = NDArray[np.float64]
NoiseKind = Literal["white", "ou", "auto"]
_LOG_2PI = math.log(2.0 * math.pi)

#: A correlation time above this share of the longest recording is taken for a fault of the model.
STRUCTURED_ABOVE = 0.02
#: Chance, if innovations are white, of a statistic beyond which an error is not taken for this kind of noise.
DESCRIBED_ABOVE = 1e-3


@dataclass(frozen=True)
class NoiseEstimate:
    """Noise of one output: white (``sd_white``) plus Ornstein-Uhlenbeck (``sd_ou``, ``tau`` in s; zero for none).

    ``structured`` marks an error so slow that the model and not the sensor must be at fault. ``held`` marks one that
    this kind of noise does not describe either: its size and correlation time are then those of the residual, and they
    are not searched. ``white_seen`` is False where the data cannot tell white noise from none.
    """

    sd_white: float
    sd_ou: float = 0.0
    tau: float = 0.0
    structured: bool = False
    white_seen: bool = True
    held: bool = False

    @property
    def kind(self) -> Literal["white", "ou"]:
        return "ou" if self.sd_ou > 0.0 else "white"

    @property
    def sd(self) -> float:
        """Standard deviation of the sum."""
        return math.hypot(self.sd_white, self.sd_ou)

    def rho(self, interval: float) -> float:
        """Correlation of two samples ``interval`` seconds apart."""
        if self.sd_ou == 0.0:
            return 0.0
        return (self.sd_ou / self.sd) ** 2 * math.exp(-interval / self.tau)

    @property
    def searched(self) -> tuple[bool, bool, bool]:
        """Which of the three numbers the data determines."""
        if self.held:
            return (False, False, False)
        return (self.white_seen, self.kind == "ou", self.kind == "ou")

    def as_row(self) -> tuple[float, float, float]:
        """The triple that a simulator takes."""
        return (self.sd_white, self.sd_ou, self.tau)


@dataclass(frozen=True)
class NoiseModel:
    """Which noise each output may have; ``auto`` lets BIC choose between white and white plus correlated."""

    default: NoiseKind = "auto"
    outputs: tuple[tuple[str, NoiseKind], ...] = ()

    def kind(self, output: str) -> NoiseKind:
        return dict(self.outputs).get(output, self.default)


class Covariance:
    """The covariance of one output's noise at given times, factored once.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Increasing sample times in s.
    noise : NoiseEstimate
    """

    def __init__(self, time: FloatArray, noise: NoiseEstimate) -> None:
        self._s2 = noise.sd_white**2
        n = time.size
        if noise.sd_ou == 0.0:
            self._factor: tuple[FloatArray, FloatArray] | None = None
            self.log_determinant = n * math.log(self._s2)
            return
        q2, step = noise.sd_ou**2, np.diff(time) / noise.tau
        rho, gain = np.exp(-step), -np.expm1(-2.0 * step)
        diagonal = np.ones(n)
        diagonal[1:] = 1.0 / gain
        diagonal[:-1] += rho**2 / gain
        scale = self._s2 / q2
        pivots, lower, info = dpttrf(1.0 + scale * diagonal, -scale * rho / gain)
        if info != 0:
            raise ArithmeticError("noise covariance is not positive definite")
        self._factor = (pivots, lower)
        self.log_determinant = float(np.sum(np.log(pivots)) + n * math.log(q2) + np.sum(np.log(gain)))

    def solve(self, right: FloatArray) -> FloatArray:
        """Inverse of the covariance times ``right``, shape (n,) or (n, k)."""
        if self._factor is None:
            return right / self._s2
        columns = right.reshape(right.shape[0], -1)
        smooth = dpttrs(*self._factor, columns)[0]
        return np.asarray((columns - smooth) / self._s2).reshape(right.shape)

    def log_density(self, residual: FloatArray) -> float:
        """Log-density of a residual, shape (n,), without gaps."""
        quadratic = float(residual @ self.solve(residual))
        return -0.5 * (quadratic + self.log_determinant + residual.size * _LOG_2PI)


def log_density(time: FloatArray, residual: FloatArray, noise: NoiseEstimate) -> float:
    """Log-density of a residual with gaps (NaN), shape (n,) each; O(n)."""
    seen = np.isfinite(residual)
    return Covariance(time[seen], noise).log_density(residual[seen]) if seen.any() else 0.0


def innovations(time: FloatArray, residual: FloatArray, noise: NoiseEstimate) -> FloatArray:
    """One-step prediction errors over their standard deviations: white if the noise model is right (Kalman filter).

    Returns an array of the residual's shape, NaN where it is NaN.
    """
    s2, q2 = noise.sd_white**2, noise.sd_ou**2
    out = np.full(residual.shape, np.nan)
    mean, variance, before = 0.0, q2, -math.inf
    for k, (t, r) in enumerate(zip(time.tolist(), residual.tolist(), strict=True)):
        if r != r:
            continue
        if q2 > 0.0 and before > -math.inf:
            rho = math.exp(-(t - before) / noise.tau)
            mean, variance = rho * mean, rho * rho * variance + q2 * (1.0 - rho * rho)
        before = t
        total = variance + s2
        error = r - mean
        out[k] = error / math.sqrt(total)
        gain = variance / total
        mean, variance = mean + gain * error, variance * (1.0 - gain)
    return out


def estimate_noise(
    times: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
    kind: NoiseKind = "auto",
    guess: NoiseEstimate | None = None,
    floor: float = 0.0,
) -> NoiseEstimate:
    """Maximum-likelihood noise of one output over several recordings.

    Parameters
    ----------
    times, residuals : sequences of ndarray, shape (n_e,)
        Sample times and residuals of each recording; NaN where there is no reading.
    kind : {"white", "ou", "auto"}
        ``auto`` compares the two by BIC. A correlation time of more than 2 % of the longest recording makes the
        estimate ``structured``; if its innovations are not white either, it is ``held`` at the residual's own size.
    guess : NoiseEstimate, optional
        Where to start (an earlier estimate); saves most of the work.
    floor : float
        Smallest white standard deviation to consider (a sensor's quantum over sqrt(12), for instance).
    """
    pairs = [(t[np.isfinite(r)], r[np.isfinite(r)]) for t, r in zip(times, residuals, strict=True)]
    pairs = [(t, r) for t, r in pairs if t.size]
    count = sum(t.size for t, _ in pairs)
    if count == 0:
        return NoiseEstimate(1.0)
    rms = math.sqrt(sum(float(r @ r) for _, r in pairs) / count)
    white = NoiseEstimate(max(rms, floor, 1e-300))
    longest = max(float(t[-1] - t[0]) for t, _ in pairs)
    if kind == "white" or count < 10 or longest <= 0.0 or rms <= floor:
        return white
    interval = min(float(np.median(np.diff(t))) for t, _ in pairs if t.size > 1)

    def total(noise: NoiseEstimate) -> float:
        return sum(Covariance(t, noise).log_density(r) for t, r in pairs)

    low = np.log([max(floor, 1e-4 * rms), 1e-4 * rms, 0.2 * interval])
    high = np.log([2.0 * rms, 20.0 * rms, 10.0 * longest])

    def objective(x: FloatArray) -> float:
        return -total(_unpack(np.clip(x, low, high)))

    best = _search(objective, low, high, _starts(pairs, rms, interval, longest, guess))
    correlated = _unpack(best)
    likelihood = total(correlated)
    if kind != "ou" and 2.0 * (likelihood - total(white)) <= 2.0 * math.log(count):
        return white
    if correlated.tau > STRUCTURED_ABOVE * longest and correlated.sd_ou > correlated.sd_white:
        if not _described(pairs, correlated):
            return _of_the_residual(pairs, correlated)
        correlated = replace(correlated, structured=True)
    new = correlated.sd_ou * math.sqrt(-math.expm1(-2.0 * interval / correlated.tau))
    unseen = replace(correlated, sd_white=max(0.003 * new, floor), white_seen=False)
    if total(unseen) > likelihood - 1.0:
        return unseen
    return correlated


def _described(pairs: Sequence[tuple[FloatArray, FloatArray]], noise: NoiseEstimate) -> bool:
    """Whether the noise leaves white innovations: Ljung-Box over two ranges of lags, and averages of blocks.

    An error of the model is smoother than this noise (or repeats itself) and leaves its innovations correlated.
    """
    white = [innovations(t, r, noise) for t, r in pairs]
    for lags in (5, 30):
        statistic = sum(lags * whiteness(w, lags)[1] for w in white)
        if chi2.sf(statistic, lags * len(white)) < DESCRIBED_ABOVE:
            return False
    return slow_excess(np.concatenate(white)) < 2.0


def _of_the_residual(pairs: Sequence[tuple[FloatArray, FloatArray]], likely: NoiseEstimate) -> NoiseEstimate:
    """A structured error, described by the size and the correlation time of the residual itself.

    The likelihood of a smooth error sees mostly its increments and would trade a good fit for small ones; its size and
    how long it lasts give each stretch of that length the weight of one reading, and intervals to match.
    """
    count = sum(t.size for t, _ in pairs)
    rms = math.sqrt(sum(float(r @ r) for _, r in pairs) / count)
    lengths = [_correlation_time(t, r) for t, r in pairs if t.size > 10]
    sd_ou = math.sqrt(max(rms**2 - likely.sd_white**2, (0.1 * rms) ** 2))
    return NoiseEstimate(likely.sd_white, sd_ou, max(lengths), structured=True, held=True)


def _correlation_time(time: FloatArray, residual: FloatArray) -> float:
    """Area under the autocorrelation (about zero, not about the mean) up to its first zero, in s."""
    grid = np.linspace(time[0], time[-1], min(4096, 2 * time.size))
    values = np.interp(grid, time, residual)
    spectrum = np.fft.rfft(values, 2 * values.size)
    rho = np.fft.irfft(np.abs(spectrum) ** 2)[: values.size]
    rho = rho / rho[0]
    below = np.flatnonzero(rho <= 0.0)
    return float(np.sum(rho[: below[0] if below.size else rho.size]) * (grid[1] - grid[0]))


def _unpack(x: FloatArray) -> NoiseEstimate:
    white, ou, tau = np.exp(x)
    return NoiseEstimate(float(white), float(ou), float(tau))


def _starts(
    pairs: Sequence[tuple[FloatArray, FloatArray]],
    rms: float,
    interval: float,
    longest: float,
    guess: NoiseEstimate | None,
) -> list[FloatArray]:
    if guess is not None and guess.sd_ou > 0.0 and not guess.held:
        return [np.log(guess.as_row())]
    steps = np.concatenate([np.diff(r) for _, r in pairs if r.size > 1])
    white = min(max(1.4826 * float(np.median(np.abs(steps))) / math.sqrt(2.0), 0.02 * rms), 0.9 * rms)
    taus = np.geomspace(2.0 * interval, 0.2 * longest, 4)
    return [np.log([white, math.sqrt(max(rms**2 - white**2, (0.1 * rms) ** 2)), tau]) for tau in taus]


def _search(
    objective: Callable[[FloatArray], float], low: FloatArray, high: FloatArray, starts: list[FloatArray]
) -> FloatArray:
    inside = [np.clip(x, low + 1e-6, high - 1e-6) for x in starts]
    first = min(inside, key=objective)
    result = minimize(
        objective, first, method="L-BFGS-B", bounds=list(zip(low, high, strict=True)),
        options={"eps": 1e-5, "ftol": 1e-10, "maxiter": 60},
    )  # fmt: skip
    return np.clip(np.asarray(result.x, dtype=np.float64), low, high)


def noise_array(outputs: Sequence[str], noise: Mapping[str, NoiseEstimate]) -> FloatArray:
    """Noise triples of the outputs in the order that a simulator takes them, shape (1, 1, m, 3)."""
    return np.array([[[noise[name].as_row() for name in outputs]]])

"""Sensor noise and slow model error: white noise plus an Ornstein-Uhlenbeck process, one pair for each output.

Everything that weighs a residual stands here: the covariance's factor (:func:`whiten`), its log-determinant, and the
estimate of its three numbers. All of it costs O(n).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from aero_bayes.sensors.innovations import LOG_2PI, whiten_rows
from aero_bayes.sensors.whittle import BinnedPower, maximise_whittle

FloatArray = NDArray[np.float64]
NoiseKind = Literal["white", "ou", "auto"]

#: Longest correlation time of noise, as a share of the longest recording: a longer one means model error.
MAX_CORRELATION_SHARE = 0.02
#: Relative difference of two time steps above which the sampling counts as uneven.
_MAX_STEP_DEVIATION = 1e-3


@dataclass(frozen=True)
class OutputNoise:
    """Noise of one output: white (``sd_white``) plus Ornstein-Uhlenbeck (``sd_ou``, ``tau`` in s; zero for none).

    ``white_seen`` is False where the data cannot tell white noise from none, and where it is one of the parameters.
    ``held`` marks the weight of an error that no noise describes, so that the model must be at fault: its size is the
    residual's own and is not searched.
    """

    sd_white: float
    sd_ou: float = 0.0
    tau: float = 0.0
    white_seen: bool = True
    held: bool = False

    @property
    def kind(self) -> Literal["white", "ou"]:
        return "ou" if self.sd_ou > 0.0 and self.tau > 0.0 else "white"

    @property
    def sd(self) -> float:
        """Standard deviation of a single reading."""
        return math.hypot(self.sd_white, self.sd_ou)

    def rho(self, interval: float) -> float:
        """Correlation of two readings ``interval`` seconds apart."""
        if self.kind == "white":
            return 0.0
        return (self.sd_ou / self.sd) ** 2 * math.exp(-interval / self.tau)

    @property
    def searched(self) -> tuple[bool, bool, bool]:
        """Which of the three numbers the data determines."""
        correlated = self.kind == "ou" and not self.held
        return (self.white_seen and not self.held, correlated, correlated)

    def as_row(self) -> tuple[float, float, float]:
        """The triple that a simulator takes."""
        return (self.sd_white, self.sd_ou, self.tau)


@dataclass(frozen=True)
class NoiseModel:
    """Which noise each output may have, and which the states have.

    Parameters
    ----------
    default : {"auto", "white", "ou"}
        Of outputs that ``outputs`` does not name; ``auto`` lets BIC choose between white and white plus correlated.
    outputs : tuple of (str, kind)
    process : mapping of str to float or "estimated"
        Process noise by state: its diffusion in the state's unit over the square root of a second. Each of these states
        gains ``diffusion dW``, with W a Wiener process of its own; the noise of all readings is then white.
    initial_sd : mapping of str to float
        With process noise, how far a state's initial value may be off the model's own: its standard deviation. Other
        states start as without process noise.

    Examples
    --------
    >>> NoiseModel(process={"v": "estimated"}).kind("position")
    'white'
    """

    default: NoiseKind = "auto"
    outputs: tuple[tuple[str, NoiseKind], ...] = ()
    process: Mapping[str, float | Literal["estimated"]] = field(default_factory=dict)
    initial_sd: Mapping[str, float] = field(default_factory=dict)

    def kind(self, output: str) -> NoiseKind:
        return "white" if self.process else dict(self.outputs).get(output, self.default)


@dataclass(frozen=True, eq=False)
class Sampling:
    """When one output of one recording was read.

    ``index`` are the samples that hold a reading, ``time`` (n,) their times, ``interval`` the median step in s, and
    ``even`` says whether all steps are that.
    """

    index: NDArray[np.int_]
    time: FloatArray
    interval: float
    even: bool

    @classmethod
    def of(cls, time: FloatArray, values: FloatArray) -> Sampling:
        """Sampling of ``values`` (n,), NaN where there is no reading."""
        index = np.flatnonzero(np.isfinite(values))
        seen = time[index]
        if seen.size < 2:
            return cls(index, seen, 1.0, True)
        steps = np.diff(seen)
        interval = float(np.median(steps))
        slack = max(_MAX_STEP_DEVIATION * interval, 1e-9 * abs(float(seen[-1])))
        return cls(index, seen, interval, bool(np.all(np.abs(steps - interval) <= slack)))

    @property
    def size(self) -> int:
        return int(self.index.size)

    @property
    def duration(self) -> float:
        """Time in s from the first to the last reading."""
        return float(self.time[-1] - self.time[0]) if self.size else 0.0


def whiten(rows: FloatArray, sampling: Sampling, noise: OutputNoise) -> tuple[FloatArray, float]:
    """Rows in units of the noise, and the log-determinant of its covariance.

    Parameters
    ----------
    rows : ndarray, shape (k, n)
        At the readings of ``sampling``.
    sampling : Sampling
    noise : OutputNoise

    Returns
    -------
    ndarray, shape (k, n)
        Innovations over their standard deviation: inner products of these rows are those of the given ones under the
        inverse covariance.
    float
        log det C.
    """
    if noise.kind == "white":
        return rows / noise.sd_white, 2.0 * rows.shape[1] * math.log(noise.sd_white)
    white, weight = whiten_rows(
        rows, sampling.time, np.array(noise.as_row()), sampling.interval if sampling.even else 0.0
    )
    return white, -2.0 * float(np.sum(np.log(weight)))


def log_density(time: FloatArray, residual: FloatArray, noise: OutputNoise) -> float:
    """Log-density of a residual with gaps (NaN), shape (n,) each."""
    sampling = Sampling.of(time, residual)
    return _log_density(residual[sampling.index], sampling, noise)


def _log_density(residual: FloatArray, sampling: Sampling, noise: OutputNoise) -> float:
    white, log_det = whiten(residual[np.newaxis], sampling, noise)
    return -0.5 * (float(white[0] @ white[0]) + log_det + residual.size * LOG_2PI)


def innovations(time: FloatArray, residual: FloatArray, noise: OutputNoise) -> FloatArray:
    """One-step prediction errors over their standard deviations: white if the noise model is right.

    Returns an array of the residual's shape, NaN where it is NaN.
    """
    sampling = Sampling.of(time, residual)
    out = np.full(residual.shape, np.nan)
    out[sampling.index] = whiten(residual[np.newaxis, sampling.index], sampling, noise)[0][0]
    return out


def update_output_noise(
    residuals: Sequence[FloatArray],
    samplings: Sequence[Sampling],
    *,
    floor: float = 0.0,
    longest: float | None = None,
    start: OutputNoise | None = None,
) -> OutputNoise:
    """Noise of one output over several recordings by Whittle's likelihood: what a search renews between its steps.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (n_e,)
        Without gaps, at the readings of ``samplings``.
    floor : float
        Least white standard deviation, such as a sensor's quantum over the square root of twelve.
    longest : float, optional
        Greatest correlation time in s; :data:`MAX_CORRELATION_SHARE` of the longest recording by default.
    start : OutputNoise, optional
        Where to begin; tried beside a few standard places.
    """
    powers = [BinnedPower.of(r, s.time, s.interval, s.even) for r, s in zip(residuals, samplings, strict=True)]
    limit = longest if longest is not None else MAX_CORRELATION_SHARE * max(s.duration for s in samplings)
    near = start.tau if start is not None and start.kind == "ou" else None
    return OutputNoise(*maximise_whittle(powers, floor=floor, longest=limit, near=near))


def estimate_noise(
    times: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
    kind: NoiseKind = "auto",
    guess: OutputNoise | None = None,
    floor: float = 0.0,
) -> OutputNoise:
    """Maximum-likelihood noise of one output over several recordings.

    Parameters
    ----------
    times, residuals : sequences of ndarray, shape (n_e,)
        Sample times and residuals of each recording; NaN where there is no reading.
    kind : {"white", "ou", "auto"}
        ``auto`` compares the two by BIC. A part that is correlated for longer than :data:`MAX_CORRELATION_SHARE` of the
        longest recording, and larger than the white part, is model error: the estimate is then ``held`` at the
        residual's root mean square.
    guess : OutputNoise, optional
        Where to start (an earlier estimate).
    floor : float
        Smallest white standard deviation to consider (a sensor's quantum over sqrt(12), for instance).
    """
    samplings = [Sampling.of(t, r) for t, r in zip(times, residuals, strict=True)]
    pairs = [(r[s.index], s) for r, s in zip(residuals, samplings, strict=True) if s.size]
    count = sum(r.size for r, _ in pairs)
    if count == 0:
        return OutputNoise(1.0)
    rms = math.sqrt(sum(float(r @ r) for r, _ in pairs) / count)
    white = OutputNoise(max(rms, floor, 1e-300))
    longest = max(s.duration for _, s in pairs)
    if kind == "white" or count < 10 or longest <= 0.0 or rms <= floor:
        return white

    def total(noise: OutputNoise) -> float:
        return sum(_log_density(r, s, noise) for r, s in pairs)

    interval = min(s.interval for _, s in pairs if s.size > 1)
    low = np.log([max(floor, 1e-4 * rms), 1e-4 * rms, 0.2 * interval])
    high = np.log([2.0 * rms, 20.0 * rms, 10.0 * longest])
    first = update_output_noise([r for r, _ in pairs], [s for _, s in pairs], floor=floor, longest=longest, start=guess)
    if first.kind == "white":
        first = OutputNoise(0.7 * rms, 0.7 * rms, 3.0 * interval)
    found = minimize(
        lambda x: -total(OutputNoise(*np.exp(np.clip(x, low, high)))), np.clip(np.log(first.as_row()), low, high),
        method="L-BFGS-B", bounds=list(zip(low, high, strict=True)),
        options={"eps": 1e-5, "ftol": 1e-10, "maxiter": 40},
    )  # fmt: skip
    correlated = OutputNoise(*np.exp(np.clip(found.x, low, high)).tolist())
    likelihood = total(correlated)
    if kind == "auto" and 2.0 * (likelihood - total(white)) <= 2.0 * math.log(count):
        return white
    if kind == "auto" and correlated.tau > MAX_CORRELATION_SHARE * longest and correlated.sd_ou > correlated.sd_white:
        return OutputNoise(white.sd_white, held=True)
    new = correlated.sd_ou * math.sqrt(-math.expm1(-2.0 * interval / correlated.tau))
    unseen = OutputNoise(max(0.003 * new, floor), correlated.sd_ou, correlated.tau, white_seen=False)
    return unseen if total(unseen) > likelihood - 1.0 else correlated

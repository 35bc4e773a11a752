"""Estimates of the noise of an output from its residuals: Whittle's likelihood, then the exact likelihood."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy  # imports its parts when they are first used

from aero_bayes.arrays import FloatArray
from aero_bayes.sensors.noise import NoiseKind, OutputNoise, SampleTimes
from aero_bayes.sensors.whitening import log_density_at
from aero_bayes.sensors.whittle import BinnedPeriodogram, maximise_whittle

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
    powers = [
        BinnedPeriodogram.of(s.equalised(r), s.time, s.interval, s.even)
        for r, s in zip(residuals, samplings, strict=True)
    ]
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

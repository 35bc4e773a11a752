"""The noise floor of an output, estimated from its readings without a model.

The variance of differences of readings (:mod:`aero_bayes.data.differences`) separates white noise, whose variance does
not depend on the lag, from signals, whose variance grows with the lag. The floor is known if

- by this growth, at least half of the variance of neighbouring readings is noise, - differences of two successive
orders (third and fourth, else fourth and fifth) agree, which they do not for a vibration,
  or a signal that is not smooth between two samples,
- and the inputs do not predict the differences: an output that follows an input which changes at every sample looks
white.

Otherwise the floor is unknown, and the differences give only an upper bound. Feedback of the readings to an input also
makes inputs predict the differences, so that the floor is unknown. A signal that is as fast as the sampling, and whose
cause was not recorded, cannot be separated from noise.

Correlated noise is accepted where the inputs are constant, and only if the variance stops growing before the signal
dominates. For a correlation time of 3 to 10 samples and a signal with a time scale of a hundred samples, the estimate
is right within 30 %. Slower or weaker correlation looks like a drift or a signal and is missed. The floor is then the
white part. Ripple is no noise: it is excluded if the sample rate resolves it, and counts as white
otherwise. Constant quantised readings have no information. The floor is then the step over sqrt(12).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.differences import Differences, NoiseVariances
from aero_bayes.data.recording import Recording

#: Orders of differences. The estimates of two successive orders must agree.
DIFFERENCE_ORDERS = (3, 4, 5)
#: Smallest share of the differences' variance that is noise, and largest share that the inputs explain.
MIN_NOISE_SHARE, MAX_EXPLAINED_SHARE = 0.5, 0.25
#: Largest difference of the logarithms of the standard deviations of two orders.
MAX_LOG_DISAGREEMENT = 0.1
#: Smallest number of differences: with fewer the standard deviation is uncertain by more than a quarter.
MIN_DIFFERENCES = 36


@dataclass(frozen=True)
class NoiseFloor:
    """Noise of one output."""

    sd: float | None
    at_most: float
    white: float
    slow: float
    slow_time: float
    correlation: float
    quantum: float | None
    readings: int

    def to_dict(self) -> dict[str, float | int | None]:
        """Return plain values."""
        return asdict(self)


def noise_floor(values: FloatArray, time: FloatArray, inputs: Sequence[FloatArray] = ()) -> NoiseFloor:
    """Estimate the noise of readings."""
    quantum, readings = quantisation_step(values), int(np.isfinite(values).sum())
    least = 0.0 if quantum is None else quantum / math.sqrt(12.0)
    found = _noise(Differences(values, time, inputs))
    if found is None:
        found = float(np.nanstd(values)) if readings else 0.0
    if not isinstance(found, NoiseVariances) and found > least:
        return NoiseFloor(None, found, 0.0, 0.0, 0.0, 0.0, quantum, readings)
    total = math.sqrt(found.white + found.slow) if isinstance(found, NoiseVariances) else least
    if not isinstance(found, NoiseVariances) or total <= least or found.slow == 0.0:
        total = max(total, least)
        return NoiseFloor(total, total, total, 0.0, 0.0, 0.0, quantum, readings)
    shared = found.slow * math.exp(-1.0 / found.memory) / total**2
    memory = found.memory * float(np.median(np.diff(time)))
    return NoiseFloor(total, total, math.sqrt(found.white), math.sqrt(found.slow), memory, shared, quantum, readings)


def _noise(differences: Differences) -> NoiseVariances | float | None:
    """Return the noise if it is known, else an upper bound; None without differences."""
    lower: NoiseVariances | None = None
    most: float | None = None
    for order in DIFFERENCE_ORDERS:
        found = differences.noise_variances(order)
        if found is None:
            break
        most = min(math.sqrt(found.whole), most if most is not None else math.inf)
        if found.whole == 0.0:
            return found
        if lower is not None and _agree(lower, found):
            return lower if differences.explained(order - 1) <= MAX_EXPLAINED_SHARE else most
        lower = found
    return most


def _agree(one: NoiseVariances, other: NoiseVariances) -> bool:
    """Return whether differences of two orders are mostly noise, and agree."""
    if (
        min(one.windows, other.windows) < MIN_DIFFERENCES
        or min(one.near / one.whole, other.near / other.whole) < MIN_NOISE_SHARE
    ):
        return False
    return abs(0.5 * math.log(one.near / other.near)) < MAX_LOG_DISAGREEMENT + 1.0 / math.sqrt(one.windows)


def output_noise_floor(recording: Recording, output: str) -> NoiseFloor:
    """Estimate the noise floor of an output of a recording, from its readings and the inputs."""
    return noise_floor(recording.outputs[output], recording.time, list(recording.inputs.values()))


def noise_floors(recordings: Sequence[Recording], outputs: Sequence[str]) -> dict[tuple[str, str], float]:
    """Estimate noise floors by recording and output. There is no entry for an unknown one."""
    floors = {}
    for recording in recordings:
        for output in outputs:
            if output in recording.outputs and (sd := output_noise_floor(recording, output).sd) is not None:
                floors[recording.name, output] = sd
    return floors


def quantisation_step(values: FloatArray) -> float | None:
    """Step of quantised readings, None where they are continuous.

    A step q is accepted if the distinct values are within q / 10 of its multiples, so that a rounding print format does
    not matter."""
    seen = values[np.isfinite(values)]
    if seen.size < 10:
        return None
    distinct = np.unique(seen)
    scale = float(np.abs(distinct).max()) or 1.0
    distinct = distinct[np.concatenate(([True], np.diff(distinct) > 1e-9 * scale))]
    still = float(np.mean(np.diff(seen) == 0.0)) > 0.2
    if distinct.size < 2 or not (still or distinct.size <= seen.size / 5):
        return None
    gaps = np.diff(distinct)
    step = float(np.quantile(gaps, 0.1))
    step = float(np.median(gaps[gaps < 1.5 * step]))
    raised = distinct - distinct[0]
    # The first estimate is accurate for a few multiples only; each pass covers twice as many.
    for reach in 2 ** np.arange(2, 64):
        part = raised[: min(int(reach), raised.size)]
        counts = np.rint(part / step)
        if counts[-1] < 1:
            return None
        step = float((part @ counts) / (counts @ counts))
        if reach >= raised.size:
            break
    off = np.abs(raised / step - np.rint(raised / step))
    return step if float(np.quantile(off, 0.95)) < 0.1 else None

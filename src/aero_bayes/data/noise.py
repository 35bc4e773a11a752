"""The noise floor of an output from its readings alone: no model, no fit.

The variance of differences of readings (:mod:`aero_bayes.data.differences`) tells white noise, which is constant over
their lag, from what grows with it. A floor is known where

- at least half of the variance at neighbouring readings is noise by that growth,
- differences of two successive orders (third and fourth, else fourth and fifth) say the same, which a vibration or a
  signal with a curve between two samples does not let them,
- and the inputs do not tell the differences in advance: an output that follows an input which changes at every sample
  looks white.

Elsewhere it is unknown, and the size of the differences only says what it is at most. Feedback of the readings to an
input looks like the latter, so that it hides the floor as well. A signal as fast as the samples whose cause was not
recorded cannot be told from noise by anybody.

Noise with memory is believed where the inputs rest, and only if the variance stops growing while the signal does not
show yet: for a correlation time of 3 to 10 samples under a signal of a hundred samples, its size is right within 30 %.
Slower or weaker memory looks like a drift or like the signal and is missed: the floor is then the white part. A ripple
is not noise here: it is left out where the sample rate resolves it (see :mod:`aero_bayes.data.ripple`) and counts as
white where it does not. A quantised reading that stands still says nothing: the floor is then the quantum over
sqrt(12).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from aero_bayes.data.differences import Differences, NoiseVariances
from aero_bayes.data.recording import Recording

FloatArray = NDArray[np.float64]
#: Orders of differences; the estimates of two successive orders must agree.
DIFFERENCE_ORDERS = (3, 4, 5)
#: Smallest share of the differences' variance that is noise, and largest share that the inputs explain.
MIN_NOISE_SHARE, MAX_EXPLAINED_SHARE = 0.5, 0.25
#: Largest difference of the logarithms of the standard deviations of two orders.
MAX_LOG_DISAGREEMENT = 0.1
#: Smallest number of differences: with fewer the standard deviation is uncertain by more than a quarter.
MIN_DIFFERENCES = 36


@dataclass(frozen=True)
class NoiseFloor:
    """Noise of one output.

    Parameters
    ----------
    sd : float or None
        Standard deviation of all of it, never below ``quantum / sqrt(12)``; None where noise and signal cannot be told
        apart.
    at_most : float
        The same where it is known, else the size of the readings' differences.
    white, slow : float
        Its white part, and the part with memory; 0 where it is unknown.
    slow_time : float
        Correlation time of the slow part in s, 0 where there is none.
    correlation : float
        Correlation of the noise of neighbouring readings.
    quantum : float or None
        Step of the readings where they are quantised.
    readings : int
        How many there were.
    """

    sd: float | None
    at_most: float
    white: float
    slow: float
    slow_time: float
    correlation: float
    quantum: float | None
    readings: int

    def to_dict(self) -> dict[str, float | int | None]:
        """Plain values."""
        return asdict(self)


def noise_floor(values: FloatArray, time: FloatArray, inputs: Sequence[FloatArray] = ()) -> NoiseFloor:
    """Estimate the noise of readings.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Readings (or residuals), NaN in gaps.
    time : ndarray, shape (n,)
        Increasing times in s; they need not be even.
    inputs : sequence of ndarray, shape (n,)
        What was applied. What follows a jump, for as long as enough is left elsewhere, is not used: the transients of
        current and speed are no noise. What inputs explain is none either.

    Returns
    -------
    NoiseFloor
    """
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
    """The noise where it is known; else how large it is at most, None where there are no differences to say so."""
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
    """Whether differences of two orders are mostly noise, and of the same size."""
    if (
        min(one.windows, other.windows) < MIN_DIFFERENCES
        or min(one.near / one.whole, other.near / other.whole) < MIN_NOISE_SHARE
    ):
        return False
    return abs(0.5 * math.log(one.near / other.near)) < MAX_LOG_DISAGREEMENT + 1.0 / math.sqrt(one.windows)


def output_noise_floor(recording: Recording, output: str) -> NoiseFloor:
    """Noise of an output of a recording, from its readings and what was applied."""
    return noise_floor(recording.outputs[output], recording.time, list(recording.inputs.values()))


def noise_floors(recordings: Sequence[Recording], outputs: Sequence[str]) -> dict[tuple[str, str], float]:
    """Noise floors by recording and output, from readings alone; where one is unknown there is no entry."""
    floors = {}
    for recording in recordings:
        for output in outputs:
            if output in recording.outputs and (sd := output_noise_floor(recording, output).sd) is not None:
                floors[recording.name, output] = sd
    return floors


def quantisation_step(values: FloatArray) -> float | None:
    """Step of quantised readings, None where they are continuous.

    Robust against a print format that rounds: a step q counts if the distinct values lie within q / 10 of its
    multiples.
    Needs at least two distinct values, and five readings a value or one in five that is the one before.
    """
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
    # The first guess is only good for a few multiples; each pass reaches twice as far.
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

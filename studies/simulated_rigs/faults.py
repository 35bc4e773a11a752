"""Faults of data, solver and noise that recordings of a simulated rig are given, one at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import exp, log, pi, sqrt
from typing import Any

import numpy as np
from numpy.random import Generator

from aero_bayes.arrays import FloatArray
from aero_bayes.data import Recording
from simulated_rigs.trial import RigTrial

#: Each kind of fault, with the cause that a diagnosis has to name.
FAULTS: Mapping[str, str] = {
    "impossible": "data", "outliers": "data", "stuck": "data", "clipped": "data", "gap": "data", "wrapped": "data",
    "sign": "data", "swapped": "data", "ahead": "data", "clock": "data", "rounded": "noise", "relative": "noise",
    "heavy_tails": "noise", "unlike": "noise", "solver": "solver",
}  # fmt: skip
#: Share of the readings that are outliers, and their sizes in standard deviations of the noise.
OUTLIER_SHARE, OUTLIER_SIZES = 0.03, (15.0, 40.0)
#: Share of a recording in which a sensor is stuck or the logger has a gap.
LOST_SHARE = (0.03, 0.1)
#: Share of the readings beyond the end of a sensor that clips.
CLIPPED_SHARE = (0.03, 0.1)
#: Steps of a coarse count in standard deviations of the noise.
COUNTS = (4.0, 12.0)
#: Least ratio of the largest to the smallest readings (quantiles) of an output whose relative noise can be seen.
MIN_READING_RATIO = 3.0
#: Samples by which an output is ahead, share by which its clock is off, and what either moves readings by at least, in
#: standard deviations of the noise.
AHEAD, RATE, MIN_MOVED = (1, 4), (2e-3, 2e-2), 3.0
#: Standard deviation of the noise in a second recording over that in the first.
UNLIKE = (4.0, 20.0)
#: Relative and absolute tolerances of a solver that is too coarse.
TOLERANCES = (1e-2, 0.3)


@dataclass(frozen=True)
class Faulty:
    """What the program is given: recordings, and the tolerance of the solver; ``output`` has the fault, if one has."""

    recording: Recording
    output: str = ""
    tolerance: float | None = None
    second: Recording | None = None


def with_fault(trial: RigTrial, fault: str, rng: Generator) -> Faulty | None:
    """Give a rig whose model is complete one of :data:`FAULTS`; None where the fault makes no sense for this rig.

    ``rng`` draws where and how large.
    """
    right = Faulty(trial.train)
    if fault == "solver":
        return replace(right, tolerance=exp(rng.uniform(*np.log(TOLERANCES))))
    if fault == "gap":
        cut = _with_gap(trial.train, rng)
        return replace(right, recording=cut) if cut is not None else None
    if fault in ("sign", "swapped"):
        channels = _other_channels(trial.train, fault, rng)
        return replace(right, recording=channels) if channels is not None else None
    names = list(trial.train.outputs)
    if fault == "unlike":
        factor = exp(rng.uniform(*np.log(UNLIKE)))
        return Faulty(
            replace(trial.train, outputs=_white(trial, rng), sha256=""), names[0],
            second=replace(trial.test, outputs=_white(trial, rng, "test", factor), sha256=""),
        )  # fmt: skip
    for name in [names[int(k)] for k in rng.permutation(len(names))]:
        readings = _readings(trial, fault, name, rng)
        if readings is not None:
            outputs = {**trial.train.outputs, name: readings}
            if FAULTS[fault] == "noise":
                # The other outputs have white noise, so that there is one fault only.
                outputs = {**_white(trial, rng), name: readings}
            return Faulty(replace(trial.train, outputs=outputs, sha256=""), name)
    return None


def _readings(trial: RigTrial, fault: str, name: str, rng: Generator) -> FloatArray | None:
    """Return the readings of an output with a fault; None where it makes no sense."""
    seen, clean = trial.train.outputs[name].copy(), trial.noise_free["train"].outputs[name]
    sd = trial.noise[name].white
    if fault == "impossible":
        seen[rng.choice(seen.size, 3, replace=False)] = -999.0
    elif fault == "outliers":
        rows = rng.choice(seen.size, round(OUTLIER_SHARE * seen.size), replace=False)
        seen[rows] += sd * rng.uniform(*OUTLIER_SIZES, rows.size) * rng.choice([-1.0, 1.0], rows.size)
    elif fault == "stuck":
        first, last = _stretch(seen.size, rng)
        seen[first:last] = seen[first]
    elif fault == "clipped":
        share = rng.uniform(*CLIPPED_SHARE)
        upper = rng.random() < 0.5
        seen = np.minimum(seen, np.quantile(seen, 1.0 - share)) if upper else np.maximum(seen, np.quantile(seen, share))
    elif fault == "wrapped":
        if trial.train.units[name] != "rad" or seen.min() >= 0.0:
            return None
        seen %= 2.0 * pi
    elif fault in ("ahead", "clock"):
        row = np.arange(seen.size, dtype=float)
        rate = exp(rng.uniform(*np.log(RATE))) * rng.choice([-1.0, 1.0])
        at = row + rng.integers(*AHEAD, endpoint=True) if fault == "ahead" else row * (1.0 + rate)
        moved = np.interp(at, row, clean)
        if float(np.sqrt(np.mean((moved - clean) ** 2))) < MIN_MOVED * sd:
            return None
        return np.asarray(moved + sd * rng.standard_normal(seen.size))
    else:
        return _with_noise(fault, clean, sd, rng)
    return seen


def _other_channels(recording: Recording, fault: str, rng: Generator) -> Recording | None:
    """Return the recording with the sign of a channel turned, or two of one unit exchanged; None where none can be."""
    for side in ("inputs", "outputs") if rng.random() < 0.5 else ("outputs", "inputs"):
        columns = dict(getattr(recording, side))
        names = [n for n in columns if recording.units[n] != "K"]
        pairs = [(a, b) for a in columns for b in columns if a < b and recording.units[a] == recording.units[b]]
        if fault == "sign" and names:
            name = str(rng.choice(names))
            columns[name] = -columns[name]
        elif fault == "swapped" and pairs:
            a, b = pairs[int(rng.integers(len(pairs)))]
            columns[a], columns[b] = columns[b], columns[a]
        else:
            continue
        new: dict[str, Any] = {side: columns}
        return replace(recording, **new, sha256="")
    return None


def _with_noise(fault: str, clean: FloatArray, sd: float, rng: Generator) -> FloatArray | None:
    """Draw readings with a noise that is not white and normal."""
    normal = rng.standard_normal(clean.size)
    if fault == "rounded":
        step = sd * exp(rng.uniform(*np.log(COUNTS)))
        return np.asarray(step * np.round((clean + sd * normal) / step))
    if fault == "heavy_tails":
        return np.asarray(clean + sd / sqrt(3.0) * rng.standard_t(3.0, clean.size))
    low, high = np.quantile(np.abs(clean), [0.1, 0.9])
    if high < MIN_READING_RATIO * low:
        return None
    size = np.abs(clean) / sqrt(float(np.mean(clean**2)))
    return np.asarray(clean + sd * (0.2 + size) * normal)


def _white(trial: RigTrial, rng: Generator, run: str = "train", factor: float = 1.0) -> dict[str, FloatArray]:
    return {
        name: values + factor * trial.noise[name].white * rng.standard_normal(values.size)
        for name, values in trial.noise_free[run].outputs.items()
    }


def _stretch(rows: int, rng: Generator) -> tuple[int, int]:
    """Draw the first row of a stretch and the row after it, away from both ends."""
    length = round(rows * exp(rng.uniform(log(LOST_SHARE[0]), log(LOST_SHARE[1]))))
    first = int(rng.integers(rows // 10, rows - rows // 10 - length))
    return first, first + length


def _with_gap(recording: Recording, rng: Generator) -> Recording | None:
    """Return the recording without a stretch in which an input changed."""
    for _ in range(20):
        first, last = _stretch(recording.rows, rng)
        if any(np.ptp(values[first:last]) > 0.0 for values in recording.inputs.values()):
            keep = np.ones(recording.rows, dtype=bool)
            keep[first:last] = False
            return recording.rows_where(keep, recording.name)
    return None

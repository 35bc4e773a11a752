"""Ripple that is locked to the angle of a rotor: detected by its evidence, and kept out of the noise.

Within a short segment of a recording, the ripple of order k is ``a cos(k phi) + b sin(k phi)``. The angle phi of the
rotor is the integral of its speed; a and b differ between segments, because that integral drifts. For each order, a and
b have a Gaussian prior with zero mean. Its variance maximises the evidence, which has a closed form (MacKay, 1992,
Neural Computation 4, 415). For noise alone the variance is zero. The posterior mean of the ripple is subtracted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy  # imports its parts when they are first used
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.data.ripple import MIN_ROTOR_SPEED, SEGMENT_LENGTH
from aero_bayes.sensors.noise import NoiseKind, OutputNoise, SampleTimes
from aero_bayes.sensors.noise_estimation import estimate_noise
from aero_bayes.sensors.whitening import whiten

#: Least number of ripple periods in a segment: slower ripple may be slow physics.
MIN_PERIODS = 3.0
#: Log-evidence, less half the logarithm of the number of segments, above which an order is accepted.
MIN_LOG_EVIDENCE = 5.0
#: Number of alternating estimates of noise and ripple.
ALTERNATIONS = 3


@dataclass(frozen=True)
class RippleOrder:
    """Ripple of one order (periods a turn).

    ``amplitude`` is the root mean square of its amplitudes. ``law`` says whether the amplitude is constant (``even``)
    or proportional to the speed (``with speed``)."""

    order: int
    amplitude: float
    law: str
    log_evidence: float


@dataclass(frozen=True, eq=False)
class Ripple:
    """Ripple of one output of one recording.

    ``orders`` are those that were accepted, ``values`` (n,) is their sum at the sample times. ``noise`` is the noise
    without the ripple, ``noise_with`` the estimate if the ripple is not subtracted."""

    orders: tuple[RippleOrder, ...]
    values: FloatArray
    noise: OutputNoise
    noise_with: OutputNoise

    def to_dict(self) -> dict[str, object]:
        """Return it as it goes into result.json."""
        return {
            "orders": {
                str(o.order): {"amplitude": o.amplitude, "law": o.law, "log_evidence": o.log_evidence}
                for o in self.orders
            },
            "noise_sd": self.noise.sd,
            "noise_sd_with_ripple": self.noise_with.sd,
        }


@dataclass(frozen=True, eq=False)
class _Segment:
    """One segment, with its cosine and sine columns (n, 2) by order and law; without orders that alias to low
    frequencies.
    """

    part: slice
    seen: NDArray[np.bool_]
    columns: dict[tuple[int, str], FloatArray]


def find_ripple(
    time: FloatArray,
    residual: FloatArray,
    speed: FloatArray,
    orders: Sequence[int] = (1, 2),
    kind: NoiseKind = "auto",
) -> Ripple:
    """Look for ripple in a residual."""
    with_ripple = noise = estimate_noise([time], [residual], kind)
    segments = _segments(time, residual, speed, orders)
    values = np.zeros(time.size)
    found: tuple[RippleOrder, ...] = ()
    for _ in range(ALTERNATIONS):
        found, new = _estimate(segments, time, residual, noise, orders)
        unchanged = bool(np.max(np.abs(new - values), initial=0.0) < 1e-3 * noise.sd)
        values = new
        if not found or unchanged:
            break
        noise = estimate_noise([time], [residual - values], kind, noise if noise.sd_ou > 0.0 else None)
    return Ripple(found, values, noise if found else with_ripple, with_ripple)


def find_ripples(
    time: FloatArray, readings: FloatArray, fitted: FloatArray, outputs: Sequence[str], units: Sequence[str]
) -> dict[str, Ripple]:
    """Find the ripple of every output of one recording, by output; empty if no speed of a rotor was recorded."""
    speeds = [k for k, unit in enumerate(units) if is_rotor_speed(readings[:, k], unit)]
    if not speeds:
        return {}
    fastest = max(speeds, key=lambda k: float(np.nanmax(np.abs(readings[:, k]))))
    seen = np.isfinite(readings[:, fastest])
    # The measured speed: its noise averages out in the angle, the error of a fitted speed would not.
    speed = np.interp(time, time[seen], readings[seen, fastest])
    found = {}
    for k, output in enumerate(outputs):
        residual = readings[:, k] - fitted[:, k]
        if np.isfinite(residual).sum() < 200 or units[k] == "rad":
            continue
        ripple = find_ripple(time, residual, speed)
        if ripple.orders:
            found[output] = ripple
    return found


def is_rotor_speed(readings: FloatArray, unit: str) -> bool:
    """Return whether readings (n,) are the speed of a rotor, fast enough to separate its ripple from other motion."""
    seen = readings[np.isfinite(readings)]
    return unit == "rad/s" and seen.size > 100 and float(np.max(np.abs(seen))) >= MIN_ROTOR_SPEED


def _segments(time: FloatArray, residual: FloatArray, speed: FloatArray, orders: Sequence[int]) -> list[_Segment]:
    step = np.diff(time)
    angle = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * step)))
    edges = np.searchsorted(time, np.arange(time[0], time[-1] + SEGMENT_LENGTH, SEGMENT_LENGTH))
    edges[-1] = time.size
    size = np.abs(speed) / max(float(np.max(np.abs(speed))), 1e-300)
    segments = []
    for first, last in pairwise(edges.tolist()):
        part = slice(first, last)
        seen = np.isfinite(residual[part])
        if seen.sum() < 12:
            continue
        interval = float(np.median(np.diff(time[part])))
        columns = {}
        for order in orders:
            cycles = order * np.abs(speed[part]) * interval / (2.0 * np.pi)
            periods = np.abs(cycles - np.round(cycles)) * (last - first)
            phase = order * angle[part][seen]
            waves = np.stack([np.cos(phase), np.sin(phase)], axis=1)
            if float(np.min(periods)) >= MIN_PERIODS:
                columns[order, "even"] = waves
            if float(np.median(periods)) >= MIN_PERIODS:
                columns[order, "with speed"] = waves * size[part][seen, None]
        if columns:
            segments.append(_Segment(part, seen, columns))
    return segments


def _estimate(
    segments: list[_Segment], time: FloatArray, residual: FloatArray, noise: OutputNoise, orders: Sequence[int]
) -> tuple[tuple[RippleOrder, ...], FloatArray]:
    """Find orders whose evidence is high enough, and the posterior mean of their sum, (n,)."""
    values = np.zeros(time.size)
    found = []
    for order in orders:
        forms = [_form(segments, (order, law), time, residual - values, noise) for law in ("even", "with speed")]
        best = max((f for f in forms if f is not None), key=lambda f: f[0].log_evidence, default=None)
        if best is not None and best[0].log_evidence > MIN_LOG_EVIDENCE:
            found.append(best[0])
            values = values + best[1]
    return tuple(found), values


def _form(
    segments: list[_Segment], key: tuple[int, str], time: FloatArray, residual: FloatArray, noise: OutputNoise
) -> tuple[RippleOrder, FloatArray] | None:
    """Compute the evidence and posterior mean of one order under one law of its amplitude."""
    own = [p for p in segments if key in p.columns]
    if not own:
        return None
    terms = []
    for segment in own:
        sampling = SampleTimes.of(time[segment.part], residual[segment.part])
        rows = np.vstack([segment.columns[key].T, residual[segment.part][segment.seen]])
        white, _ = whiten(rows, sampling, noise)
        terms.append((white[:2] @ white[:2].T, white[:2] @ white[2]))
    variance, gain = _best_variance(terms)
    values, squares, count = np.zeros(time.size), 0.0, 0
    for segment, (gram, score) in zip(own, terms, strict=True):
        mean = np.linalg.solve(gram + np.eye(2) / variance, score)
        values[segment.part][segment.seen] += segment.columns[key] @ mean
        squares += 2.0 * variance * float(np.sum(segment.columns[key] ** 2))
        count += len(segment.columns[key])
    return RippleOrder(key[0], math.sqrt(squares / count), key[1], gain - 0.5 * math.log(len(terms))), values


def _best_variance(terms: list[tuple[FloatArray, FloatArray]]) -> tuple[float, float]:
    """Find the prior variance of a and b that maximises the evidence, and the log-evidence over that of no ripple."""
    grams, scores = np.array([g for g, _ in terms]), np.array([s for _, s in terms])
    eigenvalues, vectors = np.linalg.eigh(grams)
    squares = np.einsum("kij,ki->kj", vectors, scores) ** 2

    def loss(log_variance: float) -> float:
        scaled = math.exp(log_variance) * eigenvalues
        return float(-0.5 * np.sum(squares * math.exp(log_variance) / (1.0 + scaled) - np.log1p(scaled)))

    information = float(np.median(eigenvalues))
    low, high = math.log(1e-4 / information), math.log(1e8 / information)
    result = scipy.optimize.minimize_scalar(loss, bounds=(low, high), method="bounded", options={"xatol": 1e-3})
    return math.exp(float(result.x)), -float(result.fun)

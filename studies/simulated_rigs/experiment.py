"""One experiment with a rig, and how much of a law it shows: what no change of the base parameters and initial states
can imitate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, isfinite, log, sqrt

import numpy as np
from numpy.random import Generator
from scipy.signal import lfilter

from aero_bayes.arrays import FloatArray
from simulated_rigs.laws import Scale
from simulated_rigs.rig import RigKind
from simulated_rigs.sensors import SensorNoise
from simulated_rigs.truth import LawPlace, LawTruth, law_kind, simulate_rig

#: Refinements of the base model's fit to the law's response, and the gain in d below which they end.
MAX_REFINEMENTS, MIN_RELATIVE_GAIN = 8, 5e-3
#: Outputs, in units of their noise, of a rig that a law made unstable.
MAX_STABLE_OUTPUT = 1e6
#: How close to the distance that was asked for is close enough.
DISTANCE_TOLERANCE = 0.15


def arma_innovations(values: FloatArray, noise: SensorNoise, step: float) -> FloatArray:
    """Whiten values, shape (n, ...), of white noise plus an Ornstein-Uhlenbeck process, to unit variance.

    Sampled evenly (``step`` s) their sum is an ARMA(1, 1) process: (1 - a B) y = s (1 - b B) e, whose b and s follow
    from the autocovariance of the left side.
    """
    if not noise.slow:
        return values / noise.white
    a = exp(-step / noise.slow_time)
    level = noise.white**2 * (1.0 + a * a) + noise.slow**2 * (1.0 - a * a)
    cross = a * noise.white**2
    ratio = level / cross
    b = 2.0 / (ratio + sqrt(ratio * ratio - 4.0))
    scale = sqrt(cross / b)
    # The first reading has the stationary variance; later ones the innovation's.
    first = sqrt(noise.white**2 + noise.slow**2)
    white: FloatArray = lfilter([1.0, -a], [1.0, -b], values, axis=0) / scale
    white[0] *= scale / first
    return white


@dataclass(frozen=True)
class RigExperiment:
    """One experiment with a rig, and what changes of the base parameters and initial states do to it.

    ``parameters`` and ``start`` are the true ones; ``time`` has shape (n,), ``commands`` (n, inputs); ``clean`` are
    outputs and states without laws and noise.
    """

    kind: RigKind
    parameters: Mapping[str, float]
    start: tuple[float, ...]
    time: FloatArray
    commands: FloatArray
    noise: Mapping[str, SensorNoise]
    clean: tuple[FloatArray, FloatArray]

    def outputs(self, laws: Sequence[LawTruth], change: FloatArray | None = None) -> FloatArray:
        """Simulate outputs, shape (n, outputs), after changes of the free parameters and of the start.

        ``change`` holds changes of the parameters' logarithms, then of the initial states in units of their sizes.
        """
        values, start = dict(self.parameters), list(self.start)
        if change is not None:
            for name, factor in zip(self.kind.free, change, strict=False):
                values[name] *= exp(float(factor))
            sizes = [balance.size for balance in self.kind.states.values()]
            for k, shift in enumerate(change[len(self.kind.free) :]):
                start[k] += float(shift) * sizes[k]
        return simulate_rig(self.kind, values, laws, self.time, self.commands, start)[0]

    def white(self, outputs: FloatArray) -> FloatArray:
        """Whiten outputs, shape (n, outputs), by the noise; shape (n * outputs,)."""
        columns = [
            arma_innovations(outputs[:, k], self.noise[name], self.kind.step)
            for k, name in enumerate(self.kind.outputs)
        ]
        return np.concatenate(columns)

    @cached_property
    def sensitivities(self) -> FloatArray:
        """Derivatives of the whitened outputs, shape (n * outputs, free + states), by central differences."""
        count, h = len(self.kind.free) + len(self.start), 1e-4
        return np.column_stack(
            [
                self.white(self.outputs([], change) - self.outputs([], -change)) / (2.0 * h)
                for change in h * np.eye(count)
            ]
        )

    def distance(self, laws: Sequence[LawTruth], known: Sequence[LawTruth]) -> float:
        """Compute the distance of the rig with ``laws`` from every model that has only those ``known``.

        The model is refitted with its sensitivities until nothing more is gained, which is right to a few per cent
        where a law is large. NaN for a rig that the laws make unstable.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            there = self.white(self.outputs(laws))
        if not np.isfinite(there).all() or np.abs(there).max() > MAX_STABLE_OUTPUT:
            return float("nan")
        basis = self.sensitivities
        inverse = np.linalg.pinv(basis, rcond=1e-9)
        change = np.zeros(basis.shape[1])
        best, before = np.inf, np.inf
        for _ in range(MAX_REFINEMENTS):
            gap = there - self.white(self.outputs(known, change))
            whole, step = float(np.linalg.norm(gap)), inverse @ gap
            if not whole < before:
                break
            left = float(np.linalg.norm(gap - basis @ step))
            done = left > (1.0 - MIN_RELATIVE_GAIN) * best
            best, before = min(best, left), whole
            if done:
                break
            change = np.clip(change + step, -1.5, 1.5)
        return best

    def scale(self, place: LawPlace) -> Scale:
        """Measure what happens at a place without laws."""
        kind, names, (outputs, states) = self.kind, list(self.kind.states), self.clean
        if place.kind == "input":
            values = self.commands[:, list(kind.inputs).index(place.name)]
        elif place.kind == "output":
            values = outputs[:, list(kind.outputs).index(place.name)]
        else:
            values = states[:, names.index(place.name)]
        # A held signal jumps; what counts is how fast the rig answers it.
        answer = outputs[:, 0] if place.kind == "input" else values
        effort = position = farthest = difference = 0.0
        if place.kind == "balance":
            index, balance = names.index(place.name), kind.states[place.name]
            effort = kind.plant(kind.parameters).capacity[index] * float(np.std(np.gradient(values, self.time)))
            if balance.position:
                travel = states[:, names.index(balance.position)]
                position, farthest = float(np.std(travel)), float(np.abs(travel).max())
            if balance.neighbour:
                difference = float(np.std(values - states[:, names.index(balance.neighbour)]))
        return Scale(
            spread=float(np.std(values)),
            largest=float(np.abs(values).max()),
            lowest=float(values.min()),
            highest=float(values.max()),
            mean=float(values.mean()),
            effort=effort,
            time=float(np.std(answer) / np.std(np.gradient(answer, self.time))),
            duration=float(self.time[-1] - self.time[0]),
            position=position,
            farthest=farthest,
            difference=difference,
        )

    def law_at_distance(self, rng: Generator, law: str, place: LawPlace, target: float) -> LawTruth | None:
        """Size a law for about the distance ``target``, or as near to it as sizes that make sense bring it.

        None where no size is seen at all or the rig cannot be simulated with it.
        """
        entropy = int(rng.integers(2**63))
        formula, scale = law_kind(self.kind, law, place), self.scale(place)
        tried: list[tuple[float, LawTruth]] = []
        size = min(0.03, formula.most)
        for _ in range(6):
            truth = LawTruth(law, place, formula.draw(np.random.default_rng(entropy), size, scale))
            try:
                d = self.distance([truth], [])
            except OverflowError:
                d = float("nan")
            if not isfinite(d):
                size /= 10.0
                continue
            tried.append((size, replace(truth, d=d)))
            if abs(log(max(d, 1e-9) / target)) < DISTANCE_TOLERANCE or (d < target and size >= formula.most):
                break
            factor = float(np.clip((target / max(d, 1e-9)) ** (1.0 / _power(tried)), 1e-2, 1e2))
            size = min(size * factor, formula.most)
        return min((one for _, one in tried), key=lambda one: abs(log(max(one.d, 1e-9) / target)), default=None)


def _power(tried: Sequence[tuple[float, LawTruth]]) -> float:
    """Estimate the exponent with which the distance grows with the size, from the last two tried."""
    if len(tried) < 2:
        return 1.0
    (size, one), (other_size, other) = tried[-1], tried[-2]
    if size == other_size or min(one.d, other.d) < 1e-6:
        return 1.0
    return float(np.clip(log(one.d / other.d) / log(size / other_size), 0.3, 3.0))

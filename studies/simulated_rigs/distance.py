"""How much of a law a recording holds: what no change of the base parameters and initial states can imitate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from simulated_rigs.kinds import RigKind
from simulated_rigs.sensors import SensorNoise
from simulated_rigs.truth import LawTruth, simulate_rig

FloatArray = NDArray[np.float64]
#: Refinements of the base model's fit to the law's response, and the gain in d below which they end.
MAX_REFINEMENTS, MIN_RELATIVE_GAIN = 8, 5e-3
#: Outputs, in units of their noise, of a rig that a law made unstable.
MAX_STABLE_OUTPUT = 1e6


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

    ``parameters`` and ``start`` are the true ones; ``time`` has shape (n,), ``commands`` (n, inputs).
    """

    kind: RigKind
    parameters: Mapping[str, float]
    start: tuple[float, ...]
    time: FloatArray
    commands: FloatArray
    noise: Mapping[str, SensorNoise]

    def outputs(self, laws: Sequence[LawTruth], change: FloatArray | None = None) -> FloatArray:
        """Simulate outputs, shape (n, outputs), after changes of the free parameters and of the start.

        ``change`` holds changes of the parameters' logarithms, then of the initial states in units of their sizes.
        """
        values, start = dict(self.parameters), list(self.start)
        if change is not None:
            for name, factor in zip(self.kind.free, change, strict=False):
                values[name] *= exp(float(factor))
            for k, shift in enumerate(change[len(self.kind.free) :]):
                start[k] += float(shift) * self.kind.sizes[k]
        return simulate_rig(self.kind, values, laws, self.time, self.commands, start)[0]

    def white(self, outputs: FloatArray) -> FloatArray:
        """Whiten outputs, shape (n, outputs), by the noise; shape (n * outputs,)."""
        columns = [
            arma_innovations(outputs[:, k], self.noise[name], self.kind.step)
            for k, name in enumerate(self.kind.outputs)
        ]
        return np.concatenate(columns)

    def sensitivities(self) -> FloatArray:
        """Compute derivatives of the whitened outputs, shape (n * outputs, free + states), by central differences."""
        count, h = len(self.kind.free) + len(self.start), 1e-4
        columns = []
        for k in range(count):
            change = np.zeros(count)
            change[k] = h
            columns.append(self.white(self.outputs([], change) - self.outputs([], -change)) / (2.0 * h))
        return np.column_stack(columns)

    def distance(self, laws: Sequence[LawTruth], known: Sequence[LawTruth], basis: FloatArray) -> float:
        """Compute the distance of the rig with ``laws`` from every model that has only those ``known``.

        ``basis`` is what :meth:`sensitivities` returned; the model is refitted with it until nothing more is gained,
        which is right to a few per cent where a law is large. NaN for a rig that the laws make unstable.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            there = self.white(self.outputs(laws))
        if not np.isfinite(there).all() or np.abs(there).max() > MAX_STABLE_OUTPUT:
            return float("nan")
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

"""Where the refit of a candidate may start: few plain simulations say how far to go, and what that gains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.climb import Optimum
from aero_bayes.loop.stand import Stand
from aero_bayes.physics.kin import Candidate
from aero_bayes.sensors.noise import OutputNoise

FloatArray = NDArray[np.float64]

#: How many times its noise a residual must be to be looked at by least squares too, and how many independent pieces it
#: then counts for.
FAR, PIECES = 1.5, 50.0
#: Magnitudes that make a grid, how often it is halved about its best, and of how many of its lines both ends are looked
#: at.
GRID, CLOSER, LIKELIEST = 6, 3, 3


@dataclass(frozen=True, eq=False)
class Start:
    """Where a refit may start.

    ``promise`` is the gain in log-likelihood that the line through the tried value foretells, ``gain`` what a
    simulation at ``point`` finds; ``squares`` is whether both are by least squares.
    """

    promise: float
    point: FloatArray
    squares: bool = False
    gain: float = -math.inf


def starting_points(stand: Stand, base: Optimum, candidate: Candidate) -> list[Start]:
    """Starting coordinates of a candidate, best first.

    What a start changes in the outputs, after the other parameters have readjusted along their own sensitivities, is a
    direction in the space of residuals; how far to go along it and what that gains follow in closed form: under the
    present noise, and, where a misfit is far larger than that noise, by least squares, which sees the misfit as a
    whole. A law with a threshold is not a line: it may leave where it acts, so that both ends are simulated.
    """
    study = stand.study
    tried = _tried(stand, base, candidate.columns, candidate.starts)
    if len(candidate.columns) == 1 and len(candidate.starts) >= GRID:
        for _ in range(CLOSER):
            tried += _tried(stand, base, candidate.columns, _between(stand, base, candidate, tried))
    points = _checked(stand, base, _along(stand, base, candidate, tried))
    noise = _misfit(stand, base)
    if noise is not None:
        assert base.evaluation.slopes is not None
        plain = study.whiten(base.evaluation.residual, base.evaluation.slopes, noise)
        wide = replace(base, noise=noise, whitened=plain)
        total = float(plain.residual @ plain.residual)
        for s in _checked(stand, wide, _along(stand, wide, candidate, tried)):
            promise, gain = (-0.5 * PIECES * math.log(max(1.0 - 2.0 * g / total, 1e-12)) for g in (s.promise, s.gain))
            points.append(Start(promise, s.point, True, gain))
    return sorted(points, key=lambda s: -s.gain)


def _tried(
    stand: Stand, base: Optimum, columns: Sequence[int], starts: Sequence[tuple[float, ...]]
) -> list[tuple[FloatArray, tuple[FloatArray, ...]]]:
    """Coordinates with a candidate at each start, all else as in the base, and the residuals there."""
    parameters = stand.study.parameters
    values = np.repeat(parameters.from_search(base.coordinates)[np.newaxis, :], len(starts), axis=0)
    rows = np.repeat(base.coordinates[np.newaxis, :], len(starts), axis=0)
    for row, at, start in zip(rows, values, starts, strict=True):
        at[list(columns)] = start
        row[list(columns)] = parameters.to_search(at)[list(columns)]
    found = stand.study.residuals(rows) if len(rows) else []
    return [(row, residual) for row, residual in zip(rows, found, strict=True) if residual is not None]


def _between(
    stand: Stand,
    base: Optimum,
    candidate: Candidate,
    tried: Sequence[tuple[FloatArray, tuple[FloatArray, ...]]],
) -> list[tuple[float, ...]]:
    """Magnitudes on either side of the best of those tried, half way to the next."""
    parameters, (column,) = stand.study.parameters, candidate.columns
    gains = {
        float(parameters.from_search(row)[column]): _Line.of(stand, base, row, residual).gain(1.0)
        for row, residual in tried
    }
    sizes = sorted(gains)
    # Of those that do not act at all, the last before the threshold.
    best = max(range(len(sizes)), key=lambda k: (gains[sizes[k]], sizes[k]), default=0)
    return [(math.sqrt(one * other),) for one, other in pairwise(sizes[max(best - 1, 0) : best + 2]) if one > 0.0]


def _checked(stand: Stand, base: Optimum, points: Sequence[Start]) -> list[Start]:
    """The points with what a simulation of each gains under the base's noise."""
    if not points:
        return []
    found = stand.study.residuals(np.array([s.point for s in points]))
    present = base.whitened.log_likelihood
    return [
        replace(s, gain=stand.study.whiten(residual, None, base.noise).log_likelihood - present)
        for s, residual in zip(points, found, strict=True)
        if residual is not None
    ]


def _misfit(stand: Stand, base: Optimum) -> dict[str, OutputNoise] | None:
    """Each output's residual as white noise of its size, where one is far larger than the noise allows."""
    squares: dict[str, list[FloatArray]] = {}
    for series, residual in zip(stand.study.series, base.evaluation.residual, strict=True):
        squares.setdefault(series.output, []).append(residual**2)
    rms = {output: math.sqrt(float(np.mean(np.concatenate(parts)))) for output, parts in squares.items()}
    if all(size < FAR * base.noise[output].sd for output, size in rms.items()):
        return None
    return {output: OutputNoise(max(size, 1e-300)) for output, size in rms.items()}


@dataclass(frozen=True, eq=False)
class _Line:
    """From the base towards a tried point: what the tried point changes, the base's parameters readjusted (``back``).

    ``power`` is the squared change in units of the noise; ``along`` how far to go to gain most, were it a line;
    ``own`` the step of the base's parameters where the base is no optimum.
    """

    own: FloatArray
    back: FloatArray
    power: float
    along: float

    @classmethod
    def of(cls, stand: Stand, base: Optimum, row: FloatArray, residual: Sequence[FloatArray]) -> _Line:
        slopes = base.whitened.slopes
        first, second = (d[list(base.free)] for d in stand.study.parameters.prior_derivatives(base.coordinates))
        curvature = slopes @ slopes.T + np.diag(np.maximum(-second, 1e-9))
        change = base.whitened.residual - stand.study.whiten(residual, None, base.noise).residual
        # Where parameters cannot be told apart, the smallest step that does, in units of what each is known to.
        unit = 1.0 / np.sqrt(np.diag(curvature))
        towards = np.column_stack((slopes @ base.whitened.residual + first, slopes @ change)) * unit[:, np.newaxis]
        steps = np.linalg.lstsq(curvature * np.outer(unit, unit), towards, rcond=None)[0]
        own, back = (steps * unit[:, np.newaxis]).T
        direction = change - back @ slopes
        power = float(direction @ direction)
        along = float(direction @ (base.whitened.residual - own @ slopes)) / power if power > 0.0 else 0.0
        return cls(own, back, power, along)

    @property
    def within(self) -> float:
        """How far to go, within reason."""
        return float(np.clip(self.along, 0.05, 3.0))

    def gain(self, reach: float) -> float:
        """Gain in log-likelihood that going so far foretells."""
        return (self.along - 0.5 * reach) * reach * self.power


def _along(
    stand: Stand, base: Optimum, candidate: Candidate, tried: Sequence[tuple[FloatArray, tuple[FloatArray, ...]]]
) -> list[Start]:
    """Each tried point with the other parameters readjusted, and how far to go towards it."""
    low, high = stand.study.parameters.box
    # The first column of an effect is its magnitude, zero where the effect is off.
    size, free = candidate.columns[0], list(base.free)
    lines = [(row, line) for row, residual in tried if (line := _Line.of(stand, base, row, residual)).power > 0.0]
    ends = [(line.gain(reach), row, line, reach) for row, line in lines for reach in (1.0, line.within)]
    points = []
    for kind in (ends[::2], ends[1::2]):
        for _, row, line, reach in sorted(kind, key=lambda end: -end[0])[:LIKELIEST]:
            start = row.copy()
            start[size] = np.clip(reach * row[size], low[size], high[size])
            start[free] = np.clip(base.coordinates[free] + line.own - reach * line.back, low[free], high[free])
            points.append(Start(line.gain(max(line.along, 0.0)), start))
    return points

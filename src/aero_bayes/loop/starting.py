"""Where the refit of a candidate may start: few plain simulations say how far to go, and what that gains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.climb import ClimbSettings, Optimum, climb
from aero_bayes.estimate.delays import delay_columns
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.physics.kin import Candidate
from aero_bayes.sensors.noise import OutputNoise

FloatArray = NDArray[np.float64]

#: How many times its noise a residual must be to be looked at by least squares too, and how many independent pieces it
#: then counts for.
FAR, PIECES = 1.5, 50.0
#: Magnitudes that make a grid, how often it is halved about its best, and of how many of its lines both ends are looked
#: at.
GRID, CLOSER, LIKELIEST = 6, 3, 3
#: Share of the residual that a law may change to foretell anything.
LESS = 0.3
#: Gain in log-likelihood below which no end of a line is looked at.
HOPE = 0.25
#: Share of what a line promises that a simulation must find for the line to be believed, and the least promise, in
#: log-likelihood, for which another way is tried: nobody is named for less.
BORNE_OUT, WORTH = 0.3, 6.0


@dataclass(frozen=True, eq=False)
class Start:
    """Where a refit may start.

    ``promise`` is the gain in log-likelihood that the line through the tried value foretells, ``gain`` what a
    simulation at ``point`` finds; ``squares`` is whether both are by least squares, ``held`` whether ``point`` is where
    a climb with the law held came to.
    """

    promise: float
    point: FloatArray
    squares: bool = False
    gain: float = -math.inf
    held: bool = False


def starting_points(around: Around, candidate: Candidate, steps: ClimbSettings, least: float = 0.0) -> list[Start]:
    """Starting coordinates of a candidate, best first; not looked at closely where nothing foretells the ``least``.

    What a start changes in the outputs, after the other parameters have readjusted along their own sensitivities, is a
    direction in the space of residuals; how far to go along it and what that gains follow in closed form: under the
    present noise, and, where a misfit is far larger than that noise, by least squares, which sees the misfit as a
    whole. A law with a threshold is not a line: it may leave where it acts, so that both ends are simulated. Where
    neither bears the promise out the other parameters readjust by a few ``steps`` of a climb, with the law held.
    """
    columns = candidate.columns
    if not candidate.starts:
        return around.tangent(candidate)
    tried = around.first_look(candidate)
    lines = [around.line(row, residual) for row, residual in tried]
    if len(columns) == 1 and len(candidate.starts) >= GRID:
        for _ in range(CLOSER):
            between = _between(around.study.parameters, candidate, lines)
            if not between:
                break
            closer = around.tried(columns, between)
            lines += [around.line(row, residual) for row, residual in closer]
            tried += closer
    if _foretold(lines) < max(HOPE, least):
        less = around.less(candidate, lines)
        lines += [around.line(row, residual) for row, residual in less]
        tried += less
    points = around.points(candidate, lines, _foretold(lines) >= max(HOPE, least))
    promise = max((s.promise for s in points), default=0.0)
    if promise > max(WORTH, least) and max((s.gain for s in points), default=0.0) < BORNE_OUT * promise:
        points += around.held(candidate, lines, steps)
    if (wide := around.by_squares) is not None:
        lines = [wide.line(row, residual) for row, residual in tried]
        for s in wide.points(candidate, lines, wide.in_pieces(_foretold(lines)) >= max(HOPE, least)):
            points.append(Start(wide.in_pieces(s.promise), s.point, True, wide.in_pieces(s.gain)))
    return sorted(points, key=lambda s: -s.gain)


def promised(around: Around, candidate: Candidate) -> float:
    """The most that a line through one of its first starts foretells: a first look, at few simulations."""
    tried = around.first_look(candidate)
    most = max((around.line(*one).most for one in tried), default=-math.inf)
    if (wide := around.by_squares) is not None:
        most = max((most, *(wide.in_pieces(wide.line(*one).most) for one in tried)))
    return most


@dataclass(frozen=True, eq=False)
class _Line:
    """From the base towards a tried point ``row``: what it changes, the base's parameters readjusted (``back``).

    ``power`` is the squared change in units of the noise, ``alone`` the change were nothing readjusted; ``along`` is
    how far to go to gain most, were it a line; ``own`` the step of the base's parameters where the base is no optimum.
    """

    row: FloatArray
    own: FloatArray
    back: FloatArray
    power: float
    alone: float
    along: float

    @property
    def within(self) -> float:
        """How far to go, within reason."""
        return float(np.clip(self.along, 0.05, 3.0))

    def gain(self, reach: float) -> float:
        """Gain in log-likelihood that going so far foretells."""
        return (self.along - 0.5 * reach) * reach * self.power

    @property
    def most(self) -> float:
        return self.gain(max(self.along, 0.0))


def _foretold(lines: Sequence[_Line]) -> float:
    """The most that a line foretells, at its best or where it was tried."""
    return max((max(line.most, line.gain(1.0)) for line in lines), default=0.0)


def _between(parameters: ParameterSet, candidate: Candidate, lines: Sequence[_Line]) -> list[tuple[float, ...]]:
    """Magnitudes on either side of the best of those tried, half way to the next; none if the least is too much."""
    (column,) = candidate.columns
    gains = {float(parameters.from_search(line.row)[column]): line.gain(1.0) for line in lines}
    sizes = sorted(gains)
    # Of those that do not act at all, the last before the threshold.
    best = max(range(len(sizes)), key=lambda k: (gains[sizes[k]], sizes[k]), default=0)
    if best == 0 and sizes and gains[sizes[0]] < 0.0:
        return []
    return [(math.sqrt(one * other),) for one, other in pairwise(sizes[max(best - 1, 0) : best + 2]) if one > 0.0]


class Around:
    """The surroundings of a base: how its parameters readjust to a change of the outputs, to first order.

    Parameters
    ----------
    study : Objective
    base : Optimum
        An optimum, or another place that was evaluated with slopes.
    """

    def __init__(self, study: Objective, base: Optimum) -> None:
        self.study, self.base = study, base
        slopes, residual, free = base.whitened.slopes, base.whitened.residual, list(base.free)
        first, second = (d[free] for d in study.parameters.prior_derivatives(base.coordinates))
        # Delays stay: a reading moves over a jump of the input all at once, which no slope foretells.
        delays = delay_columns(study, free)
        steady = [k for k, j in enumerate(free) if j not in delays]
        own = slopes[steady]
        curvature = own @ own.T + np.diag(np.maximum(-second[steady], 1e-9))
        # Where parameters cannot be told apart, the smallest step that does, in units of what each is known to.
        unit = 1.0 / np.sqrt(np.diag(curvature))
        both = np.outer(unit, unit)
        step: FloatArray = np.linalg.pinv(curvature * both, 1e-10, hermitian=True) * both
        self._step = np.zeros((len(free), len(free)))
        self._step[np.ix_(steady, steady)] = step
        self.own: FloatArray = self._step @ (slopes @ residual + first)
        self.left: FloatArray = residual - self.own @ slopes

    @cached_property
    def by_squares(self) -> Around | None:
        """The same with each output's residual as white noise of its size; None unless one is far above its noise."""
        noise = self._misfit()
        if noise is None:
            return None
        found = self.base.evaluation
        assert found.slopes is not None
        return Around(
            self.study, replace(self.base, noise=noise, whitened=self.study.whiten(found.residual, found.slopes, noise))
        )

    def _misfit(self) -> dict[str, OutputNoise] | None:
        squares: dict[str, list[FloatArray]] = {}
        for series, residual in zip(self.study.series, self.base.evaluation.residual, strict=True):
            squares.setdefault(series.output, []).append(residual**2)
        rms = {output: math.sqrt(float(np.mean(np.concatenate(parts)))) for output, parts in squares.items()}
        if all(size < FAR * self.base.noise[output].sd for output, size in rms.items()):
            return None
        return {output: OutputNoise(max(size, 1e-300)) for output, size in rms.items()}

    def in_pieces(self, gain: float) -> float:
        """A gain by squares as if the residual were a few independent pieces."""
        total = float(self.base.whitened.residual @ self.base.whitened.residual)
        return -0.5 * PIECES * math.log(max(1.0 - 2.0 * gain / total, 1e-12))

    def tried(
        self, columns: Sequence[int], starts: Sequence[tuple[float, ...]]
    ) -> list[tuple[FloatArray, tuple[FloatArray, ...]]]:
        """Coordinates with a candidate at each start, all else as in the base, and the residuals there."""
        parameters, at = self.study.parameters, self.base.coordinates
        values = np.repeat(parameters.from_search(at)[np.newaxis, :], len(starts), axis=0)
        rows = np.repeat(at[np.newaxis, :], len(starts), axis=0)
        for row, value, start in zip(rows, values, starts, strict=True):
            value[list(columns)] = start
            row[list(columns)] = parameters.to_search(value)[list(columns)]
        found = self.study.residuals(rows) if len(rows) else []
        return [(row, residual) for row, residual in zip(rows, found, strict=True) if residual is not None]

    def first_look(self, candidate: Candidate) -> list[tuple[FloatArray, tuple[FloatArray, ...]]]:
        """A candidate at its starts; where every second of many magnitudes makes things worse, only at these."""
        columns, starts = candidate.columns, candidate.starts
        if len(columns) > 1 or len(starts) < GRID:
            return self.tried(columns, starts)
        ordered = sorted(starts)
        tried = self.tried(columns, ordered[::2])
        lines = [around.line(*one) for around in (self, self.by_squares) if around is not None for one in tried]
        if lines and all(line.power > 0.0 and line.along <= 0.0 for line in lines):
            return tried
        return tried + self.tried(columns, ordered[1::2])

    def less(self, candidate: Candidate, lines: Sequence[_Line]) -> list[tuple[FloatArray, tuple[FloatArray, ...]]]:
        """Each shape of a candidate once more, where all that was tried changes more than there is to explain.

        A resonance that is moved away foretells nothing; so little of the law that it stays where it is may.
        """
        columns = list(candidate.columns)
        least: dict[tuple[float, ...], _Line] = {}
        for line in lines:
            shape = tuple(line.row[columns[1:]])
            if shape not in least or line.alone < least[shape].alone:
                least[shape] = line
        aim = LESS * math.sqrt(float(self.left @ self.left))
        smaller: list[tuple[float, ...]] = []
        for line in least.values():
            if line.alone > aim:
                magnitude, *rest = self.study.parameters.from_search(line.row)[columns]
                smaller.append((magnitude * aim / line.alone, *rest))
        return self.tried(columns, smaller)

    def line(self, row: FloatArray, residual: Sequence[FloatArray]) -> _Line:
        """From here to a point with these residuals."""
        whitened = self.base.whitened
        change = whitened.residual - self.study.whiten(residual, None, self.base.noise).residual
        back = self._step @ (whitened.slopes @ change)
        direction = change - back @ whitened.slopes
        power = float(direction @ direction)
        along = float(direction @ self.left) / power if power > 0.0 else 0.0
        return _Line(row, self.own, back, power, math.sqrt(float(change @ change)), along)

    def points(self, candidate: Candidate, lines: Sequence[_Line], closely: bool) -> list[Start]:
        """Both ends of the likeliest lines; looked at ``closely``, with what a simulation of each gains."""
        acting = [line for line in lines if line.power > 0.0]
        ends: list[tuple[_Line, float]] = []
        for reaches in ([1.0] * len(acting), [line.within for line in acting]):
            kind = sorted(zip(acting, reaches, strict=True), key=lambda end: -end[0].gain(end[1]))
            ends += kind[:LIKELIEST]
        points = [self._end(candidate, line, reach) for line, reach in ends]
        if not closely:
            return points
        points = self._simulated(points)
        if ends and all(s.gain < 0.0 for s in points):
            # No line: from here, with so little of it as is just seen, a climb follows the tangent.
            line = ends[0][0]
            bare = replace(line, back=np.zeros_like(line.back), own=np.zeros_like(line.own))
            points += self._simulated([self._end(candidate, bare, 1.0 / line.alone)])
        return points

    def across(self, point: FloatArray, columns: Sequence[int]) -> tuple[FloatArray, FloatArray] | None:
        """What some columns change to first order, in units of the noise, once the base's parameters have readjusted.

        The changes (q, n) and how far the parameters readjust to each (q, f); None where that cannot be simulated.
        """
        free, own = list(self.base.free), self.base.whitened.slopes
        found = self.study.evaluate(point, [*free, *columns])
        if found is None or found.slopes is None:
            return None
        new = self.study.whiten(found.residual, found.slopes, self.base.noise).slopes[len(free) :]
        back = (new @ own.T) @ self._step
        return new - back @ own, back

    def tangent(self, candidate: Candidate) -> list[Start]:
        """One step along all columns of a linear candidate together, and half of it."""
        base, parameters = self.base, self.study.parameters
        columns, free = list(candidate.columns), list(base.free)
        slopes = self.across(base.coordinates, columns)
        if slopes is None:
            return []
        (across, back), (first, second) = slopes, parameters.prior_derivatives(base.coordinates)
        curvature = across @ across.T + np.diag(np.maximum(-second[columns], 1e-9))
        slope = across @ self.left + first[columns]
        step = np.linalg.solve(curvature, slope)
        low, high = parameters.box
        points = []
        for reach in (1.0, 0.5):
            point = base.coordinates.copy()
            point[columns] = np.clip(point[columns] + reach * step, low[columns], high[columns])
            point[free] = np.clip(point[free] + self.own - reach * (step @ back), low[free], high[free])
            points.append(Start(0.5 * float(slope @ step), point))
        return sorted(self._simulated(points), key=lambda s: -s.gain)

    def held(self, candidate: Candidate, lines: Sequence[_Line], steps: ClimbSettings) -> list[Start]:
        """The likeliest tried values that act, all else readjusted by a climb."""
        acting = sorted((line for line in lines if line.alone > 1.0), key=lambda line: -line.gain(1.0))
        present, found = self.base.whitened.log_likelihood, []
        for line in acting[:LIKELIEST]:
            with suppress(CannotFinishError):
                end = climb(self.study, line.row, self.base.free, noise=self.base.noise, settings=steps)
                found.append(Start(line.most, end.coordinates, gain=end.log_likelihood - present, held=True))
        return found

    def _end(self, candidate: Candidate, line: _Line, reach: float) -> Start:
        """The start so far along a line."""
        low, high = self.study.parameters.box
        # The first column of an effect is its magnitude, zero where the effect is off.
        size, free = candidate.columns[0], list(self.base.free)
        point = line.row.copy()
        point[size] = np.clip(reach * line.row[size], low[size], high[size])
        point[free] = np.clip(self.base.coordinates[free] + line.own - reach * line.back, low[free], high[free])
        return Start(line.most, point)

    def _simulated(self, starts: Sequence[Start]) -> list[Start]:
        """Those that can be simulated, with what each gains."""
        found = self.study.residuals(np.array([s.point for s in starts])) if starts else []
        present = self.base.whitened.log_likelihood
        return [
            replace(s, gain=self.study.whiten(residual, None, self.base.noise).log_likelihood - present)
            for s, residual in zip(starts, found, strict=True)
            if residual is not None
        ]

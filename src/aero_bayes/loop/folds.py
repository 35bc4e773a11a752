"""Squared errors on training readings that were left out: the first of the two witnesses of a structure.

A fold, a fifth of a recording or a whole one, is left out at a time: short ones ask for interpolation, which flexible
terms do well. Blocks within a fold give the standard error. One Newton step, simulated, ranks all structures; it is
wrong where a fold decides a parameter, so what the decision hangs on is fitted again without each fold.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.intervals import MIN_BLOCK_READINGS, LinearisedFit, blocks_of_time
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, local_fit
from aero_bayes.estimate.objective import Objective
from aero_bayes.loop.models import FittedModel

Readings = NDArray[np.int_]

#: Folds of the readings, at least two of a recording, and blocks of all folds together, which give the standard error.
FOLDS, BLOCKS = 5, 20
#: Recordings from which on whole ones are left out: of two, the one that is left says too little alone.
MIN_WHOLE_RECORDINGS = 3
#: A fold with this share of the information on the start of a law's state counts as having all of it.
DETERMINED = 0.9
#: Error that counts as none, as a share of an output's range: the accuracy of the solver in a search.
ROUNDING_SHARE = 1e-5
#: Rise of what the other readings leave with a Newton step, above which the step says nothing.
MAX_RISE = 1.05


@dataclass(frozen=True, eq=False)
class Folds:
    """The readings (columns of the whitened slopes) that are left out in turn, the same for all structures.

    Each fold is a sequence of blocks. ``owner`` (N,) is the output of each reading, ``least`` (m,) the squared error
    that counts as none."""

    outputs: tuple[str, ...]
    blocks: tuple[tuple[Readings, ...], ...]
    owner: Readings
    least: FloatArray
    whole: bool

    @property
    def folds(self) -> tuple[Readings, ...]:
        """The readings of each fold."""
        return tuple(np.concatenate(blocks) for blocks in self.blocks)

    @classmethod
    def of(cls, first: FittedModel) -> Folds:
        """Cut the readings so that the parameters of the first model do not hang on one block.

        Blocks of time hold equal shares of readings and of leverage. Of three recordings each is one fold."""
        objective, calibration = first.model.objective, first.model.objective.calibration
        series, free = objective.series, first.optimum.free
        count = len({s.experiment for s in series})
        whole = count >= MIN_WHOLE_RECORDINGS
        leverage = LinearisedFit.of(first.optimum, objective.parameters, range(len(free))).leverage
        leverage = leverage if np.all(np.isfinite(leverage)) else np.zeros(objective.readings)
        folds: list[tuple[Readings, ...]] = []
        for blocks in blocks_of_time(series, leverage, max(BLOCKS // count, 1), MIN_BLOCK_READINGS):
            own = 1 if whole else min(len(blocks), max(2, -(-FOLDS // count)))
            folds += [tuple(blocks[k] for k in part) for part in np.array_split(np.arange(len(blocks)), own)]
        outputs = objective.outputs
        owner = np.repeat([outputs.index(s.output) for s in series], [s.sampling.size for s in series])
        scale = [float(calibration.data.scale[calibration.data.outputs.index(o)]) for o in outputs]
        least = np.bincount(owner, minlength=len(outputs)).astype(float) * np.square(ROUNDING_SHARE * np.array(scale))
        return cls(outputs, tuple(folds), owner, least, whole)

    def sums(self, residual: FloatArray, readings: Readings | None = None) -> FloatArray:
        """Sums of squares (m,) by output of a whitened residual (N,), of some readings or all."""
        own = slice(None) if readings is None else readings
        with np.errstate(over="ignore"):  # a prediction may grow without bounds: its error is infinite
            return np.asarray(np.bincount(self.owner[own], residual[own] ** 2, len(self.outputs)), dtype=np.float64)

    def score(self, residual: FloatArray, noise: FloatArray) -> float:
        """Sum over outputs of the logarithm of the error of a residual (N,) in units of a noise (m,)."""
        squares = np.maximum(self.sums(residual) * noise**2, np.maximum(self.least, 1e-300))
        return float(np.sum(0.5 * np.log(squares)))

    def on_fitted(self, found: Optimum | None) -> float:
        """Score of a fit on the readings that it was fitted to; infinite for none."""
        if found is None:
            return math.inf
        return self.score(found.whitened.residual, np.array([found.noise[o].sd for o in self.outputs]))

    def moving(self, fitted: FittedModel) -> list[tuple[int, ...]]:
        """Places among the free columns of the parameters that are fitted again without each fold.

        Where a recording is left out whole, its initial values and delays are not. Nor is the start of a law's state,
        where the fold has all the information on it."""
        model, free, squares = fitted.model, fitted.optimum.free, fitted.optimum.whitened.slopes**2
        own = np.array([model.objective.parameters.items[j].recording is not None for j in free], dtype=bool)
        of_laws = own & ~np.isin(free, model.free_base_columns)
        most = DETERMINED * squares.sum(axis=1)
        held = [own if self.whole else of_laws & (squares[:, fold].sum(axis=1) >= most) for fold in self.folds]
        return [tuple(np.flatnonzero(~stays).tolist()) for stays in held]


def newton_errors(fitted: FittedModel, folds: Folds) -> FloatArray:
    """Squared errors (blocks, m) of each block, predicted after one Newton step without its fold.

    Where the step leaves more of the other readings than the fit to all does, the errors of the fit stand."""
    optimum, objective = fitted.optimum, fitted.model.objective
    residual, found = optimum.whitened.residual, []
    rows = objective.residuals(_newton_points(fitted, folds, folds.moving(fitted)))
    for blocks, fold, row in zip(folds.blocks, folds.folds, rows, strict=True):
        moved = residual if row is None else objective.whiten(row, optimum.noise).residual
        with np.errstate(over="ignore"):
            before, after = (float(np.sum(np.delete(r, fold) ** 2)) for r in (residual, moved))
        found += [folds.sums(moved if after <= MAX_RISE * before else residual, block) for block in blocks]
    return np.array(found) * fitted.noise**2


def refitted_errors(
    fitted: FittedModel,
    folds: Folds,
    settings: LocalFitSettings,
    stop: Callable[[int, float], bool] = lambda iteration, cost: False,
) -> FloatArray:
    """Squared errors (blocks, m) of each block, predicted by a fit without its fold; infinite where it fails.

    CannotFinishError where it had to ``stop``: a fit that is not done says nothing of a structure.
    Where a simulation after the Newton step is what was predicted, as closely as a fit would end, it is that fit."""
    optimum, own = fitted.optimum, fitted.model.objective
    residual, found = optimum.whitened.residual, []
    every = folds.moving(fitted)
    points = _newton_points(fitted, folds, every)
    rows = own.residuals(points)
    for blocks, fold, moving, point, row in zip(folds.blocks, folds.folds, every, points, rows, strict=True):
        columns, change = [optimum.free[k] for k in moving], point - optimum.coordinates
        moved = residual if row is None else own.whiten(row, optimum.noise).residual
        with np.errstate(over="ignore"):
            predicted = residual - change[list(optimum.free)] @ optimum.whitened.slopes
            is_linear = row is not None and float(np.sum((moved - predicted) ** 2)) <= settings.local.tolerance
            better = float(np.sum(np.delete(moved, fold) ** 2)) < float(np.sum(np.delete(residual, fold) ** 2))
        if not is_linear:
            change[columns] *= better
            moved = _refit(fitted, fold, optimum.coordinates + change, columns, settings, stop)
        found += [folds.sums(moved, block) for block in blocks]
        if stop(0, 0.0):
            raise CannotFinishError("the time limit was reached")
    return np.array(found) * fitted.noise**2


def _refit(
    fitted: FittedModel, fold: Readings, start: FloatArray, columns: list[int], settings: LocalFitSettings,
    stop: Callable[[int, float], bool],
) -> FloatArray:  # fmt: skip
    """Whitened residual (N,) of all readings after a fit without some; infinite where that fails."""
    own, noise = fitted.model.objective, fitted.optimum.noise
    with suppress(CannotFinishError):
        end = local_fit(
            _without(own, fold), start, columns, noise=noise, settings=replace(settings, hold_noise=True),
            on_iteration=stop,
        )  # fmt: skip
        there = own.residuals(end.coordinates[np.newaxis])[0]
        if there is not None:
            return own.whiten(there, noise).residual
    return np.full(own.readings, math.inf)


def _newton_points(fitted: FittedModel, folds: Folds, every: Sequence[tuple[int, ...]]) -> FloatArray:
    """Search coordinates (folds, p) after the Newton step of a fit without each fold, kept in the bounds.

    ``every`` says what moves without each fold. The start of a law's state that does not move is as declared."""
    optimum, parameters, cells = fitted.optimum, fitted.model.objective.parameters, folds.folds
    rows = np.repeat(optimum.coordinates[np.newaxis], len(every), axis=0)
    if not folds.whole:
        declared = parameters.to_search(parameters.start)
        for row, moving in zip(rows, every, strict=True):
            held = [j for k, j in enumerate(optimum.free) if k not in moving]
            row[held] = declared[held]
    for moving in filter(None, dict.fromkeys(every)):
        columns, linear = [optimum.free[k] for k in moving], LinearisedFit.of(optimum, parameters, moving)
        low, high = (bound[columns] for bound in parameters.box)
        alike = [k for k, other in enumerate(every) if other == moving]
        for k, (_, step) in zip(alike, linear.without(cells, [slice(k, k + 1) for k in alike]), strict=True):
            rows[k, columns] = np.clip(rows[k, columns] + step, low, high)
    return rows


def _without(objective: Objective, readings: Readings) -> Objective:
    """Return the objective without some readings (columns of the whitened slopes), on the same simulator."""
    calibration = objective.calibration
    measured = [y.copy() for y in calibration.data.measured]
    first = 0
    for series in objective.series:
        rows = readings[(readings >= first) & (readings < first + series.sampling.size)] - first
        measured[series.experiment][series.sampling.index[rows], series.column] = np.nan
        first += series.sampling.size
    data = calibration.data.with_experiments(
        replace(e, measured=y) for e, y in zip(calibration.data.experiments, measured, strict=True)
    )
    found = objective.with_calibration(replace(calibration, data=data), objective.simulator)
    found.result_cache = None
    return found

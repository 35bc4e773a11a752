"""Squared errors on readings that were left out: the one measure by which structures are compared.

All structures are held against the same blocks of readings. The closed form (one Newton step) ranks all structures; it
is wrong where a block decides a parameter, so the finalists are fitted again without each block.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.leave_out import BLOCK_COUNT, MIN_BLOCK_READINGS, LinearisedFit, blocks_of_time
from aero_bayes.estimate.local_fit import LocalFitSettings, local_fit
from aero_bayes.estimate.objective import Objective, Series
from aero_bayes.search.models import FittedModel

Readings = NDArray[np.int_]

#: Recordings from which on whole recordings are left out: of two, the one that is left says too little alone.
MIN_WHOLE_RECORDINGS = 3
#: Error that counts as none, as a share of an output's range: the accuracy of the solver in a search.
ROUNDING_SHARE = 1e-5
#: Steps of a fit without a block, which starts near its end.
MAX_REFIT_STEPS = 8


@dataclass(frozen=True, eq=False)
class CommonBlocks:
    """The readings that are left out in turn, the same for all structures."""

    outputs: tuple[str, ...]
    folds: tuple[tuple[Readings, ...], ...]
    owner: Readings
    least: FloatArray
    whole: bool

    @classmethod
    def of(cls, fits: Sequence[FittedModel]) -> CommonBlocks:
        """Cut the readings so that no structure's parameters hang on one block.

        Blocks of time hold equal shares of readings and of leverage, averaged over the structures. Whole recordings
        are left out where there are three or more."""
        objective, noise = fits[0].model.objective, fits[0].optimum.noise
        series, calibration = objective.series, objective.calibration
        recordings = sorted({s.experiment for s in series})
        whole = len(recordings) >= MIN_WHOLE_RECORDINGS
        leverage = sum((_leverage(f) for f in fits), np.zeros(objective.readings))
        folds: list[tuple[Readings, ...]] = []
        for cells in blocks_of_time(series, leverage, BLOCK_COUNT // len(recordings), MIN_BLOCK_READINGS):
            folds += [tuple(cells)] if whole else [(cell,) for cell in cells]
        outputs = objective.outputs
        owner = np.repeat([outputs.index(s.output) for s in series], [s.sampling.size for s in series])
        rounding = [
            ROUNDING_SHARE * float(calibration.data.scale[calibration.data.outputs.index(o)]) / noise[o].sd
            for o in outputs
        ]
        least = np.bincount(owner).astype(np.float64) * np.square(rounding)
        return cls(outputs, tuple(folds), owner, least, whole)

    def readings(self, fold: int) -> Readings:
        """Return all readings that are left out together."""
        return np.concatenate(self.folds[fold])

    def squares(self, fold: int, residual: FloatArray) -> FloatArray:
        """Sums of squares (blocks, m) of the residual (n,) of a fold's readings, by block and output."""
        first = np.concatenate(([0], np.cumsum([block.size for block in self.folds[fold]])))
        with np.errstate(over="ignore"):  # a prediction may grow without bounds: its error is infinite
            square = residual**2
        return np.array(
            [
                np.bincount(self.owner[block], weights=square[a : a + block.size], minlength=len(self.outputs))
                for a, block in zip(first[:-1].tolist(), self.folds[fold], strict=True)
            ],
            dtype=np.float64,
        )

    def moving(self, fitted: FittedModel) -> list[int]:
        """Places among the free columns of those that move when a block is left out.

        Initial values and delays of a recording stay where it is left out whole: nothing else determines them."""
        items = fitted.model.objective.parameters.items
        return [k for k, j in enumerate(fitted.optimum.free) if not self.whole or items[j].recording is None]

    def linearised(self, fitted: FittedModel) -> LinearisedFit:
        """Return the fit to first order in what moves."""
        return LinearisedFit.of(fitted.optimum, fitted.model.objective.parameters, self.moving(fitted))


def newton_errors(fitted: FittedModel, common: CommonBlocks) -> FloatArray:
    """Squared errors (blocks, m) of each block, predicted by a fit without it: one Newton step, kept in the bounds."""
    optimum, parameters, moving = fitted.optimum, fitted.model.objective.parameters, common.moving(fitted)
    columns, linear = [optimum.free[k] for k in moving], common.linearised(fitted)
    low, high = (bound[columns] for bound in parameters.box)
    at, found = optimum.coordinates[columns], []
    every = [common.readings(k) for k in range(len(common.folds))]
    for k, left in enumerate(linear.without(every)):
        step = np.clip(at + left.step, low, high) - at
        found.append(common.squares(k, linear.residual[left.readings] - linear.slopes[:, left.readings].T @ step))
    return np.concatenate(found)


def refitted_errors(fitted: FittedModel, common: CommonBlocks, fold: int, settings: LocalFitSettings) -> FloatArray:
    """Squared errors (blocks, m) of one fold, predicted by a fit to all other readings.

    Where a simulation after the Newton step meets what was predicted there, as closely as a fit would end, that is the
    fit. Else it starts there, or at the optimum of all readings where the step leaves more."""
    optimum, readings, moving = fitted.optimum, common.readings(fold), common.moving(fitted)
    own, failed = fitted.model.objective, np.full((len(common.folds[fold]), len(common.outputs)), math.inf)
    columns = [optimum.free[k] for k in moving]
    fit = replace(settings, hold_noise=True).with_limits(MAX_REFIT_STEPS, settings.local.tolerance)
    moved = _after_newton_step(fitted, common, fold)
    if moved is not None and moved.remaining_decrease <= settings.local.tolerance * moved.unit:
        return common.squares(fold, moved.residual[readings])
    start = moved.coordinates if moved is not None and moved.is_better else optimum.coordinates
    try:
        end = local_fit(_without(own, readings), start, columns, noise=optimum.noise, settings=fit)
    except CannotFinishError:
        return failed
    found = own.evaluate(end.coordinates)
    if found is None:
        return failed
    return common.squares(fold, own.whiten(found, optimum.noise).residual[readings])


@dataclass(frozen=True, eq=False)
class _Moved:
    """A simulation after the Newton step of a fit without a fold."""

    coordinates: FloatArray
    residual: FloatArray
    is_better: bool
    remaining_decrease: float
    unit: float


def _after_newton_step(fitted: FittedModel, common: CommonBlocks, fold: int) -> _Moved | None:
    """Simulate after the Newton step of a fit without a fold; None where that fails."""
    optimum, own, moving = fitted.optimum, fitted.model.objective, common.moving(fitted)
    columns, linear = [optimum.free[k] for k in moving], common.linearised(fitted)
    out = common.readings(fold)
    others = np.setdiff1d(np.arange(common.owner.size), out)
    (left,) = linear.without([out, others], [slice(0, 1)])
    low, high = (bound[columns] for bound in own.parameters.box)
    at, moved = optimum.coordinates[columns], optimum.coordinates.copy()
    moved[columns] = np.clip(at + left.step, low, high)
    (there,) = own.residuals(moved[np.newaxis])
    if there is None:
        return None
    after, before = own.whiten(there, optimum.noise).residual, optimum.whitened.residual
    first = own.parameters.prior_derivatives(optimum.coordinates)[0][columns]
    gradient = linear.slopes @ before + first
    curvature = linear.slopes @ linear.slopes.T + linear.prior
    with np.errstate(over="ignore"):  # the step may end where the model grows without bounds
        better = bool(np.sum(after[others] ** 2) < np.sum(before[others] ** 2))
        error = float(np.sum((after - before + left.step @ linear.slopes) ** 2))
    short = float(gradient @ np.linalg.pinv(curvature, hermitian=True) @ gradient)
    inside = bool(np.all((at > low) & (at < high) & (moved[columns] > low) & (moved[columns] < high)))
    unit = min(float(before @ before) / max(before.size, 1), 1.0)
    return _Moved(moved, after, better, 0.5 * (error + short) if inside else math.inf, unit)


def _leverage(fitted: FittedModel) -> FloatArray:
    """Share of the leverage of a fit that each reading has (N,); zero where no parameter is determined."""
    optimum = fitted.optimum
    own = LinearisedFit.of(optimum, fitted.model.objective.parameters, range(len(optimum.free))).leverage
    whole = float(own.sum())
    return own / whole if whole > 0.0 and math.isfinite(whole) else np.zeros(own.size)


def _without(objective: Objective, readings: Readings) -> Objective:
    """Return the objective without some readings (columns of the whitened slopes), on the same simulator."""
    calibration = objective.calibration
    measured = [y.copy() for y in calibration.data.measured]
    for series, rows in _by_series(objective.series, readings):
        measured[series.experiment][series.sampling.index[rows], series.column] = np.nan
    data = calibration.data.with_experiments(
        replace(e, measured=y) for e, y in zip(calibration.data.experiments, measured, strict=True)
    )
    found = objective.with_calibration(replace(calibration, data=data), objective.simulator)
    found.result_cache = None
    return found


def _by_series(series: Sequence[Series], readings: Readings) -> list[tuple[Series, Readings]]:
    """Readings by their series, as places in it."""
    first = np.concatenate(([0], np.cumsum([s.sampling.size for s in series])))
    return [
        (s, readings[(readings >= a) & (readings < b)] - a)
        for s, a, b in zip(series, first[:-1], first[1:], strict=True)
    ]

"""Profile likelihood: one parameter is fixed at values across its range, and all others are fitted again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate.levenberg_marquardt import LocalSettings, levenberg_marquardt
from aero_bayes.estimate.objective import objective_of
from aero_bayes.estimate.result import Fit
from aero_bayes.simulation.interface import Simulator

#: Drop of the log-posterior at the ends of a 90 % interval: half the 90 % quantile of chi-squared (1 degree of
#: freedom).
LOG_POSTERIOR_DROP_90 = 1.3527


@dataclass(frozen=True)
class LikelihoodProfile:
    """Profile of the log-posterior over one parameter, at the fitted noise.

    ``values`` (k,) are in SI units. ``drop`` (k,) is the largest log-posterior of all less the one at each value: zero
    at the best value, and infinite where every simulation failed."""

    name: str
    unit: str
    values: FloatArray
    drop: FloatArray

    @property
    def interval(self) -> tuple[float | None, float | None]:
        """Ends of the 90 % interval; None on a side where the profile does not drop that far within the range."""
        best = int(np.argmin(self.drop))
        return self._crossing(slice(best, None, -1)), self._crossing(slice(best, None))

    @property
    def bounded(self) -> bool:
        """Whether the data and the priors bound the parameter on both sides."""
        return None not in self.interval

    def _crossing(self, part: slice) -> float | None:
        values, drop = self.values[part], self.drop[part]
        above = np.flatnonzero(drop > LOG_POSTERIOR_DROP_90)
        if above.size == 0:
            return None
        k = int(above[0])
        if not np.isfinite(drop[k]):
            return float(values[k])
        share = (LOG_POSTERIOR_DROP_90 - drop[k - 1]) / (drop[k] - drop[k - 1])
        return float(values[k - 1] + share * (values[k] - values[k - 1]))


def profile_likelihood(
    fit: Fit,
    name: str,
    simulator: Simulator,
    *,
    points: int = 21,
    width: float = 4.0,
    settings: LocalSettings | None = None,
) -> LikelihoodProfile:
    """Compute the profile of one free parameter of a fit."""
    column = fit.calibration.parameters.index(name)
    if column not in fit.free:
        raise InputError(f"{name} was not fitted, so it has no profile")
    target = fit.target(simulator)
    cost_function = target.cost_function(objective_of(fit.calibration, simulator).noise_rows(fit.noise))
    j = fit.free.index(column)
    centre, sd = fit.laplace.mean[: len(fit.free)], fit.laplace.sd[j]
    low, high = target.box
    grid = np.linspace(max(low[j], centre[j] - width * sd), min(high[j], centre[j] + width * sd), points)
    along = fit.laplace.covariance[: len(centre), j] / sd**2
    cost = np.full(points, np.inf)
    limits = settings or LocalSettings(tolerance=1e-4)
    middle = int(np.argmin(np.abs(grid - centre[j])))
    # From the middle outwards, so that each point starts where its neighbour ended.
    for side in (range(middle, points), range(middle - 1, -1, -1)):
        at, last = centre, centre[j]
        for k in side:
            start = at + along * (grid[k] - last)
            start[j] = grid[k]
            lower, upper = low.copy(), high.copy()
            lower[j] = upper[j] = grid[k]
            found = levenberg_marquardt(cost_function, start, lower, upper, limits)
            cost[k] = found.cost
            if np.isfinite(found.cost):
                at, last = found.point, grid[k]
    item = fit.calibration.parameters.items[column]
    values = np.exp(grid) if item.scale == "log" else grid * (item.upper - item.lower)
    lowest = cost.min() if np.isfinite(cost).any() else 0.0  # no run of the profile may have been completed
    return LikelihoodProfile(name, item.unit, values, cost - lowest)

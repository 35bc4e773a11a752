"""The log-posterior that searches maximise and samplers draw from, over search coordinates; its profile.

A point is the free parameters' search coordinates followed by the logarithms of the noise parameters.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.levenberg_marquardt import FixedCost, LocalSettings, QuadraticModel, levenberg_marquardt
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.noise import OutputNoise
from aero_bayes.estimate.objective import objective_of
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.plain import INTERNAL, Numbers
from aero_bayes.simulation.interface import Outcome, Simulator

if TYPE_CHECKING:
    from aero_bayes.estimate.result import Fit

_NOISE_PARTS = ("sd_white", "sd_ou", "tau")


@dataclass(frozen=True)
class NoiseLayout:
    """Which noise parameters are free, as logarithms, with weak log-normal priors on the scale of the data.

    White noise has its prior median at 1 % of the output's range, correlated noise at 3 %, the correlation time at the
    geometric mean of sample interval and duration."""

    outputs: tuple[str, ...]
    reference: tuple[OutputNoise, ...]
    centre: FloatArray
    sigma: float = 2.5
    limit: float = 12.0

    @classmethod
    def of(cls, data: MeasuredData, noise: Mapping[str, OutputNoise]) -> NoiseLayout:
        scale, outputs = data.scale, data.outputs
        interval = min(data.intervals)
        duration = max(float(e.time[-1] - e.time[0]) for e in data.experiments)
        centre = np.log(np.stack([0.01 * scale, 0.03 * scale, np.full(scale.shape, np.sqrt(interval * duration))], 1))
        return cls(outputs, tuple(noise[name] for name in outputs), centre)

    @property
    def _mask(self) -> NDArray[np.bool_]:
        return np.array([n.estimated for n in self.reference], dtype=bool)

    @property
    def size(self) -> int:
        return int(self._mask.sum())

    @property
    def names(self) -> tuple[str, ...]:
        """Such as ``noise.y.sd_white``."""
        return tuple(f"noise.{self.outputs[k]}.{_NOISE_PARTS[j]}" for k, j in np.argwhere(self._mask))

    def pack(self, noise: Mapping[str, OutputNoise]) -> FloatArray:
        """Return the coordinates of an estimate, shape (q,)."""
        rows = np.array([noise[name].as_row() for name in self.outputs])
        return np.asarray(np.log(rows[self._mask]))

    def unpack(self, coordinates: FloatArray) -> FloatArray:
        """Return noise triples as a simulator takes them, shape (n, 1, m, 3)."""
        full = np.tile(np.array([n.as_row() for n in self.reference]), (len(coordinates), 1, 1))
        full[:, self._mask] = np.exp(coordinates)
        return full[:, None]

    def estimates(self, coordinates: FloatArray) -> dict[str, OutputNoise]:
        """Return the estimate at one point, shape (q,)."""
        rows = self.unpack(coordinates[None])[0, 0]
        return {
            name: replace(reference, sd_white=float(row[0]), sd_ou=float(row[1]), tau=float(row[2]))
            for name, reference, row in zip(self.outputs, self.reference, rows, strict=True)
        }

    def log_prior(self, coordinates: FloatArray) -> FloatArray:
        """Compute the log-density, shape (n,)."""
        z = (coordinates - self.centre[self._mask]) / self.sigma
        density = -0.5 * np.sum(z**2, axis=1) - self.size * np.log(self.sigma * np.sqrt(2.0 * np.pi))
        return np.asarray(np.where(np.all(np.abs(z * self.sigma) < self.limit, axis=1), density, -np.inf))


@dataclass(frozen=True, eq=False)
class CurvatureAdjustment:
    """Curvature adjustment of a likelihood that takes correlated readings for independent.

    After Ribatet, Cooley & Davison (2012, Statistica Sinica 22, 813). The slope of the log-likelihood at the centre,
    which balances that of the ``prior`` (f,) there, stays as it is: so the mode of the posterior is that of the fit."""

    centre: FloatArray
    map: FloatArray
    prior: FloatArray

    def __call__(self, coordinates: FloatArray) -> FloatArray:
        """Return the points at which the likelihood of points (n, f) is computed."""
        return self.centre + (coordinates - self.centre) @ self.map.T

    @property
    def slope(self) -> FloatArray:
        """Slope (f,) that the log-likelihood lost, which is added."""
        return np.asarray(self.prior @ self.map - self.prior)

    def added(self, coordinates: FloatArray) -> FloatArray:
        """Return what is added to the log-likelihood at points (n, f), shape (n,)."""
        return np.asarray((coordinates - self.centre) @ self.slope)


class LogPosterior:
    """Log-posterior of a calibration over some of its parameters, reduced in the engine."""

    def __init__(
        self,
        calibration: Calibration,
        simulator: Simulator,
        base: FloatArray,
        free: Sequence[int],
        *,
        prior: bool = True,
        widening: CurvatureAdjustment | None = None,
    ) -> None:
        self.calibration, self.simulator, self.prior, self.widening = calibration, simulator, prior, widening
        self.objective = objective_of(calibration, simulator)
        self.base, self.free = np.asarray(base, dtype=np.float64), tuple(free)
        items = calibration.parameters.items
        self.parameters = type(calibration.parameters)(tuple(items[j] for j in self.free))

    @property
    def outcomes(self) -> Counter[Outcome]:
        """How the simulations ended."""
        return self.objective.outcomes

    @property
    def box(self) -> tuple[FloatArray, FloatArray]:
        return self.parameters.box

    def values(self, coordinates: FloatArray) -> FloatArray:
        """Compute SI values of all parameters at free coordinates (n, f): shape (n, p)."""
        full = np.tile(self.base, (len(coordinates), 1))
        full[:, self.free] = self.parameters.from_search(coordinates)
        return full

    def log_likelihood(self, coordinates: FloatArray, noise: FloatArray) -> FloatArray:
        """Compute the log-likelihood of each experiment, shape (n, E); minus infinity where the run failed."""
        at = coordinates if self.widening is None else self.widening(coordinates)
        return self.objective.log_likelihood(self.values(at), noise)

    def cost(self, coordinates: FloatArray, noise: FloatArray) -> FloatArray:
        """Compute the negative log-posterior at given noise, shape (n,)."""
        total = np.sum(self.log_likelihood(coordinates, noise), axis=1)
        if self.widening is not None:
            total = total + self.widening.added(coordinates)
        if self.prior:
            total = total + self.parameters.log_prior(coordinates)
        return np.where(np.isfinite(total), -total, np.inf)

    def cost_function(self, noise: Mapping[str, OutputNoise]) -> FixedCost:
        """Return the negative log-posterior at given noise, with gradient and Gauss-Newton Hessian."""
        base, free = self.calibration.parameters.to_search(self.base), list(self.free)

        def quadratic(point: FloatArray) -> QuadraticModel | None:
            full = base.copy()
            full[free] = point if self.widening is None else self.widening(point[None])[0]
            found = self.objective.evaluate(full, free)
            if found is None:
                return None
            white = self.objective.whiten(found, noise)
            cost, gradient, hessian = -white.log_likelihood, -white.score, white.information
            if self.widening is not None:
                gradient, hessian = gradient @ self.widening.map, self.widening.map.T @ hessian @ self.widening.map
                cost, gradient = cost - float(self.widening.added(point[None])[0]), gradient - self.widening.slope
            if self.prior:
                first, second = self.parameters.prior_derivatives(point)
                cost -= float(self.parameters.log_prior(point[None])[0])
                gradient = gradient - first
                hessian = hessian + np.diag(np.maximum(-second, 0.0)) + self.parameters.coupling
            return QuadraticModel(cost, gradient, hessian) if np.isfinite(cost) else None

        return FixedCost(quadratic)


class JointLogPosterior:
    """Joint log-posterior of parameters and noise, for a sampler.

    A point has the ``f`` free parameters, then the ``q`` noise parameters; points have shape (n, f + q)."""

    def __init__(self, target: LogPosterior, layout: NoiseLayout) -> None:
        self.target, self.layout = target, layout
        self.names = target.parameters.names + layout.names

    @property
    def dimension(self) -> int:
        return len(self.names)

    @property
    def axes(self) -> FloatArray:
        """Linear functions of a point along which the likelihood may have corners: its own coordinates (d, d)."""
        axes = np.eye(self.dimension)
        if self.target.widening is not None:
            axes[: len(self.target.free), : len(self.target.free)] = self.target.widening.map
        return axes

    def log_prior(self, points: FloatArray) -> FloatArray:
        f = len(self.target.free)
        return np.asarray(self.target.parameters.log_prior(points[:, :f]) + self.layout.log_prior(points[:, f:]))

    def __call__(self, points: FloatArray) -> FloatArray:
        """Compute the log-posterior, shape (n,). Points outside the priors' support are not simulated."""
        points = np.asarray(points, dtype=np.float64)
        f = len(self.target.free)
        total = np.full(len(points), -np.inf)
        finite = np.all(np.isfinite(points), axis=1)
        total[finite] = self.log_prior(points[finite])
        inside = np.isfinite(total)
        if inside.any():
            noise = self.layout.unpack(points[inside, f:])
            likelihood = np.sum(self.target.log_likelihood(points[inside, :f], noise), axis=1)
            if self.target.widening is not None:
                likelihood = likelihood + self.target.widening.added(points[inside, :f])
            total[inside] += np.where(np.isnan(likelihood), -np.inf, likelihood)
        return total


#: Drop of the log-posterior at the ends of a 90 % interval: half the 90 % quantile of chi-squared (1 degree of
#: freedom).
LOG_POSTERIOR_DROP_90 = 1.3527


@dataclass(frozen=True)
class LikelihoodProfile:
    """Profile of the log-posterior over one parameter, at the fitted noise.

    ``values`` (k,) are in SI units. ``drop`` (k,) is the largest log-posterior of all less the one at each value: zero
    at the best value, and infinite where every simulation failed; ``prior_drop`` (k,) that of the prior alone.
    ``interval`` has the ends of the 90 % interval, None on a side where the profile does not drop that far within the
    range; ``bounded`` says whether the data and the priors bound the parameter on both sides."""

    name: str = field(metadata=INTERNAL)
    values: Numbers
    drop: Numbers
    interval: tuple[float | None, ...]
    unit: str = ""
    prior_drop: Numbers = field(default_factory=lambda: np.empty(0))
    bounded: bool | None = None


def _crossing(values: FloatArray, drop: FloatArray) -> float | None:
    """Return where a profile drops by that much, from its best value on; None if it does not."""
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
    """Fix one free parameter of a fit at values across its range, and fit all others again at each."""
    column = fit.calibration.parameters.index(name)
    if column not in fit.free:
        raise InputError(f"{name} was not fitted, so it has no profile")
    target = fit.target(simulator)
    cost_function = target.cost_function(fit.noise)
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
    drop = cost - lowest
    best = int(np.argmin(drop))
    sides = slice(best, None, -1), slice(best, None)
    interval = tuple(_crossing(values[side], drop[side]) for side in sides)
    alone = ParameterSet((item,))
    prior = alone.log_prior(alone.to_search(values[:, None]))
    return LikelihoodProfile(name, values, drop, interval, item.unit, prior.max() - prior, None not in interval)

"""A local fit: its cost, its optimum with the Gaussian approximation there, and fits of ever longer horizons.

The likelihood of a long recording of an oscillating or unstable system has many local optima; that of its beginning has
few. Multiple shooting is another remedy (Voss, Timmer and Kurths, 2004, Int. J. Bifurcation and Chaos 14, 1905).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.checkpoint import Arrays, pack, unpack
from aero_bayes.data.noise_floor import noise_floors
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.levenberg_marquardt import (
    LocalResult,
    LocalSettings,
    QuadraticModel,
    Stop,
    cost_shape,
    levenberg_marquardt,
)
from aero_bayes.estimate.noise import NoiseKind, OutputNoise
from aero_bayes.estimate.noise_estimation import update_output_noise
from aero_bayes.estimate.objective import Evaluation, Objective, Whitened
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.simulation.interface import Problem, Simulator

#: Smallest noise as a share of an output's range: data without noise leave no more than the rounding of numbers.
ROUNDING = 1e-13
#: A fit converges to a known optimum if its quadratic model predicts at least this share of its largest decrease there,
#: and at least this share of the predicted decrease is real.
MIN_PREDICTED_SHARE, MIN_REALISED_SHARE = 0.9, 0.5


@dataclass(frozen=True)
class LocalFitSettings:
    """When a local fit stops, and what the noise may be: its kind (``auto`` where an output is not named) and its least
    white part by output. With ``hold_noise`` it is not estimated; ``prior`` tells whether the priors count."""

    local: LocalSettings = field(
        default_factory=lambda: LocalSettings(
            iterations=30, tolerance=0.02, min_noise_gain=0.1, max_rejections=6, min_decrease=0.1
        )
    )
    kinds: Mapping[str, NoiseKind] = field(default_factory=dict)
    floors: Mapping[str, float] = field(default_factory=dict)
    hold_noise: bool = False
    prior: bool = True

    def with_limits(self, iterations: int, tolerance: float) -> LocalFitSettings:
        """Return settings with other limits, for a fit that need not be exact."""
        return replace(self, local=replace(self.local, iterations=iterations, tolerance=tolerance))

    def least_squares(self, outputs: Iterable[str]) -> LocalFitSettings:
        """Return settings with white noise of each output, so that the fit is one of least squares."""
        return replace(self, kinds=dict.fromkeys(outputs, "white"))


@dataclass(frozen=True, eq=False)
class Optimum:
    """A local optimum of the log-posterior over the free columns, with its Laplace approximation.

    ``coordinates`` (p,) are search coordinates of all columns; ``covariance`` is that of the ``free`` ones."""

    free: tuple[int, ...]
    coordinates: FloatArray
    noise: Mapping[str, OutputNoise]
    log_likelihood: float
    log_prior: float
    covariance: FloatArray
    evaluation: Evaluation
    whitened: Whitened
    reason: Stop
    steps: int

    def sd(self, column: int) -> float:
        """Compute the standard deviation of a free column's search coordinate."""
        k = self.free.index(column)
        return math.sqrt(max(float(self.covariance[k, k]), 0.0))

    def laplace(self, parameters: ParameterSet, temperature: float = 1.0) -> tuple[FloatArray, float]:
        """Compute covariance and log-evidence of the posterior with the likelihood to the power ``1 / temperature``.

        By Laplace's approximation (MacKay, 1992, Neural Computation 4, 415)."""
        curvature = parameters.prior_curvature(parameters.prior_derivatives(self.coordinates)[1], self.free)
        columns, hessian = list(self.free), self.whitened.information / temperature + curvature
        low, high = (bound[columns] for bound in parameters.box)
        volume = 0.5 * (len(columns) * math.log(2.0 * math.pi) - log_precision(hessian, high - low))
        covariance = parameter_covariance(hessian, parameters.prior_sd()[columns])
        return covariance, self.log_likelihood / temperature + self.log_prior + volume


@dataclass(frozen=True, eq=False)
class _PosteriorModel(QuadraticModel):
    point: FloatArray
    evaluation: Evaluation
    whitened: Whitened
    noise: Mapping[str, OutputNoise]
    log_prior: float

    @property
    def unit(self) -> float:
        """One nat under the noise that the fit leaves, where that is smaller than the noise it is given.

        Else a fit under the noise of a worse model would end far from its optimum, in units of what it leaves itself.
        """
        residual = self.whitened.residual
        return min(float(residual @ residual) / max(self.whitened.readings, 1), 1.0)


def fit_noise(
    objective: Objective,
    residual: Sequence[FloatArray],
    settings: LocalFitSettings,
    start: Mapping[str, OutputNoise] | None = None,
) -> dict[str, OutputNoise]:
    """Estimate the noise of each output by maximum likelihood, pooled over its recordings."""
    noise = {}
    known = objective.calibration.known_noise
    for output in objective.outputs:
        if output in known:
            noise[output] = known[output]
            continue
        own = [k for k, series in enumerate(objective.series) if series.output == output]
        scale = float(objective.calibration.data.scale[objective.calibration.data.outputs.index(output)])
        floor = max(settings.floors.get(output, 0.0), ROUNDING * scale)
        if settings.kinds.get(output, "auto") == "white":
            count = sum(residual[k].size for k in own)
            equal = [objective.series[k].sampling.equalised(residual[k]) for k in own]
            rms = math.sqrt(sum(float(r @ r) for r in equal) / max(count, 1))
            noise[output] = OutputNoise(max(rms, floor))
            continue
        noise[output] = update_output_noise(
            [residual[k] for k in own], [objective.series[k].sampling for k in own], floor=floor,
            start=start.get(output) if start is not None else None,
        )  # fmt: skip
    return noise


class _NegativeLogPosterior:
    """The negative log-posterior over the free columns, the other columns fixed."""

    def __init__(
        self,
        objective: Objective,
        start: FloatArray,
        free: Sequence[int],
        noise: Mapping[str, OutputNoise] | None,
        settings: LocalFitSettings,
        known: Sequence[Optimum] = (),
    ) -> None:
        self.objective, self.settings, self.known = objective, settings, known
        self.base, self.free = np.array(start, dtype=np.float64), list(free)
        self.noise = dict(noise) if noise is not None else None

    def full(self, point: FloatArray) -> FloatArray:
        x = self.base.copy()
        x[self.free] = point
        return x

    def evaluate(self, point: FloatArray) -> _PosteriorModel | None:
        x = self.full(point)
        found = self.objective.evaluate(x, self.free)
        if found is None:
            return None
        self.noise = self.objective.reading_noise(x) or self.noise
        if self.noise is None:
            self.noise = fit_noise(self.objective, found.residual, self.settings)
        return self._quadratic(x, found, self.noise)

    def update_noise(self, here: _PosteriorModel) -> _PosteriorModel:
        if self.settings.hold_noise or self.objective.filters:
            return here
        noise = fit_noise(self.objective, here.evaluation.residual, self.settings, self.noise)
        white = self.objective.whiten(replace(here.evaluation, slopes=None), noise)
        if white.log_likelihood <= here.whitened.log_likelihood:
            return here
        self.noise = noise
        return self._quadratic(here.point, here.evaluation, noise)

    def leads_to_known(self, here: _PosteriorModel, newton: FloatArray) -> bool:
        """Tell if a fit from here would converge to a known optimum; costs are compared at the noise of this fit."""
        enough = MIN_PREDICTED_SHARE * here.predicted_decrease(newton)
        for optimum in self.known:
            predicted = here.predicted_decrease((optimum.coordinates - here.point)[self.free])
            if predicted >= enough and here.cost - self._cost(optimum) >= MIN_REALISED_SHARE * predicted:
                return True
        return False

    def _cost(self, optimum: Optimum) -> float:
        residual = replace(optimum.evaluation, slopes=None)
        white = self.objective.whiten(residual, {**optimum.noise, **(self.noise or {})})
        return -white.log_likelihood - self.log_prior(optimum.coordinates)

    def _quadratic(self, x: FloatArray, found: Evaluation, noise: Mapping[str, OutputNoise]) -> _PosteriorModel:
        white = self.objective.whiten(found, noise)
        gradient, curvature = self._prior_products(x)
        log_prior = self.log_prior(x)
        return _PosteriorModel(
            -white.log_likelihood - log_prior, gradient - white.score,
            white.information + curvature, x, found, white, noise, log_prior,
        )  # fmt: skip

    def restore(self, kept: Arrays) -> LocalResult[_PosteriorModel]:
        """Return the result of a search from the checkpoint, with one simulation, which is not counted again."""
        point, iterations, evaluations = kept["point"].astype(np.float64), int(kept["steps"][0]), int(kept["steps"][1])
        quadratic = None
        if "outputs" in kept:
            self.noise = {name: unpack(OutputNoise, kept, f"noise.{name}.") for name in kept["outputs"].tolist()}
            counted = Counter(self.objective.outcomes)
            quadratic = self.evaluate(point)
            self.objective.outcomes.clear()
            self.objective.outcomes.update(counted)
        return LocalResult(point, quadratic, iterations, Stop(str(kept["reason"])), evaluations)

    def log_prior(self, x: FloatArray) -> float:
        """Compute the log-density of the free columns' priors in search coordinates (fixed ones are not counted)."""
        if not self.settings.prior:
            return 0.0
        parameters = self.objective.parameters
        values = parameters.from_search(x)
        slopes = parameters.jacobian(values)
        own = sum(float(parameters.items[j].prior.log_pdf(values[j])) + math.log(float(slopes[j])) for j in self.free)
        return own + float(parameters.log_coupling(x))

    def _prior_products(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the gradient and curvature of the negative log-prior over the free columns."""
        count = len(self.free)
        if not self.settings.prior:
            return np.zeros(count), np.zeros((count, count))
        parameters = self.objective.parameters
        first, second = parameters.prior_derivatives(x)
        return -first[self.free], parameters.prior_curvature(second, self.free)


def _pack(found: LocalResult[_PosteriorModel]) -> Arrays:
    """Return what :meth:`_NegativeLogPosterior.restore` needs of the result of a search."""
    steps = np.array([found.iterations, found.evaluations])
    kept: dict[str, Any] = {"point": found.point, "steps": steps, "reason": np.array(found.reason.value)}
    if found.quadratic is not None:
        kept["outputs"] = np.array(list(found.quadratic.noise))
        for name, noise in found.quadratic.noise.items():
            kept |= pack(noise, f"noise.{name}.")
    return kept


#: Least eigenvalue of a Hessian that is scaled to a unit diagonal, as a share of the largest: below, it is rounding.
MIN_EIGENVALUE = 1e-12


def parameter_covariance(hessian: FloatArray, prior_sd: FloatArray) -> FloatArray:
    """Invert a Hessian (f, f) that contains the priors; a direction flatter than its prior gets the width of the prior.

    ``prior_sd`` (f,) are standard deviations of the priors in the same coordinates."""
    scaled = hessian * prior_sd[:, None] * prior_sd[None, :]
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    inverse = (vectors / np.maximum(values, 1.0)) @ vectors.T
    return np.asarray(inverse * prior_sd[:, None] * prior_sd[None, :])


def log_precision(hessian: FloatArray, width: FloatArray) -> float:
    """Compute the log-determinant of the precision of a Gaussian posterior in a box of a given width (f,).

    The Hessian (f, f) is scaled to a unit diagonal first, so that its small eigenvalues are directions that the data do
    not determine, whatever the units of the coordinates."""
    if not len(hessian):
        return 0.0
    unit, values, vectors = _scaled(hessian)
    # The posterior is nowhere wider than the box: in a direction that the data do not determine it has the box's width.
    limited = (vectors * values) @ vectors.T + np.diag(2.0 * math.pi * (unit / width) ** 2)
    return float(np.linalg.slogdet(limited)[1]) - 2.0 * float(np.log(unit).sum())


def unlimited_sd(hessian: FloatArray) -> FloatArray:
    """Compute standard deviations (f,) of a Gaussian by its Hessian alone: huge where nothing determines it."""
    unit, values, vectors = _scaled(hessian)
    return np.asarray(unit * np.sqrt(np.sum(vectors**2 / values, axis=1)))


def _scaled(hessian: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Scale a Hessian to a unit diagonal: the units (f,), its eigenvalues there, never zero, and its eigenvectors."""
    own = np.diag(hessian)
    unit = 1.0 / np.sqrt(np.where(own > 0.0, own, 1.0))
    values, vectors = np.linalg.eigh(hessian * np.outer(unit, unit))
    return unit, np.maximum(values, MIN_EIGENVALUE * max(float(values[-1]), 1.0)), vectors


_NO_START = (
    "the model cannot be simulated at the values where a fit starts: {}; a plant that is unstable without its "
    "controller needs the controller in the model"
)


def local_fit(
    objective: Objective,
    start: FloatArray,
    free: Sequence[int],
    *,
    noise: Mapping[str, OutputNoise] | None = None,
    settings: LocalFitSettings | None = None,
    known: Sequence[Optimum] = (),
    on_iteration: Callable[[int, float], object] | None = None,
) -> Optimum:
    """Maximise the log-posterior over some columns by :func:`levenberg_marquardt`."""
    settings = settings or LocalFitSettings()
    cost_function = _NegativeLogPosterior(objective, start, free, noise, settings, known)
    low, high = (bound[list(free)] for bound in objective.parameters.box)
    results: list[LocalResult[_PosteriorModel]] = []
    shape = cost_shape(objective.parameters, free, objective.calibration.data.intervals)

    def search() -> Arrays:
        results.append(levenberg_marquardt(
            cost_function, cost_function.base[list(free)], low, high, settings.local, on_iteration, shape=shape,
            leads_to_known=cost_function.leads_to_known,
        ))  # fmt: skip
        return _pack(results[0])

    key = cost_function.base, tuple(free), noise, settings, [end.coordinates for end in known]
    kept = objective.cached("local_fit", key, search, lambda: results[0].reason is not Stop.INTERRUPTED)
    found = results[0] if results else cost_function.restore(kept)
    if found.quadratic is None:
        raise CannotFinishError(_NO_START.format(objective.commonest_failure))
    here = found.quadratic
    covariance = parameter_covariance(here.hessian, objective.parameters.prior_sd()[list(free)])
    return Optimum(
        tuple(free), cost_function.full(found.point), dict(here.noise), here.whitened.log_likelihood, here.log_prior,
        covariance, here.evaluation, here.whitened, found.reason, found.iterations,
    )  # fmt: skip


OpenSimulator = Callable[[Problem], AbstractContextManager[Simulator]]

#: Shares of the recordings that are fitted one after the other.
HORIZON_SHARES = (0.05, 0.075, 0.11, 0.17, 0.25, 0.38, 0.57, 0.8)
#: Residual over noise floor up to which no other optimum can be much better.
GOOD_FIT_RATIO = 1.2
#: From this share on, the residuals must be at most this many times those of a fit that is known already.
MIN_CHECKED_SHARE, MAX_RESIDUAL_RATIO = 0.17, 0.8


def fit_progressive_horizon(
    whole: Objective,
    start: FloatArray,
    free: Sequence[int],
    settings: LocalFitSettings,
    open_simulator: OpenSimulator,
    known: FloatArray | None = None,
    on_iteration: Callable[[int, float], object] | None = None,
) -> tuple[FloatArray, int]:
    """Fit ever longer horizons by least squares."""
    by_squares = settings.least_squares(whole.outputs)

    def fit_horizons() -> Arrays:
        point, steps = start, 0
        for share in HORIZON_SHARES:
            part = replace(whole.calibration, data=whole.calibration.data.beginning(share))
            with open_simulator(part.problem()) as simulator, suppress(CannotFinishError):
                objective = whole.with_calibration(part, simulator)
                found = local_fit(objective, point, free, settings=by_squares, on_iteration=on_iteration)
                point, steps = found.coordinates, steps + found.steps
                if share >= MIN_CHECKED_SHARE and known is not None:
                    (reference,) = objective.residuals(known[np.newaxis, :])
                    if (
                        reference is not None
                        and _residual_ratio(found.evaluation.residual, reference.residual) > MAX_RESIDUAL_RATIO
                    ):
                        break
        return {"point": point, "steps": np.array(steps)}

    key = (start, tuple(free), by_squares, known)
    end = whole.cached("progressive_horizon", key, fit_horizons)
    return end["point"].astype(np.float64), int(end["steps"])


def floor_ratio(objective: Objective, residual: Sequence[FloatArray]) -> float:
    """Return the largest ratio of an output's RMS residual to its noise floor.

    Infinite where a noise floor is unknown."""
    recordings, worst = objective.calibration.data.recordings, 0.0
    floors = noise_floors(recordings, objective.outputs)
    if any((r.name, o) not in floors for r in recordings for o in objective.outputs if o in r.outputs):
        return math.inf
    for (_, output), floor in floors.items():
        own = [r for s, r in zip(objective.series, residual, strict=True) if s.output == output]
        size = math.sqrt(float(np.mean(np.concatenate(own) ** 2)))
        worst = max(worst, size / floor if floor > 0.0 else math.inf)
    return worst


def _residual_ratio(these: Sequence[FloatArray], those: Sequence[FloatArray]) -> float:
    """Compute the geometric mean over all series of the ratio of their RMS residuals."""
    logs = [
        0.5 * math.log(max(float(one @ one), 1e-300) / max(float(other @ other), 1e-300))
        for one, other in zip(these, those, strict=True)
    ]
    return math.exp(sum(logs) / len(logs))

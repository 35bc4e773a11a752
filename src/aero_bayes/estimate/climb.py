"""The climb: a bounded search on whitened residuals that renews the noise between its steps.

Each model under comparison gets its own most likely noise, so that evidence is a ratio of likelihoods in which a
thousand correlated samples do not count as a thousand. The noise also weighs the outputs.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from aero_bayes.checkpoint import Arrays, pack_all, unpack_all
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.objective import Evaluation, Objective, Whitened
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.search import Found, Ground, LocalSettings, Stop, search
from aero_bayes.estimate.shape import shape_of
from aero_bayes.sensors.noise import NoiseKind, OutputNoise, renew_noise

FloatArray = NDArray[np.float64]

#: A climb leads where an earlier one ended if its model expects this share of all that it promises there, and this
#: share of that is so.
THERE, SO = 0.9, 0.5


@dataclass(frozen=True)
class ClimbSettings:
    """When a climb stops, and what the noise may be.

    Parameters
    ----------
    local : LocalSettings
    kinds : mapping of str to {"auto", "white"}
        Noise by output; ``auto`` where it is not named.
    floors : mapping of str to float
        Least standard deviation of the white noise by output (a sensor's quantum over the square root of twelve).
    longest : float, optional
        Greatest correlation time in s.
    hold_noise : bool
        Leave the noise as it is.
    prior : bool
        Whether the priors count.
    """

    local: LocalSettings = field(
        default_factory=lambda: LocalSettings(
            max_iterations=30, tolerance=0.02, renewal=0.1, rejections=6, worthwhile=0.1
        )
    )
    kinds: Mapping[str, NoiseKind] = field(default_factory=dict)
    floors: Mapping[str, float] = field(default_factory=dict)
    longest: float | None = None
    hold_noise: bool = False
    prior: bool = True

    def aiming(self, cost: float) -> ClimbSettings:
        """The same, given up where a cost is out of reach."""
        return replace(self, local=replace(self.local, aim=cost))

    def rough(self, steps: int, tolerance: float) -> ClimbSettings:
        """The same with fewer steps and less care."""
        return replace(self, local=replace(self.local, max_iterations=steps, tolerance=tolerance))

    def counting(self, temperature: float) -> ClimbSettings:
        """The same as exact in log-likelihood over ``temperature``: what counts less need not be found as closely."""
        return replace(self, local=replace(self.local, tolerance=self.local.tolerance * temperature))

    def by_squares(self, outputs: Iterable[str]) -> ClimbSettings:
        """The same by the size of what is left."""
        return replace(self, kinds=dict.fromkeys(outputs, "white"))


@dataclass(frozen=True, eq=False)
class Optimum:
    """A local optimum of the log-posterior over the free columns, and Laplace's approximation there.

    ``coordinates`` (p,) are search coordinates of all columns; ``covariance`` is over the ``free`` ones.
    """

    free: tuple[int, ...]
    coordinates: FloatArray
    noise: Mapping[str, OutputNoise]
    log_likelihood: float
    log_prior: float
    log_evidence: float
    covariance: FloatArray
    evaluation: Evaluation
    whitened: Whitened
    reason: Stop
    steps: int

    def sd(self, column: int) -> float:
        """Standard deviation of a free column's search coordinate."""
        k = self.free.index(column)
        return math.sqrt(max(float(self.covariance[k, k]), 0.0))

    def under(self, objective: Objective, noise: Mapping[str, OutputNoise]) -> Optimum:
        """The same point with likelihood, covariance and evidence under another noise; nothing is simulated.

        Where all outputs keep their relative weights the point is still the optimum, but for the priors.
        """
        noise, parameters = {**self.noise, **noise}, objective.parameters
        white = objective.whiten(self.evaluation.residual, self.evaluation.slopes, noise)
        moved = replace(self, noise=noise, log_likelihood=white.log_likelihood, whitened=white)
        covariance, evidence = moved.tempered(parameters)
        return replace(moved, covariance=covariance, log_evidence=evidence)

    def tempered(self, parameters: ParameterSet, temperature: float = 1.0) -> tuple[FloatArray, float]:
        """Covariance and log-evidence, by Laplace's approximation, where the likelihood counts to the power
        ``1 / temperature``."""
        second = parameters.prior_derivatives(self.coordinates)[1][list(self.free)]
        low, high = (bound[list(self.free)] for bound in parameters.box)
        curvature = self.whitened.slopes @ self.whitened.slopes.T / temperature
        covariance, volume = _laplace(curvature + np.diag(np.maximum(-second, 1e-9)), high - low)
        occam = 0.5 * len(covariance) * math.log(2.0 * math.pi) - 0.5 * volume
        return covariance, self.log_likelihood / temperature + self.log_prior + occam


@dataclass(frozen=True, eq=False)
class _Slope(Ground):
    point: FloatArray
    evaluation: Evaluation
    whitened: Whitened
    noise: Mapping[str, OutputNoise]
    log_prior: float


def noise_of(
    objective: Objective,
    residual: Sequence[FloatArray],
    settings: ClimbSettings,
    start: Mapping[str, OutputNoise] | None = None,
) -> dict[str, OutputNoise]:
    """Most likely noise of every output, its recordings pooled."""
    noise = {}
    for output in objective.outputs:
        own = [k for k, series in enumerate(objective.series) if series.output == output]
        floor = settings.floors.get(output, 0.0)
        if settings.kinds.get(output, "auto") == "white":
            count = sum(residual[k].size for k in own)
            rms = math.sqrt(sum(float(residual[k] @ residual[k]) for k in own) / max(count, 1))
            noise[output] = OutputNoise(max(rms, floor, 1e-300))
            continue
        noise[output] = renew_noise(
            [residual[k] for k in own], [objective.series[k].sampling for k in own], floor=floor,
            longest=settings.longest, start=start.get(output) if start is not None else None,
        )  # fmt: skip
    return noise


class _Posterior:
    """The negative log-posterior over the free columns, all others held: what a climb descends."""

    def __init__(
        self,
        objective: Objective,
        start: FloatArray,
        free: Sequence[int],
        noise: Mapping[str, OutputNoise] | None,
        settings: ClimbSettings,
        known: Sequence[Optimum] = (),
    ) -> None:
        self.objective, self.settings, self.known = objective, settings, known
        self.base, self.free = np.array(start, dtype=np.float64), list(free)
        self.noise = dict(noise) if noise is not None else None

    def full(self, point: FloatArray) -> FloatArray:
        x = self.base.copy()
        x[self.free] = point
        return x

    def look(self, point: FloatArray) -> _Slope | None:
        x = self.full(point)
        found = self.objective.evaluate(x, self.free)
        if found is None:
            return None
        if self.noise is None:
            self.noise = noise_of(self.objective, found.residual, self.settings)
        return self._ground(x, found, self.noise)

    def renew(self, here: _Slope) -> _Slope:
        if self.settings.hold_noise:
            return here
        noise = noise_of(self.objective, here.evaluation.residual, self.settings, self.noise)
        white = self.objective.whiten(here.evaluation.residual, None, noise)
        if white.log_likelihood <= here.whitened.log_likelihood:
            return here
        self.noise = noise
        return self._ground(here.point, here.evaluation, noise)

    def met(self, here: _Slope, newton: FloatArray) -> bool:
        """Whether a climb from here leads to one of the known ends, each looked at under the noise of this one."""
        least = THERE * here.promise(newton)
        for end in self.known:
            expected = here.promise((end.coordinates - here.point)[self.free])
            if expected >= least and here.cost - self._cost(end) >= SO * expected:
                return True
        return False

    def _cost(self, end: Optimum) -> float:
        white = self.objective.whiten(end.evaluation.residual, None, {**end.noise, **(self.noise or {})})
        return -white.log_likelihood - self.log_prior(end.coordinates)

    def _ground(self, x: FloatArray, found: Evaluation, noise: Mapping[str, OutputNoise]) -> _Slope:
        white = self.objective.whiten(found.residual, found.slopes, noise)
        gradient, curvature = self._prior_products(x)
        log_prior = self.log_prior(x)
        return _Slope(
            -white.log_likelihood - log_prior, gradient - white.slopes @ white.residual,
            white.slopes @ white.slopes.T + curvature, x, found, white, noise, log_prior,
        )  # fmt: skip

    def back(self, kept: Arrays) -> Found[_Slope]:
        """The end of a descent that was made before: one simulation, which is not counted again."""
        point, iterations, evaluations = kept["point"].astype(np.float64), int(kept["steps"][0]), int(kept["steps"][1])
        ground = None
        if "outputs" in kept:
            rows = unpack_all(OutputNoise, kept)
            self.noise = dict(zip(kept["outputs"].tolist(), rows, strict=True))
            counted = Counter(self.objective.outcomes)
            ground = self.look(point)
            self.objective.outcomes.clear()
            self.objective.outcomes.update(counted)
        return Found(point, ground, iterations, Stop(str(kept["reason"])), evaluations)

    def log_prior(self, x: FloatArray) -> float:
        """Log-density of the free columns' priors in search coordinates (fixed ones are not counted)."""
        if not self.settings.prior:
            return 0.0
        parameters = self.objective.parameters
        values = parameters.from_search(x)
        slopes = parameters.jacobian(values)
        return sum(float(parameters.items[j].prior.log_pdf(values[j])) + math.log(float(slopes[j])) for j in self.free)

    def _prior_products(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradient and curvature of the negative log-prior over the free columns."""
        count = len(self.free)
        if not self.settings.prior:
            return np.zeros(count), np.zeros((count, count))
        parameters = self.objective.parameters
        first, second = parameters.prior_derivatives(x)
        curvature = np.diag(np.maximum(-second, 1e-9))
        return -first[self.free], curvature[np.ix_(self.free, self.free)]


def _packed(found: Found[_Slope]) -> Arrays:
    """What :meth:`_Posterior.back` needs of the end of a descent."""
    steps = np.array([found.iterations, found.evaluations])
    kept = {"point": found.point, "steps": steps, "reason": np.array(found.reason.value)}
    if found.ground is None:
        return kept
    return kept | {"outputs": np.array(list(found.ground.noise)), **pack_all(list(found.ground.noise.values()))}


def _laplace(hessian: FloatArray, width: FloatArray) -> tuple[FloatArray, float]:
    """Covariance of a normal posterior, and the logarithm of its precision's determinant, within a box of a width.

    A coordinate may be of any size: in its own unit of curvature nothing but what the data do not see is near zero.
    """
    if not len(hessian):
        return hessian, 0.0
    own = np.diag(hessian)
    unit = 1.0 / np.sqrt(np.where(own > 0.0, own, 1.0))
    values, vectors = np.linalg.eigh(hessian * np.outer(unit, unit))
    values = np.maximum(values, 1e-12 * max(float(values[-1]), 1.0))
    # The posterior is nowhere wider than the box: in a direction that the data do not see it has the box's width.
    _, volume = np.linalg.slogdet((vectors * values) @ vectors.T + np.diag(2.0 * math.pi * (unit / width) ** 2))
    spread = unit[:, np.newaxis] * vectors / np.sqrt(values)
    return spread @ spread.T, float(volume) - 2.0 * float(np.log(unit).sum())


def climb(
    objective: Objective,
    start: FloatArray,
    free: Sequence[int],
    *,
    noise: Mapping[str, OutputNoise] | None = None,
    settings: ClimbSettings | None = None,
    known: Sequence[Optimum] = (),
) -> Optimum:
    """Climb from ``start`` (search coordinates of all columns) over the ``free`` columns.

    It ends early where it leads to one of those ``known``, of the same objective and columns.

    Raises
    ------
    CannotFinishError
        If the model cannot be simulated at the start.
    """
    settings = settings or ClimbSettings()
    terrain = _Posterior(objective, start, free, noise, settings, known)
    low, high = (bound[list(free)] for bound in objective.parameters.box)
    ends: list[Found[_Slope]] = []

    def descend() -> Arrays:
        shape = shape_of(objective.parameters, free, objective.calibration.intervals)
        ends.append(search(terrain, terrain.base[list(free)], low, high, settings.local, shape=shape, met=terrain.met))
        return _packed(ends[0])

    asked = terrain.base, tuple(free), noise, settings, [end.coordinates for end in known]
    kept = objective.once("climb", asked, descend)
    found = ends[0] if ends else terrain.back(kept)
    if found.ground is None:
        raise CannotFinishError(
            f"the model cannot be simulated at the values where a fit starts: {objective.commonest_failure}; a plant "
            "that is unstable without its controller needs the controller in the model"
        )
    here = found.ground
    covariance, volume = _laplace(here.hessian, high - low)
    occam = 0.5 * len(covariance) * math.log(2.0 * math.pi) - 0.5 * volume
    likelihood = here.whitened.log_likelihood
    return Optimum(
        tuple(free), terrain.full(found.point), dict(here.noise), likelihood, here.log_prior,
        likelihood + here.log_prior + occam, covariance, here.evaluation, here.whitened,
        found.reason, found.iterations,
    )  # fmt: skip

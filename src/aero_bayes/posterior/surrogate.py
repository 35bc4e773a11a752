"""A surrogate of an expensive log-density: Gaussian process regression on points where it was evaluated."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from aero_bayes.arrays import FloatArray
from aero_bayes.posterior.moves import WarpedStudentT

#: Length scales, amplitudes (nats squared) and relative roughnesses among which the marginal likelihood chooses.
_LENGTHS, _WARPED_LENGTHS, _AMPLITUDES = (2.0, 5.0, 12.0, 30.0), (1.0, 3.0), 10.0 ** np.arange(0, 6)
_ROUGHNESSES = (0.0, 0.1, 1.0)
#: Correlation length of the part with corners.
_ROUGH_LENGTH = 3.0
#: Standard deviation of the error at the mode, in nats; it grows with the depth below the mode.
_NOISE_AT_MODE = 0.02
#: Points that fit the length scales, and points of the surrogate.
_HYPERPARAMETER_POINTS, _MAX_POINTS = 300, 2000


@dataclass(frozen=True, eq=False)
class Kernel:
    """Covariance of a smooth function of scores that may have corners along some of them.

    A rational quadratic kernel is multiplied by one plus an exponential kernel of single scores."""

    lengths: FloatArray
    rough: FloatArray

    def __call__(self, one: FloatArray, two: FloatArray) -> FloatArray:
        """Return the correlations of scores (n, d) with (m, d), shape (n, m)."""
        a, b = one / self.lengths, two / self.lengths
        kernel = a @ -b.T
        kernel += 0.5 * np.sum(a**2, axis=1)[:, None]
        kernel += 0.5 * np.sum(b**2, axis=1) + 1.0
        np.reciprocal(np.maximum(kernel, 1.0, out=kernel), out=kernel)
        if not self.rough.any():
            return kernel
        factor = np.ones_like(kernel)
        for j in np.flatnonzero(self.rough):
            distance = np.abs(np.subtract.outer(one[:, j], two[:, j]))
            distance /= -_ROUGH_LENGTH
            factor += self.rough[j] * np.exp(distance, out=distance)
        return np.asarray(np.multiply(kernel, factor, out=kernel))


@dataclass(frozen=True, eq=False)
class Surrogate:
    """A quadratic plus a Gaussian process, over scores of a :class:`WarpedStudentT`.

    The regression is that of Rasmussen and Williams (2006), Gaussian Processes for Machine Learning, sections 2.7, 4.2
    and 5.4; the marginal likelihood chooses the kernel."""

    coordinates: WarpedStudentT
    quadratic: FloatArray
    centres: FloatArray
    kernel: Kernel
    weights: FloatArray
    radius: float

    @staticmethod
    def least(dimension: int) -> int:
        """Return the number of points that a fit needs."""
        return 3 * (dimension + 1) * (dimension + 2) // 4 + 10

    @classmethod
    def fit(cls, coordinates: WarpedStudentT, points: FloatArray, values: FloatArray, depth: FloatArray) -> Surrogate:
        """Fit to ``values`` (n,) at ``points`` (n, d)."""
        d = points.shape[1]
        most = max(min(_MAX_POINTS, 25 * cls.least(d)), 3 * cls.least(d))
        rows = _spread(len(points), most)
        if len(points) > most:
            rows = np.concatenate(
                [np.arange(most // 2), most // 2 + _spread(len(points) - most // 2, most - most // 2)]
            )
        scores, error = coordinates.scores(points[rows])[0], _NOISE_AT_MODE * (1.0 + depth[rows])
        pairs = list(itertools.combinations_with_replacement(range(d + 1), 2))
        ahead = np.insert(scores, 0, 1.0, axis=1)
        design = np.stack([ahead[:, i] * ahead[:, j] for i, j in pairs], axis=1)
        weight = 1.0 / (1.0 + depth[rows] / 3.0)
        ridge = 1e-6 * len(rows) * np.eye(len(pairs))
        weighed = design * weight[:, None]
        level = float(np.max(values[rows]))
        found = np.linalg.solve(weighed.T @ weighed + ridge, weighed.T @ (weight * (values[rows] - level)))
        quadratic = np.zeros((d + 1, d + 1))
        quadratic[tuple(np.transpose(pairs))] = found
        rest = values[rows] - level - design @ found
        quadratic[0, 0] += level
        some = _spread(len(rows), _HYPERPARAMETER_POINTS)
        kernel, amplitude = _choose(scores[some], rest[some], error[some], coordinates.warp.warped)
        covariance = amplitude * kernel(scores, scores) + np.diag(error**2)
        weights = amplitude * cho_solve(cho_factor(covariance, lower=True), rest)
        radius = float(np.max(np.linalg.norm(scores, axis=1)))
        return cls(coordinates, quadratic, scores, kernel, weights, radius)

    def __call__(self, points: FloatArray) -> FloatArray:
        """Predict values at points (n, d), shape (n,)."""
        scores = self.coordinates.scores(points)[0]
        ahead = np.insert(scores, 0, 1.0, axis=1)
        outside = np.maximum(np.linalg.norm(scores, axis=1) - self.radius, 0.0)
        smooth = np.einsum("ni,ij,nj->n", ahead, self.quadratic, ahead, optimize=True)
        return np.asarray(smooth + self.kernel(scores, self.centres) @ self.weights - outside**2)


def _spread(count: int, most: int) -> NDArray[np.int64]:
    """Choose at most ``most`` of ``count`` rows, evenly."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))


def _choose(scores: FloatArray, rest: FloatArray, error: FloatArray, warped: NDArray[np.bool_]) -> tuple[Kernel, float]:
    """Choose the kernel and amplitude of the largest marginal likelihood."""
    best, found = -np.inf, (Kernel(np.ones(scores.shape[1]), np.zeros(scores.shape[1])), 1.0)
    shapes = [(length, length, 0.0) for length in _LENGTHS]
    if warped.any():
        shapes = [
            (length, short, rough)
            for length in _LENGTHS
            for short in (length, *(b for b in _WARPED_LENGTHS if b < length))
            for rough in _ROUGHNESSES
        ]
    for length, short, rough in shapes:
        kernel = Kernel(np.where(warped, short, length), np.where(warped, rough, 0.0))
        values, vectors = np.linalg.eigh(kernel(scores, scores) / np.outer(error, error))
        projected = (vectors.T @ (rest / error)) ** 2
        for amplitude in _AMPLITUDES:
            spread = amplitude * np.maximum(values, 0.0) + 1.0
            evidence = -0.5 * float(np.sum(projected / spread + np.log(spread)))
            if evidence > best:
                best, found = evidence, (kernel, float(amplitude))
    return found

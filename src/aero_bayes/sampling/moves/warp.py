"""Transform each coordinate by itself, so that skewed margins look normal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from aero_bayes.arrays import FloatArray

#: Departure of a quantile from that of a normal density, in standard deviations, above which a coordinate is warped.
MIN_DEPARTURE = 0.3

#: Knots of the maps, in standard deviations.
KNOT_SCORES = np.array([-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0])


@dataclass(frozen=True, eq=False)
class Warp:
    """Apply increasing, piecewise linear maps from each coordinate x to a score z; ``knots`` and ``scores`` are (d, k).

    Beyond the outer knots the maps go on with the slope ``tails`` (d, 2)."""

    knots: FloatArray
    scores: FloatArray
    tails: FloatArray

    @classmethod
    def identity(cls, dimension: int) -> Warp:
        """Return the maps that change nothing."""
        ends = np.tile([-1.0, 1.0], (dimension, 1))
        return cls(ends, ends.copy(), np.ones((dimension, 2)))

    @classmethod
    def fit(cls, samples: FloatArray) -> Warp:
        """Fit maps under which the quantiles of ``samples`` (n, d) become those of a standard normal."""
        return cls.through(np.quantile(samples, ndtr(KNOT_SCORES), axis=0).T)

    @classmethod
    def through(cls, knots: FloatArray) -> Warp:
        """Make maps from ``knots`` (d, k), of coordinates of about zero mean and unit variance, to ``KNOT_SCORES``.

        A coordinate whose quantiles are within ``MIN_DEPARTURE`` of normal ones is unchanged. Tails are stretched by a
        third beyond what the outer quantiles suggest, so that a proposal has heavier tails than the target."""
        least = 1e-3 * (knots[:, -1:] - knots[:, :1]) + 1e-300
        knots = knots[:, :1] + np.concatenate(
            [np.zeros((len(knots), 1)), np.cumsum(np.maximum(np.diff(knots, axis=1), least), axis=1)], axis=1
        )
        scores = np.tile(KNOT_SCORES, (len(knots), 1))
        slopes = np.diff(scores, axis=1) / np.diff(knots, axis=1)
        tails = 0.75 * slopes[:, [0, -1]]
        normal = np.max(np.abs(knots - scores), axis=1) < MIN_DEPARTURE
        knots[normal], tails[normal] = scores[normal], 1.0
        return cls(knots, scores, tails)

    @staticmethod
    def departure(samples: FloatArray) -> FloatArray:
        """Return how far the quantiles of standardised samples (n, d) are from normal ones, shape (d,)."""
        return np.asarray(np.max(np.abs(np.quantile(samples, ndtr(KNOT_SCORES), axis=0).T - KNOT_SCORES), axis=1))

    @property
    def warped(self) -> NDArray[np.bool_]:
        """Return which coordinates are transformed, shape (d,)."""
        return np.asarray(np.any(self.knots != self.scores, axis=1))

    def forward(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return scores of points (n, d), and the log-determinant of the map, shape (n,)."""
        z, log_slope = np.empty(x.shape), np.zeros(len(x))
        for j in range(x.shape[1]):
            k, s = self.knots[j], self.scores[j]
            slopes = np.concatenate([[self.tails[j, 0]], np.diff(s) / np.diff(k), [self.tails[j, 1]]])
            cell = np.searchsorted(k, x[:, j])
            anchor = np.maximum(cell - 1, 0)
            z[:, j] = s[anchor] + slopes[cell] * (x[:, j] - k[anchor])
            log_slope += np.log(slopes[cell])
        return z, log_slope

    def inverse(self, z: FloatArray) -> FloatArray:
        """Return points of scores (n, d)."""
        x = np.empty(z.shape)
        for j in range(z.shape[1]):
            k, s = self.knots[j], self.scores[j]
            slopes = np.concatenate([[self.tails[j, 0]], np.diff(s) / np.diff(k), [self.tails[j, 1]]])
            cell = np.searchsorted(s, z[:, j])
            anchor = np.maximum(cell - 1, 0)
            x[:, j] = k[anchor] + (z[:, j] - s[anchor]) / slopes[cell]
        return x

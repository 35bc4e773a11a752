"""A triangular quadratic map of coordinates, which straightens curved ridges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aero_bayes.arrays import FloatArray

#: Standard errors by which a coefficient must differ from zero to be kept.
_MIN_STANDARD_ERRORS = 5.0


@dataclass(frozen=True, eq=False)
class TriangularMap:
    """Subtract from each coordinate a quadratic function of those before it; the map keeps volumes.

    ``coefficients`` (d, d, d) and ``offsets`` (d,): z_k = (x_k - offsets_k - sum_ij coefficients_kij x_i x_j) with
    i <= j < k. It is the second order of a Knothe-Rosenblatt map (Parno and Marzouk, 2018, SIAM/ASA JUQ 6, 645)."""

    offsets: FloatArray
    coefficients: FloatArray

    @classmethod
    def identity(cls, dimension: int) -> TriangularMap:
        """Return the map that changes nothing."""
        return cls(np.zeros(dimension), np.zeros((dimension,) * 3))

    @classmethod
    def fit(cls, samples: FloatArray) -> TriangularMap:
        """Fit to samples (n, d), white to second order; only significant coefficients are kept."""
        n, d = samples.shape
        found = cls.identity(d)
        for k in range(1, d):
            i, j = np.triu_indices(k)
            products = samples[:, i] * samples[:, j]
            kept = np.arange(len(i))
            for _ in range(2):
                design = np.column_stack([np.ones(n), products[:, kept]])
                inverse = np.linalg.pinv(design.T @ design)
                estimate: FloatArray = inverse @ (design.T @ samples[:, k])
                rest = samples[:, k] - design @ estimate
                error = np.sqrt(np.diag(inverse) * float(rest @ rest) / max(n - design.shape[1], 1))
                large = np.abs(estimate[1:]) > _MIN_STANDARD_ERRORS * error[1:]
                if large.all():
                    break
                kept = kept[large]
            else:
                design = np.column_stack([np.ones(n), products[:, kept]])
                estimate = np.asarray(np.linalg.lstsq(design, samples[:, k])[0], dtype=np.float64)
            if kept.size:
                found.offsets[k] = estimate[0]
                found.coefficients[k, i[kept], j[kept]] = estimate[1:]
        return found

    def _shift(self, x: FloatArray, k: int) -> FloatArray:
        part = self.coefficients[k, :k, :k]
        if not part.any():
            return np.zeros(len(x))
        return np.asarray(self.offsets[k] + np.sum((x[:, :k] @ part) * x[:, :k], axis=1))

    def forward(self, x: FloatArray) -> FloatArray:
        """Straighten points (n, d)."""
        return np.asarray(x - np.stack([self._shift(x, k) for k in range(x.shape[1])], axis=1))

    def inverse(self, z: FloatArray) -> FloatArray:
        """Return the points of straightened ones (n, d)."""
        x = z.copy()
        for k in range(1, z.shape[1]):
            x[:, k] += self._shift(x, k)
        return x

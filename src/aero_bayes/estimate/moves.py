"""Moves of an ensemble, each of which leaves the target unchanged, and the density from which they propose."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from emcee.moves import MHMove, RedBlueMove
from numpy.typing import NDArray
from scipy.special import gammaln, ndtr

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


@dataclass(frozen=True, eq=False)
class WarpedStudentT:
    """Multivariate t density of whitened and transformed coordinates.

    A draw is ``mean + factor @ triangular^-1(warp^-1(t))`` with t, the *scores*, from the standard multivariate t of
    ``dof`` degrees of freedom; ``mean`` is (d,), ``factor`` (d, d)."""

    mean: FloatArray
    factor: FloatArray
    dof: float
    warp: Warp
    triangular: TriangularMap
    axes: FloatArray

    @classmethod
    def of(
        cls, mean: FloatArray, covariance: FloatArray, dof: float = 8.0, axes: FloatArray | None = None
    ) -> WarpedStudentT:
        """Make the t density whose scale matrix is a covariance, made safely positive definite."""
        d = len(mean)
        axes = np.eye(d) if axes is None else axes
        covariance = axes @ covariance @ axes.T
        sd = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(sd, sd)
        values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
        safe = (vectors * np.maximum(values, 1e-10)) @ vectors.T
        factor = np.linalg.solve(axes, sd[:, None] * np.linalg.cholesky(safe))
        return cls(np.array(mean), factor, dof, Warp.identity(d), TriangularMap.identity(d), axes)

    @classmethod
    def fit(
        cls, samples: FloatArray, dof: float = 8.0, *, axes: FloatArray | None = None, curved: bool = False
    ) -> WarpedStudentT:
        """Fit to samples (n, d): by their mean and covariance, and by quantiles where a margin is not normal."""
        axes = np.eye(samples.shape[1]) if axes is None else axes
        along = samples @ axes.T
        order = np.argsort(-Warp.departure((along - along.mean(axis=0)) / np.std(along, axis=0)), kind="stable")
        plain = cls.of(samples.mean(axis=0), np.atleast_2d(np.cov(samples.T)), dof, axes[order])
        scores = plain.scores(samples)[0]
        triangular = TriangularMap.fit(scores) if curved else plain.triangular
        return replace(plain, triangular=triangular, warp=Warp.fit(triangular.forward(scores)), axes=axes)

    def scores(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return scores of points (n, d), and the log-determinant of the transformation, shape (n,)."""
        return self.warp.forward(
            self.triangular.forward(np.asarray(np.linalg.solve(self.factor, (points - self.mean).T).T))
        )

    def points(self, scores: FloatArray) -> FloatArray:
        """Return points of scores (n, d)."""
        return np.asarray(self.mean + self.triangular.inverse(self.warp.inverse(scores)) @ self.factor.T)

    def widened(self, factor: float, dof: float) -> WarpedStudentT:
        """Return the same density with its scale multiplied."""
        return replace(self, factor=factor * self.factor, dof=dof)

    def sample(self, random: np.random.RandomState, size: int) -> FloatArray:
        """Return independent draws, shape (size, d)."""
        normal = random.randn(size, self.mean.size)
        return self.points(normal / np.sqrt(random.chisquare(self.dof, size) / self.dof)[:, None])

    def log_density(self, points: FloatArray) -> FloatArray:
        """Return the log-density at points (n, d), shape (n,)."""
        d, dof = self.mean.size, self.dof
        scores, log_slope = self.scores(points)
        constant = gammaln(0.5 * (dof + d)) - gammaln(0.5 * dof) - 0.5 * d * np.log(dof * np.pi)
        constant -= float(np.linalg.slogdet(self.factor)[1])
        return np.asarray(constant + log_slope - 0.5 * (dof + d) * np.log1p(np.sum(scores**2, axis=1) / dof))


class DelayedAcceptanceMove(MHMove):  # type: ignore[misc]
    """Take ``steps`` independence steps on the approximation s, then accept or reject by the target p."""

    def __init__(
        self, approximation: Callable[[FloatArray], FloatArray], proposal: WarpedStudentT, steps: int = 20
    ) -> None:
        super().__init__(self.propose_from, ndim=proposal.mean.size)
        self.approximation, self.proposal, self.steps = approximation, proposal, steps

    def propose_from(self, coords: FloatArray, random: np.random.RandomState) -> tuple[FloatArray, FloatArray]:
        """Return where the inner chains from (n, d) end, and log s(x) - log s(x')."""
        n = len(coords)
        # Independence proposals do not depend on where the chain is: all are made and weighed at once.
        new = self.proposal.sample(random, n * self.steps)
        every = np.concatenate([coords, new])
        value = self.approximation(every)
        weight = np.where(np.isfinite(value), value - self.proposal.log_density(every), -np.inf)
        at = np.arange(n)
        for threshold, k in zip(np.log(random.rand(self.steps, n)), range(n, n * (self.steps + 1), n), strict=True):
            trial = np.arange(k, k + n)
            with np.errstate(invalid="ignore"):  # -inf after -inf: stay
                at = np.where(threshold < weight[trial] - weight[at], trial, at)
        with np.errstate(invalid="ignore"):
            ratio = value[:n] - value[at]
        return every[at], np.where(np.isnan(ratio), 0.0, ratio)


class DelayedAcceptanceWalkMove(MHMove):  # type: ignore[misc]
    """Delayed acceptance after a few short steps on s: leaves the places where s is poor, since it
    is poor around them."""

    def __init__(
        self, approximation: Callable[[FloatArray], FloatArray], proposal: WarpedStudentT, steps: int = 6
    ) -> None:
        super().__init__(self.propose_from, ndim=proposal.mean.size)
        self.approximation, self.steps = approximation, steps
        self.factor = proposal.factor / np.sqrt(proposal.mean.size)

    def propose_from(self, coords: FloatArray, random: np.random.RandomState) -> tuple[FloatArray, FloatArray]:
        """Return where the inner chains from (n, d) end, and log s(x) - log s(x')."""
        at, first = coords.copy(), self.approximation(coords)
        value = first.copy()
        for _ in range(self.steps):
            scale = np.exp(random.randn(len(at), 1))
            new = at + scale * random.randn(*at.shape) @ self.factor.T
            level = self.approximation(new)
            taken = np.log(random.rand(len(at))) < level - value
            at[taken], value[taken] = new[taken], level[taken]
        return at, first - value


class DifferentialMove(RedBlueMove):  # type: ignore[misc]
    """Add a scaled difference of two walkers of the other half, plus a little noise.

    With x_a, x_b drawn from the other half, x' = x + g (x_a - x_b) + e; the proposal is symmetric. g is
    2.38 / sqrt(2 d) spread by 30 %, and 1 in a tenth of the steps, which jumps between modes."""

    JUMP, NOISE = 0.1, 1e-5

    def get_proposal(
        self, sample: FloatArray, complement: Sequence[FloatArray], random: np.random.RandomState
    ) -> tuple[FloatArray, FloatArray]:
        """Return proposals for one half (n, d) from the other, and the logarithm of the proposal ratio (zero)."""
        others = np.concatenate(list(complement))
        n, d = sample.shape
        first = random.randint(len(others), size=n)
        second = (first + 1 + random.randint(len(others) - 1, size=n)) % len(others)
        scale = 2.38 / np.sqrt(2.0 * d) * np.exp(0.3 * random.randn(n))
        if random.rand() < self.JUMP:
            scale = np.ones(n)
        spread = self.NOISE * np.std(others, axis=0) * random.randn(n, d)
        return sample + scale[:, None] * (others[first] - others[second]) + spread, np.zeros(n)


class IndependenceMove(MHMove):  # type: ignore[misc]
    """Propose x' from a fixed density q, accept with probability min(1, p(x') q(x) / (p(x) q(x'))).

    As long as q does not change the chain keeps its target; heavy tails keep the weights p / q bounded, so that the
    chain converges geometrically wherever q covers p."""

    def __init__(self, proposal: WarpedStudentT) -> None:
        super().__init__(self._propose, ndim=proposal.mean.size)
        self.proposal = proposal

    def _propose(self, coords: FloatArray, random: np.random.RandomState) -> tuple[FloatArray, FloatArray]:
        new = self.proposal.sample(random, len(coords))
        return new, self.proposal.log_density(coords) - self.proposal.log_density(new)

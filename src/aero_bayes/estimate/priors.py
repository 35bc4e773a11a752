"""Prior densities: small frozen values, truncated to their bounds and normalised there.

Each knows its log-density in the parameter's own unit, the first two derivatives of it, and how to draw from it. The
change to search coordinates belongs to :mod:`aero_bayes.estimate.parameters`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr, ndtr, ndtri

from aero_bayes.arrays import FloatArray
from aero_bayes.display import with_unit
from aero_bayes.errors import InputError

_LOG_SQRT_2PI = 0.5 * math.log(2.0 * math.pi)


class Prior(ABC):
    """What a parameter's prior must answer; ``lower`` and ``upper`` bound its support."""

    lower: float
    upper: float

    @abstractmethod
    def log_pdf(self, x: ArrayLike) -> FloatArray:
        """Compute the log-density at ``x`` (any shape), minus infinity outside the bounds."""

    @abstractmethod
    def derivatives(self, x: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Compute the first and second derivative of the log-density inside the bounds."""

    @abstractmethod
    def sample(self, rng: np.random.Generator, size: int) -> FloatArray:
        """Draw independently, shape (size,)."""

    @abstractmethod
    def describe(self, unit: str) -> str:
        """Return what a reader of a report sees."""

    def deviations(self, x: float) -> float:
        """Return by how many of its standard deviations a value is off its centre; 0 for one without a centre."""
        return 0.0

    def bounded(self, lower: float, upper: float) -> Self:
        """Return the same density truncated to the intersection of its bounds with these."""
        return replace(self, lower=max(lower, self.lower), upper=min(upper, self.upper))  # type: ignore[type-var]


def _check(lower: float, upper: float, what: str) -> None:
    if not lower < upper:
        raise InputError(f"{what}: lower bound {lower:g} is not below upper bound {upper:g}")


def _inside(x: FloatArray, lower: float, upper: float, value: FloatArray) -> FloatArray:
    return np.where((x >= lower) & (x <= upper), value, -np.inf)


def _log_mass(a: float, b: float) -> float:
    """Compute the logarithm of the standard normal's mass between a and b, in either tail without cancellation."""
    if a > 0.0:
        a, b = -b, -a
    if b <= 0.0:
        upper, lower = float(log_ndtr(b)), float(log_ndtr(a))
        return upper + math.log1p(-math.exp(lower - upper))
    return math.log(float(ndtr(b)) - float(ndtr(a)))


def _truncated_normal(rng: np.random.Generator, a: float, b: float, size: int) -> FloatArray:
    """Draw from a standard normal between a and b by inversion, in the tail that keeps its digits."""
    flip = a > 0.0
    if flip:
        a, b = -b, -a
    p = ndtr(a) + rng.random(size) * (ndtr(b) - ndtr(a))
    z = np.clip(ndtri(p), a, b)
    return np.asarray(-z if flip else z, dtype=np.float64)


@dataclass(frozen=True)
class Uniform(Prior):
    """Equal density everywhere between the bounds.

    Parameters
    ----------
    lower, upper : float
        Bounds in the parameter's SI unit; InputError unless finite and in order.

    Examples
    --------
    >>> from aero_bayes.estimate import Uniform
    >>> bool(np.exp(Uniform(2.0, 6.0).log_pdf(3.0)) == 0.25)
    True
    """

    lower: float
    upper: float

    def __post_init__(self) -> None:
        _check(self.lower, self.upper, "uniform prior")

    def log_pdf(self, x: ArrayLike) -> FloatArray:
        x = np.asarray(x, dtype=np.float64)
        return _inside(x, self.lower, self.upper, np.full(x.shape, -math.log(self.upper - self.lower)))

    def derivatives(self, x: ArrayLike) -> tuple[FloatArray, FloatArray]:
        x = np.asarray(x, dtype=np.float64)
        return np.zeros(x.shape), np.zeros(x.shape)

    def sample(self, rng: np.random.Generator, size: int) -> FloatArray:
        return rng.uniform(self.lower, self.upper, size)

    def describe(self, unit: str) -> str:
        return with_unit(f"uniform, {self.lower:.4g} to {self.upper:.4g}", unit)


@dataclass(frozen=True)
class LogUniform(Prior):
    """Equal density on a logarithmic axis between two positive bounds.

    Parameters
    ----------
    lower, upper : float
        Bounds in the parameter's SI unit; InputError unless positive and in order.

    Examples
    --------
    >>> from aero_bayes.estimate import LogUniform
    >>> prior = LogUniform(1.0, 100.0)
    >>> float(np.exp(prior.log_pdf(10.0) - prior.log_pdf(20.0)))  # half as dense at twice the value
    2.0
    """

    lower: float
    upper: float

    def __post_init__(self) -> None:
        _check(self.lower, self.upper, "log-uniform prior")
        if self.lower <= 0.0:
            raise InputError(f"log-uniform prior: lower bound {self.lower:g} is not positive")

    def log_pdf(self, x: ArrayLike) -> FloatArray:
        x = np.asarray(x, dtype=np.float64)
        safe = np.maximum(x, self.lower)
        return _inside(x, self.lower, self.upper, -np.log(safe) - math.log(math.log(self.upper) - math.log(self.lower)))

    def derivatives(self, x: ArrayLike) -> tuple[FloatArray, FloatArray]:
        x = np.asarray(x, dtype=np.float64)
        return -1.0 / x, 1.0 / x**2

    def sample(self, rng: np.random.Generator, size: int) -> FloatArray:
        return np.exp(rng.uniform(math.log(self.lower), math.log(self.upper), size))

    def describe(self, unit: str) -> str:
        return with_unit(f"log-uniform, {self.lower:.4g} to {self.upper:.4g}", unit)


@dataclass(frozen=True)
class Normal(Prior):
    """Normal density, truncated to the bounds and normalised there.

    Parameters
    ----------
    mean, sd : float
        In the parameter's SI unit; InputError unless ``sd`` is positive.
    lower, upper : float
        Bounds; none by default.

    Examples
    --------
    >>> from aero_bayes.estimate import Normal
    >>> Normal(3.0, 0.5).describe("N.s/m")
    'normal, 3 ± 0.5 N.s/m'
    """

    mean: float
    sd: float
    lower: float = -math.inf
    upper: float = math.inf

    def __post_init__(self) -> None:
        _check(self.lower, self.upper, "normal prior")
        if not self.sd > 0.0:
            raise InputError(f"normal prior: standard deviation {self.sd:g} is not positive")

    @property
    def _limits(self) -> tuple[float, float]:
        return (self.lower - self.mean) / self.sd, (self.upper - self.mean) / self.sd

    def log_pdf(self, x: ArrayLike) -> FloatArray:
        x = np.asarray(x, dtype=np.float64)
        z = (x - self.mean) / self.sd
        constant = -_LOG_SQRT_2PI - math.log(self.sd) - _log_mass(*self._limits)
        return _inside(x, self.lower, self.upper, constant - 0.5 * z**2)

    def derivatives(self, x: ArrayLike) -> tuple[FloatArray, FloatArray]:
        x = np.asarray(x, dtype=np.float64)
        return -(x - self.mean) / self.sd**2, np.full(x.shape, -1.0 / self.sd**2)

    def deviations(self, x: float) -> float:
        return abs(x - self.mean) / self.sd

    def sample(self, rng: np.random.Generator, size: int) -> FloatArray:
        return self.mean + self.sd * _truncated_normal(rng, *self._limits, size)

    def describe(self, unit: str) -> str:
        return with_unit(f"normal, {self.mean:.4g} ± {self.sd:.2g}", unit)


@dataclass(frozen=True)
class LogNormal(Prior):
    """Log-normal density about a median, truncated to the bounds and normalised there.

    Parameters
    ----------
    median : float
        In the parameter's SI unit; positive.
    sigma : float
        Standard deviation of the natural logarithm: about the relative tolerance where that is small.
    lower, upper : float
        Bounds; the positive axis by default.

    Examples
    --------
    >>> from aero_bayes.estimate import LogNormal
    >>> prior = LogNormal.tolerance(50.0, 0.1)  # a data sheet's value, 10 %
    >>> round(prior.sigma, 4), LogNormal.factor(50.0, 2.0).median
    (0.0998, 50.0)
    """

    median: float
    sigma: float
    lower: float = 0.0
    upper: float = math.inf

    def __post_init__(self) -> None:
        _check(self.lower, self.upper, "log-normal prior")
        if not (self.median > 0.0 and self.sigma > 0.0):
            raise InputError(f"log-normal prior: median {self.median:g} and sigma {self.sigma:g} must be positive")

    @classmethod
    def tolerance(cls, nominal: float, relative: float) -> LogNormal:
        """Return a nominal value with a relative tolerance (one standard deviation)."""
        return cls(nominal, math.sqrt(math.log1p(relative**2)))

    @classmethod
    def factor(cls, nominal: float, factor: float) -> LogNormal:
        """Return a nominal value that may be off by a factor (one standard deviation)."""
        return cls(nominal, math.log(factor))

    @property
    def _limits(self) -> tuple[float, float]:
        mu = math.log(self.median)
        low = (math.log(self.lower) - mu) / self.sigma if self.lower > 0.0 else -math.inf
        return low, (math.log(self.upper) - mu) / self.sigma if self.upper < math.inf else math.inf

    def log_pdf(self, x: ArrayLike) -> FloatArray:
        x = np.asarray(x, dtype=np.float64)
        log_x = np.log(np.where(x > 0.0, x, 1.0))
        z = (log_x - math.log(self.median)) / self.sigma
        constant = -_LOG_SQRT_2PI - math.log(self.sigma) - _log_mass(*self._limits)
        return _inside(x, max(self.lower, 5e-324), self.upper, constant - log_x - 0.5 * z**2)

    def derivatives(self, x: ArrayLike) -> tuple[FloatArray, FloatArray]:
        x = np.asarray(x, dtype=np.float64)
        z = (np.log(x) - math.log(self.median)) / self.sigma
        return -(1.0 + z / self.sigma) / x, (1.0 + z / self.sigma - 1.0 / self.sigma**2) / x**2

    def deviations(self, x: float) -> float:
        return abs(math.log(x / self.median)) / self.sigma if x > 0.0 else math.inf

    def sample(self, rng: np.random.Generator, size: int) -> FloatArray:
        return np.asarray(self.median * np.exp(self.sigma * _truncated_normal(rng, *self._limits, size)))

    def describe(self, unit: str) -> str:
        middle = with_unit(f"log-normal, {self.median:.4g}", unit)
        if self.sigma < 0.4:
            return f"{middle} ± {100 * self.sigma:.2g} %"
        return f"{middle} within a factor {math.exp(self.sigma):.2g}"


@lru_cache(maxsize=4096)
def search_sd(prior: Prior, lower: float, upper: float, scale: Literal["log", "linear"]) -> float:
    """Compute the standard deviation of a prior in its search coordinate, by quadrature.

    Kept, as every local fit asks for it."""
    width = upper - lower
    low, high = (math.log(lower), math.log(upper)) if scale == "log" else (lower / width, upper / width)
    u = np.linspace(low, high, 4001)
    x = np.exp(u) if scale == "log" else u * width
    log_density = prior.log_pdf(np.clip(x, lower, upper)) + np.log(x if scale == "log" else width)
    weight = np.exp(log_density - log_density.max())
    weight /= weight.sum()
    mean = np.sum(weight * u)
    return math.sqrt(max(float(np.sum(weight * (u - mean) ** 2)), 1e-300))

"""Diagnostics of convergence: R-hat across independent ensembles, autocorrelation time, effective sample size.

Walkers of one ensemble may move by each other's positions and are no independent chains then. Each *ensemble* is
therefore one chain here: R-hat compares ensembles, and the autocorrelation time is the larger of the walkers' own and
that of the ensemble's mean, which sees what the walkers share.

References: Vehtari et al. (2021), Bayesian Analysis 16, 667 (rank-normalised split R-hat, tail ESS); Goodman and Weare
(2010), Comm. App. Math. Comp. Sci. 5, 65 (autocorrelation time of an ensemble); Sokal (1997) (window).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # imports its parts when they are first used
from scipy.special import ndtri

from aero_bayes.arrays import FloatArray
from aero_bayes.sensors.whiteness import autocovariance, integrated_time


def _rank_normalise(samples: FloatArray) -> FloatArray:
    """Replace samples by the normal scores of their ranks over all chains (Blom)."""
    rank = scipy.stats.rankdata(samples, method="average").reshape(samples.shape)
    return np.asarray(ndtri((rank - 0.375) / (samples.size + 0.25)))


def _plain_r_hat(chains: FloatArray) -> float:
    """Compute the potential scale reduction of chains, shape (c, n)."""
    n = chains.shape[1]
    within = float(np.mean(np.var(chains, axis=1, ddof=1)))
    between = float(np.var(np.mean(chains, axis=1), ddof=1))
    if within == 0.0:
        return 1.0 if between == 0.0 else np.inf
    return float(np.sqrt((n - 1) / n + between / within))


def r_hat(samples: FloatArray) -> float:
    """Compute the rank-normalised split R-hat, the larger of bulk and folded."""
    ensembles, steps, walkers = samples.shape
    half = steps // 2
    if half < 2:
        return np.inf
    kept = samples[:, steps - 2 * half :]
    chains = kept.reshape(2 * ensembles, half * walkers)
    folded = np.abs(chains - np.median(chains))
    return max(_plain_r_hat(_rank_normalise(chains)), _plain_r_hat(_rank_normalise(folded)))


def autocorrelation_time(samples: FloatArray, *, coupled: bool = True) -> float:
    """Compute the steps per independent sample of one walker, the larger of two estimates.

    Walkers are centred on the mean of all, so that one that stays where it is counts for little."""
    _, steps, walkers = samples.shape
    variance = float(np.var(samples))
    if variance == 0.0 or steps < 4:
        return float(steps)
    single = autocovariance(np.swapaxes(samples, 1, 2), float(samples.mean())).mean(axis=(0, 1))
    own = integrated_time(single / variance)
    mean = autocovariance(samples.mean(axis=2)).mean(axis=0)
    if not coupled or mean[0] <= 0.0:
        return max(own, 1.0)
    return float(max(own, walkers * mean[0] / variance * integrated_time(mean / mean[0]), 1.0))


@dataclass(frozen=True)
class Convergence:
    """Diagnostics of one quantity: ``tau`` in steps, ``ess`` in samples."""

    r_hat: float
    tau: float
    ess_bulk: float
    ess_tail: float


def check_convergence(samples: FloatArray, *, coupled: bool = True) -> Convergence:
    """Diagnose one quantity, shape (ensembles, steps, walkers)."""
    size = samples.size
    tau = autocorrelation_time(_rank_normalise(samples), coupled=coupled)
    low, high = np.quantile(samples, [0.05, 0.95])
    tails = [autocorrelation_time((samples <= q).astype(np.float64), coupled=coupled) for q in (low, high)]
    return Convergence(r_hat(samples), tau, size / tau, size / max(tails))

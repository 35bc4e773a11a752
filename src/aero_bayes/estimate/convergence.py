"""How long, and with what, to sample: the settings, the diagnostics of a chain, and the rule by which it stops."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Annotated

import numpy as np
import scipy  # imports its parts when they are first used
from pydantic import Field
from scipy.special import ndtri

from aero_bayes.arguments import Count, Positive
from aero_bayes.arrays import FloatArray
from aero_bayes.display import SettingsDisplay
from aero_bayes.estimate.noise import autocovariance, integrated_time
from aero_bayes.plain import Number


@dataclass(frozen=True, repr=False)
class SampleSettings(SettingsDisplay):
    """How long and with what to sample.

    Parameters
    ----------
    ensembles : int
        Independent ensembles of walkers, at least four.
    walkers : int, optional
        Walkers of an ensemble; twice the dimension plus two by default.
    burn_in : int
        Steps of one round of burn-in, after which proposal and surrogate are fitted anew.
    max_rounds : int
        Most rounds. Burn-in ends earlier if the surrogate is good.
    settle : int
        Steps after burn-in that are thrown away.
    max_steps, max_minutes : int, float
        Limits of the kept chain in steps and of the whole in minutes.
    r_hat : float
        Largest rank-normalised R-hat across ensembles with which the chain may stop.
    lengths : float
        Fewest autocorrelation times with which it may (never below 50 where walkers move by each other).
    ess : float
        Fewest effective samples with which it may, in bulk and tails of every parameter.
    dof : float
        Degrees of freedom of the Student t proposal.
    draws : int
        Draws an ensemble that the posterior keeps.
    predictive : int
        Draws over all ensembles that are simulated for the predictive bands.
    checkpoint_seconds : float
        Time between checkpoints.

    Examples
    --------
    >>> aero_bayes.SampleSettings(ess=2000.0, max_minutes=5.0)
    SampleSettings(max_minutes=5.0, ess=2000.0)
    """

    ensembles: Annotated[int, Field(ge=4)] = 4
    walkers: Count | None = None
    burn_in: int = 6
    max_rounds: int = 20
    settle: int = 3
    max_steps: Count = 8000
    max_minutes: Positive = 15.0
    r_hat: Annotated[float, Field(gt=1.0)] = 1.01
    lengths: float = 10.0
    ess: Positive = 1000.0
    dof: float = 5.0
    draws: int = 1000
    predictive: int = 200
    checkpoint_seconds: float = 15.0

    @property
    def identity(self) -> str:
        """The settings that change the chain, as text; limits only end it.

        Examples
        --------
        >>> aero_bayes.SampleSettings(ess=2000.0).identity == aero_bayes.SampleSettings().identity
        True
        """
        kept = replace(self, max_steps=0, max_minutes=0.0, checkpoint_seconds=0.0, r_hat=0.0, lengths=0.0, ess=0.0)
        return repr(asdict(kept))


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

    r_hat: Number
    tau: Number
    ess_bulk: Number
    ess_tail: Number

    @classmethod
    def worst(cls, found: Iterable[Convergence]) -> Convergence:
        """Return the worst of each diagnostic over several quantities or chains."""
        r_hat, tau, bulk, tail = zip(*((d.r_hat, d.tau, d.ess_bulk, d.ess_tail) for d in found), strict=True)
        return cls(max(r_hat), max(tau), min(bulk), min(tail))


def check_convergence(samples: FloatArray, *, coupled: bool = True) -> Convergence:
    """Diagnose one quantity, shape (ensembles, steps, walkers)."""
    size = samples.size
    tau = autocorrelation_time(_rank_normalise(samples), coupled=coupled)
    low, high = np.quantile(samples, [0.05, 0.95])
    tails = [autocorrelation_time((samples <= q).astype(np.float64), coupled=coupled) for q in (low, high)]
    return Convergence(r_hat(samples), tau, size / tau, size / max(tails))


#: Smallest number of steps that are judged (of walkers that do not depend on each other: some hundred series, whose
#: autocorrelation is averaged over all), and of autocorrelation times of a chain whose walkers do.
MIN_STEPS, MIN_AUTOCORRELATION_TIMES = 16, 50.0


@dataclass(frozen=True)
class StoppingDecision:
    """Whether a chain may stop, which criteria it misses, and at how many steps to decide again."""

    enough: bool
    reason: str
    diagnoses: tuple[Convergence, ...]
    next_check: int

    @property
    def line(self) -> str:
        worst = Convergence.worst(self.diagnoses)
        return f"R-hat {worst.r_hat:.4f}, tau {worst.tau:.1f}, ESS {worst.ess_bulk:.0f}"


def decide(points: FloatArray, settings: SampleSettings, *, coupled: bool) -> StoppingDecision:
    """Apply the stopping rule to kept points, shape (ensembles, steps, walkers, d).

    ``coupled`` says whether a walker moves by where others of its ensemble are."""
    # Walkers that depend on each other count as one series: that of their mean. It must be longer to be judged.
    length, dimension = max(settings.lengths, MIN_AUTOCORRELATION_TIMES if coupled else 0.0), points.shape[-1]
    if points.shape[1] < 8:
        nothing = Convergence(np.inf, np.inf, 0.0, 0.0)
        return StoppingDecision(False, "fewer than 8 steps were kept", (nothing,) * dimension, MIN_STEPS)
    steps = points.shape[1]
    diagnoses = tuple(check_convergence(points[..., j], coupled=coupled) for j in range(dimension))
    worst = Convergence.worst(diagnoses)
    tau, low = worst.tau, min(worst.ess_bulk, worst.ess_tail)
    missed, wanted = [], float(steps)
    if worst.r_hat > settings.r_hat:
        missed.append(f"R-hat {worst.r_hat:.4f} is above {settings.r_hat:g}")
        wanted = 1.2 * steps
    if steps < length * tau:
        missed.append(f"the chain has {steps / tau:.0f} autocorrelation times, {length:g} are needed")
        wanted = max(wanted, length * tau)
    if low < settings.ess:
        missed.append(f"{low:.0f} effective samples, {settings.ess:g} are wanted")
        wanted = max(wanted, steps * settings.ess / max(low, 1.0))
    next_check = int(np.clip(np.ceil(wanted), steps + 4, 1.5 * steps + 4))
    return StoppingDecision(not missed, "; ".join(missed) or "every criterion was met", diagnoses, next_check)

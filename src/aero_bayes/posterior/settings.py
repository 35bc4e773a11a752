"""How long, and with what, to sample."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

from aero_bayes.display import SettingsDisplay


@dataclass(frozen=True, repr=False)
class SampleSettings(SettingsDisplay):
    """How long and with what to sample.

    Parameters
    ----------
    ensembles, walkers : int
        At least four ensembles; twice the dimension plus two walkers by default (None).
    burn_in : int
        Steps of one round of burn-in, after which proposal and surrogate are fitted anew.
    max_rounds : int
        Most rounds. Burn-in ends earlier if the surrogate is good.
    settle : int
        Steps after burn-in that are thrown away.
    max_steps, max_minutes : int, float
        Limits of the kept chain in steps and of the whole in minutes.
    r_hat, lengths, ess : float
        When to stop: rank-normalised R-hat across ensembles, length in autocorrelation times (never below
        50 where walkers move by each other), and effective samples in bulk and tails of every parameter.
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

    ensembles: int = 4
    walkers: int | None = None
    burn_in: int = 6
    max_rounds: int = 20
    settle: int = 3
    max_steps: int = 8000
    max_minutes: float = 15.0
    r_hat: float = 1.01
    lengths: float = 20.0
    ess: float = 1000.0
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

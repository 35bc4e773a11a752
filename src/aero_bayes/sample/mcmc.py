"""Independent ensembles in lockstep: tune, freeze what was learnt, sample until it is enough.

The ensembles never exchange walkers. While they burn in, everything that is evaluated trains a proposal and a stand-in
for the density, together for all; then both are frozen and what came before is thrown away, so that the kept chain has
one invariant distribution.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aero_bayes.checkpoint import Checkpoint, digest
from aero_bayes.display import SettingsDisplay
from aero_bayes.sample.diagnostics import Diagnosis
from aero_bayes.sample.moves import WarpedStudentT
from aero_bayes.sample.stopping import StoppingDecision, decide
from aero_bayes.sample.tuning import Density, Tuned
from aero_bayes.sample.walk import Ensembles, MakeMoves, standard_moves

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, repr=False)
class SampleSettings(SettingsDisplay):
    """How long and with what to sample.

    Parameters
    ----------
    ensembles, walkers : int
        At least four ensembles; twice the dimension plus two walkers by default (None).
    burn_in : tuple of int
        Steps of each burn-in round, after each of which proposal and stand-in are fitted anew.
    extra_rounds : int
        Most further rounds, each half as long again, that follow until these are good.
    settle : int
        Steps thrown away after the last of them.
    max_steps, time_limit : int, float
        Limits of the kept chain in steps and of the whole in s.
    r_hat, lengths, ess : float
        What counts as enough: rank-normalised R-hat across ensembles, length in autocorrelation times (never below
        50 where walkers move by each other), and effective samples in bulk and tails of every parameter.
    dof : float
        Degrees of freedom of the heavy-tailed proposal.
    draws : int
        Draws an ensemble that the posterior keeps.
    predictive : int
        Draws over all ensembles that are simulated for the predictive bands.
    checkpoint_seconds : float
        Time between checkpoints.

    Examples
    --------
    >>> aero_bayes.SampleSettings(ess=2000.0, time_limit=300.0)
    SampleSettings(time_limit=300.0, ess=2000.0)
    """

    ensembles: int = 4
    walkers: int | None = None
    burn_in: tuple[int, ...] = (10, 12, 16, 20)
    extra_rounds: int = 8
    settle: int = 5
    max_steps: int = 8000
    time_limit: float = 900.0
    r_hat: float = 1.01
    lengths: float = 20.0
    ess: float = 1000.0
    dof: float = 5.0
    draws: int = 1000
    predictive: int = 200
    checkpoint_seconds: float = 15.0


@dataclass(frozen=True, eq=False)
class Chain:
    """What sampling gave.

    ``points`` has shape (ensembles, steps, walkers, d), ``log_density`` (ensembles, steps, walkers); ``diagnoses`` one
    entry a dimension. ``evaluations`` counts points inside the prior's support, tuning included. ``converged`` is False
    unless every criterion was met; ``reason`` says which was not.
    """

    points: FloatArray
    log_density: FloatArray
    diagnoses: tuple[Diagnosis, ...]
    evaluations: int
    seconds: float
    converged: bool
    reason: str
    tuned: Tuned

    @property
    def acceptance(self) -> float:
        """Share of steps in which a walker moved."""
        return float(np.mean(np.any(np.diff(self.points, axis=1) != 0.0, axis=-1))) if self.points.shape[1] > 1 else 0.0

    @property
    def tau(self) -> float:
        """Longest autocorrelation time in steps."""
        return max(d.tau for d in self.diagnoses)

    @property
    def r_hat(self) -> float:
        return max(d.r_hat for d in self.diagnoses)

    @property
    def ess_bulk(self) -> float:
        return min(d.ess_bulk for d in self.diagnoses)

    @property
    def ess_tail(self) -> float:
        return min(d.ess_tail for d in self.diagnoses)


def run(
    density: Density,
    proposal: WarpedStudentT,
    settings: SampleSettings,
    seed: int,
    *,
    checkpoint: Checkpoint | Path | str | None = None,
    identity: str = "",
    moves: MakeMoves = standard_moves,
    progress: Callable[[str, float, str], None] | None = None,
) -> Chain:
    """Draw from a density until the criteria are met or a limit is reached.

    Parameters
    ----------
    density : callable
        Vectorised log-density: points (n, d) to (n,), minus infinity where there is none. If it has a method
        ``log_prior`` of the same form, that part is taken as costing nothing.
    proposal : WarpedStudentT
        First approximation of the density; the ensembles start from draws of it, widened.
    settings : SampleSettings
    seed : int
    checkpoint : Checkpoint or Path, optional
        Kept up to date; if it holds the state of the same run (seed, settings, ``identity``), the run goes
        on from there and gives bit by bit what it would have given without the interruption.
    identity : str
        What makes the density this one and no other (hashes of model and data).
    moves : callable, optional
        Makes the moves; the standard mix by default.
    progress : callable, optional
        Told a phase, how far it is (0 to 1), and a line of text.

    Raises
    ------
    CannotFinishError
        If no starting point of finite density can be found.
    """
    began = saved = time.perf_counter()
    walk = Ensembles(density, proposal, settings, moves)
    key = digest("chain", seed, settings_key(settings), identity, proposal.mean)
    kept = Checkpoint.at(checkpoint)
    if kept is not None and (stored := kept.get(key)) is not None:
        walk.restore(stored)
    else:
        walk.start(np.random.default_rng(seed))
    before = walk.seconds
    verdict = StoppingDecision(False, "it had not settled", (), 0)
    while True:
        now = time.perf_counter()
        walk.seconds = before + now - began
        late = walk.seconds > settings.time_limit
        over = late or walk.kept >= settings.max_steps
        if walk.kept >= walk.next_check or over:
            verdict = decide(walk.chain()[0], settings, coupled=walk.coupled)
            walk.next_check = verdict.next_check
            if verdict.enough or over:
                break
        walk.advance()
        if progress is not None and not walk.tuned.frozen:
            progress("burn-in", min(1.0, walk.rounds / len(settings.burn_in)), f"round {walk.rounds + 1}")
        elif progress is not None:
            words = verdict.line if verdict.diagnoses else f"{walk.kept} steps"
            progress("sampling", min(1.0, walk.kept / walk.next_check), words)
        if kept is not None and now - saved > settings.checkpoint_seconds:
            kept.put(key, walk.state(), now=True)
            saved = time.perf_counter()
    if kept is not None:
        kept.put(key, walk.state(), now=True)
    limit = "" if verdict.enough else f"stopped at the {'time' if late else 'step'} limit: "
    points, level = walk.chain()
    return Chain(
        points, level, verdict.diagnoses, walk.evaluations, walk.seconds, verdict.enough, limit + verdict.reason,
        walk.tuned,
    )  # fmt: skip


def settings_key(settings: SampleSettings) -> str:
    """What of the settings changes the chain (limits only end it)."""
    kept = replace(settings, max_steps=0, time_limit=0.0, checkpoint_seconds=0.0, r_hat=0.0, lengths=0.0, ess=0.0)
    return repr(asdict(kept))

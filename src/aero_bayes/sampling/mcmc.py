"""Markov chain Monte Carlo by independent ensembles of walkers, until the chain meets its criteria.

The ensembles never exchange walkers. During burn-in all of them together train one proposal and one surrogate of the
density. Then both are frozen and burn-in is thrown away, so that every step of the kept chain leaves the density
invariant.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.checkpoint import Checkpoint, digest
from aero_bayes.progress import Progress
from aero_bayes.sampling.adaptation import Adaptation, Density
from aero_bayes.sampling.diagnostics import Convergence
from aero_bayes.sampling.ensembles import Ensembles
from aero_bayes.sampling.moves import WarpedStudentT
from aero_bayes.sampling.settings import SampleSettings
from aero_bayes.sampling.standard_moves import MakeMoves, standard_moves
from aero_bayes.sampling.stopping import StoppingDecision, decide


@dataclass(frozen=True, eq=False)
class Chain:
    """What sampling gave.

    ``points`` has shape (ensembles, steps, walkers, d), ``log_density`` (ensembles, steps, walkers); ``diagnoses`` one
    entry a dimension. ``evaluations`` counts points inside the prior's support, tuning included."""

    points: FloatArray
    log_density: FloatArray
    diagnoses: tuple[Convergence, ...]
    evaluations: int
    seconds: float
    converged: bool
    reason: str
    adaptation: Adaptation

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


def run_chain(
    density: Density,
    proposal: WarpedStudentT,
    settings: SampleSettings,
    seed: int,
    *,
    checkpoint: Checkpoint | Path | str | None = None,
    identity: str = "",
    moves: MakeMoves = standard_moves,
    progress: Progress | None = None,
) -> Chain:
    """Draw from a density until the criteria are met or a limit is reached."""
    began, ensembles = time.perf_counter(), Ensembles(density, proposal, settings, moves)
    key = digest("chain", seed, settings.identity, identity, proposal.mean)
    kept = Checkpoint.at(checkpoint)
    stored = kept.get(key) if kept is not None else None
    if stored is not None:
        ensembles.restore(stored)
    else:
        ensembles.start(np.random.default_rng(seed))

    def save() -> None:
        if kept is not None:
            kept.put(key, ensembles.state(), now=True)

    verdict, end = _advance(ensembles, settings, save, progress, began)
    save()
    return Chain(
        *ensembles.chain(),
        verdict.diagnoses,
        ensembles.evaluations,
        ensembles.seconds,
        verdict.enough,
        ("" if verdict.enough else f"{end}: ") + verdict.reason,
        ensembles.adaptation,
    )


def _advance(
    ensembles: Ensembles, settings: SampleSettings, save: Callable[[], None], progress: Progress | None, began: float
) -> tuple[StoppingDecision, str]:
    """Draw until the criteria are met or a limit is reached; return the decision, and which limit it may have been."""
    saved, before = began, ensembles.seconds
    verdict = StoppingDecision(False, "burn-in had not ended", (), 0)
    asked = False
    while True:
        now = time.perf_counter()
        ensembles.seconds = before + now - began
        late = ensembles.seconds > 60.0 * settings.max_minutes
        over = asked or late or ensembles.kept >= settings.max_steps
        if ensembles.kept >= ensembles.next_check or over:
            verdict = decide(ensembles.chain()[0], settings, coupled=ensembles.coupled)
            ensembles.next_check = verdict.next_check
            if verdict.enough or over:
                return verdict, "interrupted" if asked else f"stopped at the {'time' if late else 'step'} limit"
        ensembles.advance()
        told = "burn-in", ensembles.rounds / settings.max_rounds, f"round {ensembles.rounds + 1}"
        if ensembles.adaptation.frozen:
            words = verdict.line if verdict.diagnoses else f"{ensembles.kept} steps"
            told = "sampling", ensembles.kept / ensembles.next_check, words
        asked = progress is not None and progress(told[0], min(1.0, told[1]), told[2]) is True
        if now - saved > settings.checkpoint_seconds:
            save()
            saved = time.perf_counter()

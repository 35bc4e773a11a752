"""Markov chain Monte Carlo by independent ensembles of walkers, until the chain meets its criteria.

The ensembles never exchange walkers. During burn-in all of them together train one proposal and one surrogate of the
density. Then both are frozen and burn-in is thrown away, so that every step of the kept chain leaves the density
invariant.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import Lock

import emcee
import numpy as np
from emcee.moves import Move, RedBlueMove, StretchMove
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.checkpoint import Arrays, Checkpoint, digest, pack, pack_random, unpack, unpack_random
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.adaptation import Adaptation, Density, adapt, log_prior_of, scan_axes
from aero_bayes.estimate.convergence import MIN_STEPS, Convergence, SampleSettings, StoppingDecision, decide
from aero_bayes.estimate.moves import (
    DelayedAcceptanceMove,
    DelayedAcceptanceWalkMove,
    DifferentialMove,
    IndependenceMove,
    WarpedStudentT,
)
from aero_bayes.progress import Progress

#: Moves and their shares, from what burn-in has learnt, for a density with this inexpensive part (the prior).
MakeMoves = Callable[[Adaptation, Density], Sequence[tuple[Move, float]]]


def standard_moves(adaptation: Adaptation, prior: Density) -> Sequence[tuple[Move, float]]:
    """Choose delayed acceptance by the surrogate; moves that need none until there is one, and where it is no good."""
    if adaptation.surrogate_density is None or (adaptation.frozen and adaptation.acceptance == 0.0):
        share = 0.85 if adaptation.frozen else 0.3
        return [(IndependenceMove(adaptation.proposal), share), (DifferentialMove(), 0.09), (StretchMove(), 0.06)]
    approximation = partial(adaptation.surrogate_density.log_density, prior=prior)
    moves: list[tuple[Move, float]] = [
        (DelayedAcceptanceMove(approximation, adaptation.proposal, adaptation.steps), 0.95),
        (DelayedAcceptanceWalkMove(approximation, adaptation.proposal), 0.05),
    ]
    # During burn-in walkers also find places where the surrogate is far too low.
    return moves if adaptation.frozen else [*moves, (DifferentialMove(), 0.5)]


#: Temperature of the surrogate whose draws are evaluated after each round of burn-in.
_TAIL_TEMPERATURE = 2.0


class Ensembles:
    """All ensembles, their random states, and the points of the present phase.

    The phases are rounds of burn-in, ``settle`` steps that are thrown away, and the kept chain."""

    def __init__(self, density: Density, proposal: WarpedStudentT, settings: SampleSettings, moves: MakeMoves) -> None:
        self.density, self.prior = density, log_prior_of(density)
        self.settings, self._moves, self.adaptation = settings, moves, Adaptation(proposal)
        self.dimension = proposal.mean.size
        self.walkers = settings.walkers or 2 * self.dimension + 2
        self.rounds, self._left, self.evaluations, self.seconds = 0, settings.burn_in, 0, 0.0
        self.next_check = MIN_STEPS
        self.visited: list[FloatArray] = []
        self._levels: list[FloatArray] = []
        self._seen: list[FloatArray] = []
        self._states: list[emcee.State] = []
        self._samplers: list[emcee.EnsembleSampler] = []
        self._simulates = Lock()

    @property
    def kept(self) -> int:
        """Return the steps of the kept chain; zero before it begins."""
        return len(self.visited) if self.adaptation.frozen and self._left == 0 else 0

    @property
    def coupled(self) -> bool:
        """Return whether a walker moves by where others of its ensemble are."""
        return any(isinstance(move, RedBlueMove) for move, _ in self._moves(self.adaptation, self.prior))

    def chain(self) -> tuple[FloatArray, FloatArray]:
        """Return points (ensembles, steps, walkers, d) and log-densities of the kept chain."""
        if self.kept:
            return np.stack(self.visited, axis=1), np.stack(self._levels, axis=1)
        shape = (self.settings.ensembles, 0, self.walkers)
        return np.empty((*shape, self.dimension)), np.empty(shape)

    def _evaluate(self, points: FloatArray) -> FloatArray:
        inside = int(np.sum(np.isfinite(self.prior(points))))
        with self._simulates:
            value = np.asarray(self.density(points))
            self.evaluations += inside
        if not self.adaptation.frozen:
            known = np.isfinite(value)
            self._seen.append(np.column_stack([points, value])[known])
        return value

    def _make_samplers(self) -> None:
        moves = list(self._moves(self.adaptation, self.prior))
        self._samplers = [
            emcee.EnsembleSampler(self.walkers, self.dimension, self._evaluate, moves=moves, vectorize=True)
            for _ in range(self.settings.ensembles)
        ]
        for sampler in self._samplers:  # without the wrapper that prints an interruption's whole trace
            sampler.log_prob_fn = self._evaluate

    def start(self, rng: np.random.Generator) -> None:
        """Scan the density along the axes, and draw overdispersed starts of finite density for every ensemble."""
        self.adaptation = Adaptation(scan_axes(self._evaluate, self.adaptation.proposal))
        wide = self.adaptation.proposal.widened(1.5, 4.0)
        for child in rng.spawn(self.settings.ensembles):
            random = np.random.RandomState(np.random.MT19937(int(child.integers(2**63))))
            points, values = np.empty((0, self.dimension)), np.empty(0)
            for attempt in range(60):
                new = wide.widened(0.85**attempt, 4.0).sample(random, self.walkers)
                level = self._evaluate(new)
                good = np.isfinite(level)
                points, values = np.concatenate([points, new[good]]), np.concatenate([values, level[good]])
                if len(points) >= self.walkers:
                    break
            else:
                raise CannotFinishError("no starting point of finite posterior density was found for the sampler")
            self._states.append(
                emcee.State(
                    points[: self.walkers], log_prob=values[: self.walkers], random_state=random.get_state(legacy=True)
                )
            )
        self._make_samplers()

    def advance(self) -> None:
        """Advance every ensemble by one step: those of the kept chain side by side, as one waits for simulations."""

        def step(e: int) -> emcee.State:
            (state,) = self._samplers[e].sample(self._states[e], store=False, skip_initial_state_check=True)
            return state

        with ThreadPoolExecutor(len(self._samplers) if self.adaptation.frozen else 1) as threads:
            self._states = [*threads.map(step, range(len(self._samplers)))]
        self.visited.append(np.stack([state.coords for state in self._states]))
        self._levels.append(np.stack([state.log_prob for state in self._states]))
        if self._left > 0:
            self._left -= 1
            if self._left == 0:
                self._end_phase()

    def _end_phase(self) -> None:
        """Adapt after a round of burn-in, and freeze what has been learnt once it is good."""
        if self.adaptation.frozen:
            self.visited, self._levels = [], []
            return
        self._evaluate_tails()
        points, levels, seen = np.array(self.visited), np.array(self._levels), np.concatenate(self._seen)
        late, fresh = len(points) // 2, len(points) - self.settings.burn_in * 3 // 4
        self.adaptation = adapt(
            self.adaptation,
            self.prior,
            fresh=(points[fresh:].reshape(-1, self.dimension), levels[fresh:].ravel()),
            late=(points[late:].reshape(-1, self.dimension), levels[late:].ravel()),
            seen=(seen[:, :-1], seen[:, -1]),
        )
        self.rounds += 1
        self._left = self.settings.burn_in
        if self.adaptation.good or self.rounds >= self.settings.max_rounds:
            self.adaptation, self._left, self._seen = replace(self.adaptation, frozen=True), self.settings.settle, []
        self._make_samplers()

    def _evaluate_tails(self) -> None:
        """Evaluate draws of the surrogate at a higher temperature, so that the next one is fitted to the tails too."""
        if self.adaptation.surrogate_density is None:
            return
        warm = partial(self.adaptation.surrogate_density.log_density, prior=self.prior, temperature=_TAIL_TEMPERATURE)
        wide = self.adaptation.proposal.widened(_TAIL_TEMPERATURE**0.5, 4.0)
        move, random = DelayedAcceptanceMove(warm, wide, self.adaptation.steps), np.random.RandomState()
        for e, state in enumerate(self._states):
            random.set_state(state.random_state)
            for _ in range(2):
                self._evaluate(move.propose_from(state.coords, random)[0])
            self._states[e].random_state = random.get_state(legacy=True)

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Return the whole state as arrays."""
        arrays = pack(self.adaptation, "adaptation.") | {
            "visited": np.array(self.visited),
            "levels": np.array(self._levels),
            "seen": np.concatenate(self._seen) if self._seen else np.empty((0, self.dimension + 1)),
            "counts": np.array([self.rounds, self._left, self.evaluations, self.next_check]),
            "seconds": np.array(self.seconds),
        }
        for e, state in enumerate(self._states):
            arrays |= {f"coords{e}": state.coords, f"log_prob{e}": state.log_prob}
            random = np.random.RandomState()
            random.set_state(state.random_state)
            arrays |= {f"{key}{e}": value for key, value in pack_random(random).items()}
        return arrays

    def restore(self, arrays: Arrays) -> None:
        """Continue where :meth:`state` was taken."""
        self.adaptation = unpack(Adaptation, arrays, "adaptation.")
        self.rounds, self._left, self.evaluations, self.next_check = map(int, arrays["counts"])
        self.seconds = float(arrays["seconds"])
        self.visited, self._levels = list(arrays["visited"]), list(arrays["levels"])
        self._seen = [np.asarray(arrays["seen"])]
        for e in range(self.settings.ensembles):
            random = unpack_random({"keys": arrays[f"keys{e}"], "rest": arrays[f"rest{e}"]})
            self._states.append(emcee.State(arrays[f"coords{e}"], log_prob=arrays[f"log_prob{e}"], random_state=random))
        self._make_samplers()


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
    def worst(self) -> Convergence:
        """Worst of each diagnostic over all dimensions."""
        return Convergence.worst(self.diagnoses)


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

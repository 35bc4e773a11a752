"""Independent ensembles in lockstep: tune, freeze what was learnt, sample until it is enough.

The ensembles never exchange walkers. While they burn in, everything that is evaluated trains a proposal and a stand-in
for the density, together for all; then both are frozen and what came before is thrown away, so that the kept chain has
one invariant distribution.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import emcee
import numpy as np
from emcee.moves import GaussianMove, Move, RedBlueMove
from numpy.typing import NDArray

from aero_bayes.errors import CannotFinishError
from aero_bayes.inference.checkpoint import pack, pack_random, read_arrays, unpack, unpack_random, write_arrays
from aero_bayes.inference.diagnostics import Diagnosis, diagnose
from aero_bayes.inference.moves import DifferentialMove, HeavyTail, IndependenceMove, ScreenedMove, ScreenedWalkMove, StretchMove
from aero_bayes.inference.tuning import Density, Tuned, log_prior_of, retuned, scout

FloatArray = NDArray[np.float64]


class MakeMoves(Protocol):
    """Moves and their shares from what tuning has learnt, for a density whose cheap part is ``prior``."""

    def __call__(self, tuned: Tuned, prior: Density) -> Sequence[tuple[Move, float]]: ...


@dataclass(frozen=True)
class SampleSettings:
    """How long and with what to sample.

    Parameters
    ----------
    ensembles, walkers : int
        At least four ensembles; twice the dimension plus two walkers by default (None).
    burn_in : tuple of int
        Steps of each burn-in round, after each of which proposal and stand-in are fitted anew. Further rounds, each
        half as long again, follow until they are good, at most ``extra_rounds``.
    settle : int
        Steps thrown away after the last of them.
    max_steps, time_limit : int, float
        Limits of the kept chain in steps and of the whole in s.
    r_hat, lengths, ess : float
        What counts as enough: rank-normalised R-hat across ensembles, length in autocorrelation times (never below
        50), and effective samples in bulk and tails of every parameter.
    dof : float
        Degrees of freedom of the heavy-tailed proposal.
    draws : int
        Draws an ensemble that the posterior keeps.
    predictive : int
        Draws over all ensembles that are simulated for the predictive bands.
    checkpoint_seconds : float
        Time between checkpoints.
    """

    ensembles: int = 4
    walkers: int | None = None
    burn_in: tuple[int, ...] = (8, 10, 12)
    extra_rounds: int = 8
    settle: int = 5
    max_steps: int = 8000
    time_limit: float = 900.0
    r_hat: float = 1.01
    lengths: float = 50.0
    ess: float = 1000.0
    dof: float = 5.0
    draws: int = 1000
    predictive: int = 200
    checkpoint_seconds: float = 15.0


@dataclass(frozen=True, eq=False)
class Chain:
    """What sampling gave.

    ``points`` has shape (ensembles, steps, walkers, d), ``log_density`` (ensembles, steps, walkers); ``diagnoses`` one
    entry a dimension. ``evaluations`` counts points inside the prior's support, tuning included; ``converged`` is False unless every criterion was met; ``reason`` says which was not.
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


def standard_moves(tuned: Tuned, prior: Density) -> Sequence[tuple[Move, float]]:
    """Proposals screened by the stand-in and a plain random walk; where there is none, moves that need to know little."""
    if tuned.stand_in is None or (tuned.frozen and tuned.overlap == 0.0):
        share = 0.85 if tuned.frozen else 0.3
        return [(IndependenceMove(tuned.proposal), share), (DifferentialMove(), 0.09), (StretchMove(), 0.06)]
    approximation = partial(tuned.stand_in.log_density, prior=prior)
    factor = tuned.proposal.factor
    return [
        (ScreenedMove(approximation, tuned.proposal, tuned.steps), 0.75),
        (ScreenedWalkMove(approximation, tuned.proposal), 0.15),
        (GaussianMove(2.0 * factor @ factor.T / len(factor), factor=3.0), 0.1),
    ]


def run(
    density: Density,
    proposal: HeavyTail,
    settings: SampleSettings,
    seed: int,
    *,
    checkpoint: Path | None = None,
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
    proposal : HeavyTail
        First approximation of the density; the ensembles start from draws of it, widened.
    settings : SampleSettings
    seed : int
    checkpoint : Path, optional
        File that is kept up to date; if it holds the state of the same run (seed, settings, ``identity``), the run goes
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
    walk = _Walk(density, proposal, settings, moves)
    key = hashlib.sha256(repr((seed, settings_key(settings), identity, proposal.mean.tolist())).encode()).hexdigest()
    stored = read_arrays(checkpoint) if checkpoint is not None else None
    if stored is not None and str(stored.get("key")) == key:
        walk.restore(stored)
    else:
        walk.start(np.random.default_rng(seed))
    before = walk.seconds
    verdict = Verdict(False, "it had not settled", (), 0)
    while True:
        now = time.perf_counter()
        walk.seconds = before + now - began
        kept, late = walk.kept, walk.seconds > settings.time_limit
        over = late or kept >= settings.max_steps
        if kept >= walk.next_check or over:
            verdict = judge(walk.chain()[0], settings, coupled=walk.coupled)
            walk.next_check = verdict.next_check
            if progress is not None and kept:
                progress("sampling", min(1.0, kept / walk.next_check), verdict.line)
            if verdict.enough or over:
                break
        walk.advance()
        if progress is not None and not walk.tuned.frozen:
            progress("burn-in", min(1.0, walk.rounds / len(settings.burn_in)), f"round {walk.rounds + 1}")
        if checkpoint is not None and now - saved > settings.checkpoint_seconds:
            write_arrays(checkpoint, walk.state() | {"key": np.array(key)})
            saved = time.perf_counter()
    if checkpoint is not None:
        write_arrays(checkpoint, walk.state() | {"key": np.array(key)})
    limit = "" if verdict.enough else f"stopped at the {'time' if late else 'step'} limit: "
    points, level = walk.chain()
    return Chain(
        points, level, verdict.diagnoses, walk.evaluations, walk.seconds, verdict.enough, limit + verdict.reason,
        walk.tuned,
    )  # fmt: skip


def settings_key(settings: SampleSettings) -> str:
    """What of the settings changes the chain (limits only end it)."""
    return repr(replace(settings, max_steps=0, time_limit=0.0, checkpoint_seconds=0.0, r_hat=0.0, lengths=0.0, ess=0.0))


@dataclass(frozen=True)
class Verdict:
    """Whether a chain is enough, what it lacks, and at how many steps it is worth asking again."""

    enough: bool
    reason: str
    diagnoses: tuple[Diagnosis, ...]
    next_check: int

    @property
    def line(self) -> str:
        d = self.diagnoses
        return (
            f"R-hat {max(x.r_hat for x in d):.4f}, tau {max(x.tau for x in d):.1f}, ESS {min(x.ess_bulk for x in d):.0f}"
        )


def judge(points: FloatArray, settings: SampleSettings, *, coupled: bool) -> Verdict:
    """The stop rule, for kept points of shape (ensembles, steps, walkers, d), and whether walkers meet each other."""
    length, dimension = max(settings.lengths, 50.0), points.shape[-1]
    if points.shape[1] < 8:
        nothing = Diagnosis(np.inf, np.inf, 0.0, 0.0)
        return Verdict(False, "hardly any step was kept", (nothing,) * dimension, int(length))
    steps = points.shape[1]
    diagnoses = tuple(diagnose(points[..., j], coupled=coupled) for j in range(dimension))
    tau, worst = max(d.tau for d in diagnoses), max(d.r_hat for d in diagnoses)
    low = min(min(d.ess_bulk, d.ess_tail) for d in diagnoses)
    missed, wanted = [], float(steps)
    if worst > settings.r_hat:
        missed.append(f"R-hat {worst:.4f} is above {settings.r_hat:g}")
        wanted = 1.2 * steps
    if steps < length * tau:
        missed.append(f"the chain has {steps / tau:.0f} autocorrelation times, {length:g} are needed")
        wanted = max(wanted, length * tau)
    if low < settings.ess:
        missed.append(f"{low:.0f} effective samples, {settings.ess:g} are wanted")
        wanted = max(wanted, steps * settings.ess / max(low, 1.0))
    next_check = int(np.clip(np.ceil(wanted), steps + 4, 1.5 * steps + 4))
    return Verdict(not missed, "; ".join(missed) or "every criterion was met", diagnoses, next_check)


class _Walk:
    """The ensembles, their random states, and what the present phase (a round, the settling, the chain) has visited."""

    def __init__(self, density: Density, proposal: HeavyTail, settings: SampleSettings, moves: MakeMoves) -> None:
        self.density, self.prior = density, log_prior_of(density)
        self.settings, self._moves, self.tuned = settings, moves, Tuned(proposal)
        self.dimension = proposal.mean.size
        self.walkers = settings.walkers or 2 * self.dimension + 2
        self.rounds, self._left, self.evaluations, self.seconds = 0, settings.burn_in[0], 0, 0.0
        self.next_check = int(max(settings.lengths, 50.0))
        self.visited: list[FloatArray] = []
        self._levels: list[FloatArray] = []
        self._seen: list[FloatArray] = []
        self._states: list[emcee.State] = []
        self._samplers: list[emcee.EnsembleSampler] = []

    @property
    def kept(self) -> int:
        """Steps of the kept chain; zero before it begins."""
        return len(self.visited) if self.tuned.frozen and self._left == 0 else 0

    @property
    def coupled(self) -> bool:
        """Whether a walker moves by where the others of its ensemble are."""
        return any(isinstance(move, RedBlueMove) for move, _ in self._moves(self.tuned, self.prior))

    def chain(self) -> tuple[FloatArray, FloatArray]:
        """Points (ensembles, steps, walkers, d) and log-densities of what is kept."""
        if self.kept:
            return np.stack(self.visited, axis=1), np.stack(self._levels, axis=1)
        shape = (self.settings.ensembles, 0, self.walkers)
        return np.empty((*shape, self.dimension)), np.empty(shape)

    def _evaluate(self, points: FloatArray) -> FloatArray:
        value = np.asarray(self.density(points))
        self.evaluations += int(np.sum(np.isfinite(self.prior(points))))
        if not self.tuned.frozen:
            known = np.isfinite(value)
            self._seen.append(np.column_stack([points, value])[known])
        return value

    def _make_samplers(self) -> None:
        moves = list(self._moves(self.tuned, self.prior))
        self._samplers = [
            emcee.EnsembleSampler(self.walkers, self.dimension, self._evaluate, moves=moves, vectorize=True)
            for _ in range(self.settings.ensembles)
        ]

    def start(self, rng: np.random.Generator) -> None:
        """Look around, and draw overdispersed starts of finite density for every ensemble."""
        self.tuned = Tuned(scout(self._evaluate, self.tuned.proposal))
        wide = self.tuned.proposal.widened(1.5, 4.0)
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
        """One step of every ensemble."""
        for e, sampler in enumerate(self._samplers):
            (self._states[e],) = sampler.sample(self._states[e], store=False, skip_initial_state_check=True)
        self.visited.append(np.stack([state.coords for state in self._states]))
        self._levels.append(np.stack([state.log_prob for state in self._states]))
        if self._left > 0:
            self._left -= 1
            if self._left == 0:
                self._end_phase()

    def _end_phase(self) -> None:
        """After a round, learn from it and freeze what is good enough; after the settling, begin the kept chain."""
        if not self.tuned.frozen:
            self._look_further()
            rows = slice(len(self.visited) // 4, None)
            points = np.concatenate(self.visited[rows]).reshape(-1, self.dimension)
            seen = np.concatenate(self._seen)
            self.tuned = retuned(
                self.tuned, self.prior, (points, np.concatenate(self._levels[rows]).ravel()), (seen[:, :-1], seen[:, -1])
            )
            self.rounds += 1
            planned, extra = self.settings.burn_in, self.rounds - len(self.settings.burn_in)
            if extra >= self.settings.extra_rounds or (extra >= 0 and self.tuned.good):
                self.tuned, self._left, self._seen = replace(self.tuned, frozen=True), self.settings.settle, []
            else:
                self._left = planned[self.rounds] if extra < 0 else int(planned[-1] * 1.5 ** (extra + 1))
            self._make_samplers()
        self.visited, self._levels = [], []

    def _look_further(self) -> None:
        """Evaluate draws of the stand-in at a higher temperature, so that the next one knows the ends of the density."""
        if self.tuned.stand_in is None:
            return
        warm = partial(self.tuned.stand_in.log_density, prior=self.prior, temperature=3.0)
        random = np.random.RandomState()
        for e, state in enumerate(self._states):
            random.set_state(state.random_state)
            move = ScreenedMove(warm, self.tuned.proposal.widened(1.7, 4.0), self.tuned.steps)
            for _ in range(2):
                self._evaluate(move.propose_from(state.coords, random)[0])
            self._states[e].random_state = random.get_state(legacy=True)

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Everything, as arrays."""
        arrays = pack(self.tuned, "tuned.") | {
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

    def restore(self, arrays: dict[str, NDArray[np.generic]]) -> None:
        """Continue where :meth:`state` was taken."""
        self.tuned = unpack(Tuned, arrays, "tuned.")
        self.rounds, self._left, self.evaluations, self.next_check = map(int, arrays["counts"])
        self.seconds = float(arrays["seconds"])
        self.visited, self._levels = list(arrays["visited"]), list(arrays["levels"])
        self._seen = [np.asarray(arrays["seen"])]
        for e in range(self.settings.ensembles):
            random = unpack_random({"keys": arrays[f"keys{e}"], "rest": arrays[f"rest{e}"]})
            self._states.append(emcee.State(arrays[f"coords{e}"], log_prob=arrays[f"log_prob{e}"], random_state=random))
        self._make_samplers()

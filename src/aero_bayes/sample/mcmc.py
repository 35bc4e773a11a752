"""Independent ensembles in lockstep: burn in, freeze the proposal, sample until it is enough.

The ensembles never exchange walkers. During burn-in the proposal of the independence move is refitted from all of
them; then it is frozen and what came before is thrown away, so that the kept chain has one invariant distribution.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import emcee
import numpy as np
from emcee.moves import Move
from numpy.typing import NDArray
from scipy.stats import chi2

from aero_bayes.errors import CannotFinishError
from aero_bayes.sample.checkpoint import pack_random, read_arrays, unpack_random, write_arrays
from aero_bayes.sample.diagnostics import Diagnosis, diagnose
from aero_bayes.sample.moves import DifferentialMove, HeavyTail, IndependenceMove, StretchMove, Warp

FloatArray = NDArray[np.float64]
MakeMoves = Callable[[HeavyTail, bool], Sequence[tuple[Move, float]]]


class LogDensity(Protocol):
    """Vectorised log-density: points (n, d) to (n,), minus infinity where there is none."""

    def __call__(self, points: FloatArray) -> FloatArray: ...


@dataclass(frozen=True)
class SampleSettings:
    """How long and with what to sample.

    Parameters
    ----------
    ensembles, walkers : int
        At least four ensembles; twice the dimension plus two walkers by default (None).
    burn_in : tuple of int
        Steps of each burn-in round; the proposal is refitted after each. Rounds as long as the last follow until the
        proposal no longer changes, at most ``extra_rounds``.
    settle : int
        Steps thrown away after the last refit.
    max_steps, time_limit : int, float
        Limits of the kept chain in steps and of the whole in s.
    r_hat, lengths, ess : float
        What counts as enough: rank-normalised R-hat across ensembles, length in autocorrelation times (never below
        50), and effective samples in bulk and tails of every parameter.
    independence, differential, stretch : float
        Shares of the moves once the proposal is frozen; those with a share are equally likely before.
    dof : float
        Degrees of freedom of the independence proposal.
    draws : int
        Draws an ensemble that the posterior keeps.
    predictive : int
        Draws over all ensembles that are simulated for the predictive bands.
    checkpoint_seconds : float
        Time between checkpoints.
    """

    ensembles: int = 4
    walkers: int | None = None
    burn_in: tuple[int, ...] = (40, 60, 80)
    extra_rounds: int = 8
    settle: int = 20
    max_steps: int = 8000
    time_limit: float = 900.0
    r_hat: float = 1.01
    lengths: float = 50.0
    ess: float = 1000.0
    independence: float = 0.8
    differential: float = 0.12
    stretch: float = 0.08
    dof: float = 12.0
    draws: int = 1000
    predictive: int = 200
    checkpoint_seconds: float = 15.0


@dataclass(frozen=True, eq=False)
class Chain:
    """What sampling gave.

    ``points`` has shape (ensembles, steps, walkers, d), ``log_density`` (ensembles, steps, walkers); ``diagnoses`` one
    entry a dimension. ``converged`` is False unless every criterion was met; ``reason`` says which was not.
    """

    points: FloatArray
    log_density: FloatArray
    diagnoses: tuple[Diagnosis, ...]
    acceptance: float
    evaluations: int
    seconds: float
    converged: bool
    reason: str
    proposal: HeavyTail

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


def standard_moves(settings: SampleSettings) -> MakeMoves:
    """The mix: independence, differential evolution and stretch."""

    def make(proposal: HeavyTail, frozen: bool) -> Sequence[tuple[Move, float]]:
        moves = [
            (IndependenceMove(proposal), settings.independence),
            (DifferentialMove(), settings.differential),
            (StretchMove(), settings.stretch),
        ]
        return [(move, share if frozen else 1.0) for move, share in moves if share > 0.0]

    return make


def run(
    density: LogDensity,
    proposal: HeavyTail,
    settings: SampleSettings,
    seed: int,
    *,
    checkpoint: Path | None = None,
    identity: str = "",
    moves: MakeMoves | None = None,
    progress: Callable[[str, float, str], None] | None = None,
) -> Chain:
    """Draw from a density until the criteria are met or a limit is reached.

    Parameters
    ----------
    density : callable
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
        Makes the moves from a proposal and whether it is frozen; the standard mix by default.
    progress : callable, optional
        Told a phase, how far it is (0 to 1), and a line of text.

    Raises
    ------
    CannotFinishError
        If no starting point of finite density can be found.
    """
    began = time.perf_counter()
    walker = _Walk(density, proposal, settings, moves or standard_moves(settings))
    key = hashlib.sha256(repr((seed, settings_key(settings), identity, proposal.mean.tolist())).encode()).hexdigest()
    stored = read_arrays(checkpoint) if checkpoint is not None else None
    if stored is not None and str(stored.get("key")) == key:
        walker.restore(stored)
    else:
        walker.start(np.random.default_rng(seed))
    elapsed_before = walker.seconds
    saved = time.perf_counter()
    verdict: tuple[bool, str, tuple[Diagnosis, ...]] = (False, "", ())
    while True:
        step, burn = walker.step, walker.burn_in
        total = burn + settings.max_steps
        now = time.perf_counter()
        walker.seconds = elapsed_before + now - began
        late = walker.seconds > settings.time_limit
        if step >= max(burn + 100, walker.next_check) or step >= total or late:
            verdict = _judge(walker.kept, settings)
            if progress is not None:
                progress("sampling", min(1.0, (step - burn) / settings.max_steps), _line(verdict[2]))
            if verdict[0] or step >= total or late:
                break
            walker.next_check = step + max(50, int(0.3 * (step - burn)))
        walker.advance()
        if progress is not None and step < burn and step % 10 == 0:
            progress("burn-in", step / max(burn, 1), f"round {walker.rounds + 1}")
        if checkpoint is not None and now - saved > settings.checkpoint_seconds:
            write_arrays(checkpoint, walker.state() | {"key": np.array(key)})
            saved = time.perf_counter()
    if checkpoint is not None:
        write_arrays(checkpoint, walker.state() | {"key": np.array(key)})
    converged, reason, diagnoses = verdict
    if not converged:
        limit = "the time limit" if walker.step < total else "the step limit"
        reason = f"stopped at {limit}: {reason}"
    points, log_density = walker.kept
    return Chain(
        points, log_density, diagnoses, walker.acceptance, walker.evaluations, walker.seconds, converged, reason,
        walker.proposal,
    )  # fmt: skip


def settings_key(settings: SampleSettings) -> str:
    """What of the settings changes the chain (limits only end it)."""
    return repr(replace(settings, max_steps=0, time_limit=0.0, checkpoint_seconds=0.0, r_hat=0.0, lengths=0.0, ess=0.0))


def _judge(kept: tuple[FloatArray, FloatArray], settings: SampleSettings) -> tuple[bool, str, tuple[Diagnosis, ...]]:
    points, _ = kept
    steps = points.shape[1]
    if steps < 8:
        nothing = Diagnosis(np.inf, np.inf, 0.0, 0.0)
        return False, "hardly any step was kept", (nothing,) * points.shape[-1]
    diagnoses = tuple(diagnose(points[..., j]) for j in range(points.shape[-1]))
    tau = max(d.tau for d in diagnoses)
    length = max(settings.lengths, 50.0)
    missed = []
    if max(d.r_hat for d in diagnoses) > settings.r_hat:
        missed.append(f"R-hat {max(d.r_hat for d in diagnoses):.4f} is above {settings.r_hat:g}")
    if steps < length * tau:
        missed.append(f"the chain has {steps / tau:.0f} autocorrelation times, {length:g} are needed")
    low = min(min(d.ess_bulk, d.ess_tail) for d in diagnoses)
    if low < settings.ess:
        missed.append(f"{low:.0f} effective samples, {settings.ess:g} are wanted")
    return not missed, "; ".join(missed) or "every criterion was met", diagnoses


def _line(diagnoses: tuple[Diagnosis, ...]) -> str:
    worst = max(d.r_hat for d in diagnoses)
    return f"R-hat {worst:.4f}, tau {max(d.tau for d in diagnoses):.1f}, ESS {min(d.ess_bulk for d in diagnoses):.0f}"


class _Walk:
    """The ensembles, their random states and everything they have visited."""

    def __init__(self, density: LogDensity, proposal: HeavyTail, settings: SampleSettings, moves: MakeMoves) -> None:
        self.density, self.proposal, self.settings, self._moves = density, proposal, settings, moves
        self.dimension = proposal.mean.size
        self.walkers = settings.walkers or 2 * self.dimension + 2
        self.rounds, self._round_end, self._frozen_at = 0, settings.burn_in[0], -1
        self.step, self.evaluations, self.seconds, self.next_check = 0, 0, 0.0, 0
        self._accepted, self._tried = 0, 0
        self._points = np.empty((settings.ensembles, 256, self.walkers, self.dimension))
        self._density = np.empty((settings.ensembles, 256, self.walkers))
        self._states: list[emcee.State] = []
        self._samplers: list[emcee.EnsembleSampler] = []

    @property
    def acceptance(self) -> float:
        return self._accepted / max(self._tried, 1)

    @property
    def burn_in(self) -> int:
        """First step that is kept; before the proposal is frozen, the earliest that it could be."""
        planned = sum(self.settings.burn_in[self.rounds :]) + self._round_end - self._round_length
        return (self._frozen_at if self._frozen_at >= 0 else max(planned, self._round_end)) + self.settings.settle

    @property
    def _round_length(self) -> int:
        lengths = self.settings.burn_in
        return lengths[min(self.rounds, len(lengths) - 1)]

    @property
    def kept(self) -> tuple[FloatArray, FloatArray]:
        """Chain after burn-in."""
        return self._points[:, self.burn_in : self.step], self._density[:, self.burn_in : self.step]

    def _evaluate(self, points: FloatArray) -> FloatArray:
        self.evaluations += len(points)
        return self.density(points)

    def _make_samplers(self) -> None:
        moves = list(self._moves(self.proposal, self._frozen_at >= 0))
        self._samplers = [
            emcee.EnsembleSampler(self.walkers, self.dimension, self._evaluate, moves=moves, vectorize=True)
            for _ in range(self.settings.ensembles)
        ]

    def start(self, rng: np.random.Generator) -> None:
        """Draw overdispersed starts of finite density for every ensemble."""
        wide = self.proposal.widened(1.5, 4.0)
        for child in rng.spawn(self.settings.ensembles):
            random = np.random.RandomState(np.random.MT19937(int(child.integers(2**63))))
            points = np.empty((0, self.dimension))
            values = np.empty(0)
            for attempt in range(60):
                new = wide.widened(0.85**attempt, 4.0).sample(random, self.walkers)
                density = self._evaluate(new)
                good = np.isfinite(density)
                points, values = np.concatenate([points, new[good]]), np.concatenate([values, density[good]])
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
        if self.step == self._points.shape[1]:
            self._points = np.concatenate([self._points, np.empty_like(self._points)], axis=1)
            self._density = np.concatenate([self._density, np.empty_like(self._density)], axis=1)
        for e, sampler in enumerate(self._samplers):
            old = self._states[e].coords.copy()
            for state in sampler.sample(self._states[e], store=False, skip_initial_state_check=True):
                self._states[e] = state
            self._points[e, self.step], self._density[e, self.step] = self._states[e].coords, self._states[e].log_prob
            if self._frozen_at >= 0 and self.step >= self.burn_in:
                self._accepted += int(np.sum(np.any(old != self._states[e].coords, axis=1)))
                self._tried += self.walkers
        self.step += 1
        if self._frozen_at < 0 and self.step == self._round_end:
            self._rescue()
            self._end_round()

    def _rescue(self) -> None:
        """Burn-in only: walkers lost where the density is negligible start again beside a good one."""
        best = max(float(np.max(state.log_prob)) for state in self._states)
        floor = best - 0.5 * float(chi2.isf(1e-7, self.dimension)) - 10.0
        for state in self._states:
            lost = np.flatnonzero(state.log_prob < floor)
            good = np.flatnonzero(state.log_prob >= floor)
            if lost.size == 0 or good.size < 2:
                continue
            random = np.random.RandomState()
            random.set_state(state.random_state)
            pairs = good[random.randint(good.size, size=(lost.size, 3))]
            step = 0.5 * (state.coords[pairs[:, 1]] - state.coords[pairs[:, 2]])
            new = state.coords[pairs[:, 0]] + step * random.rand(lost.size, 1)
            density = self._evaluate(new)
            usable = np.isfinite(density)
            state.coords[lost[usable]], state.log_prob[lost[usable]] = new[usable], density[usable]
            state.random_state = random.get_state(legacy=True)

    def _end_round(self) -> None:
        """Fit the proposal to the last three quarters of a round, over all ensembles; freeze it once it has settled."""
        length = self._round_length
        recent = self._points[:, self.step - 3 * length // 4 : self.step].reshape(-1, self.dimension)
        density = self._density[:, self.step - 3 * length // 4 : self.step].reshape(-1)
        floor = density.max() - 0.5 * float(chi2.isf(1e-7, self.dimension)) - 10.0
        good = recent[density >= floor]
        settled = False
        if len(np.unique(good[:, 0])) > 4 * self.dimension:
            settled = self.proposal.resembles(good)
            self.proposal = HeavyTail.fit(good, self.proposal.dof)
        self.rounds += 1
        enough = self.rounds >= len(self.settings.burn_in) + self.settings.extra_rounds
        if enough or (settled and self.rounds >= len(self.settings.burn_in)):
            self._frozen_at = self.step
        self._round_end = self.step + self._round_length
        self._make_samplers()

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Everything, as arrays."""
        arrays: dict[str, NDArray[np.generic]] = {
            "points": self._points[:, : self.step],
            "density": self._density[:, : self.step],
            "mean": self.proposal.mean,
            "factor": self.proposal.factor,
            "dof": np.array(self.proposal.dof),
            "knots": self.proposal.warp.knots,
            "scores": self.proposal.warp.scores,
            "tails": self.proposal.warp.tails,
            "counts": np.array([self.step, self.evaluations, self.next_check, self._accepted, self._tried]),
            "burn": np.array([self.rounds, self._round_end, self._frozen_at]),
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
        numbers = {key: np.asarray(value) for key, value in arrays.items()}
        self.step, self.evaluations, self.next_check, self._accepted, self._tried = map(int, numbers["counts"])
        self.rounds, self._round_end, self._frozen_at = map(int, numbers["burn"])
        self.seconds = float(numbers["seconds"])
        warp = Warp(numbers["knots"], numbers["scores"], numbers["tails"])
        self.proposal = HeavyTail(numbers["mean"], numbers["factor"], float(numbers["dof"]), warp)
        size = max(256, self.step)
        self._points = np.empty((self.settings.ensembles, size, self.walkers, self.dimension))
        self._density = np.empty((self.settings.ensembles, size, self.walkers))
        self._points[:, : self.step], self._density[:, : self.step] = numbers["points"], numbers["density"]
        for e in range(self.settings.ensembles):
            random = unpack_random({"keys": numbers[f"keys{e}"], "rest": numbers[f"rest{e}"]})
            self._states.append(
                emcee.State(numbers[f"coords{e}"], log_prob=numbers[f"log_prob{e}"], random_state=random)
            )
        self._make_samplers()

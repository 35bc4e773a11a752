"""The walkers of all ensembles: how they start, move, adapt during burn-in, and are stored."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import emcee
import numpy as np
from emcee.moves import RedBlueMove
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.checkpoint import Arrays, pack, pack_random, unpack, unpack_random
from aero_bayes.errors import CannotFinishError
from aero_bayes.sampling.adaptation import Adaptation, Density, adapt, log_prior_of, scan_axes
from aero_bayes.sampling.moves import DelayedAcceptanceMove, WarpedStudentT
from aero_bayes.sampling.settings import SampleSettings
from aero_bayes.sampling.standard_moves import MakeMoves
from aero_bayes.sampling.stopping import MIN_STEPS

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
        value = np.asarray(self.density(points))
        self.evaluations += int(np.sum(np.isfinite(self.prior(points))))
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
        """Advance every ensemble by one step."""
        for e, sampler in enumerate(self._samplers):
            (self._states[e],) = sampler.sample(self._states[e], store=False, skip_initial_state_check=True)
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

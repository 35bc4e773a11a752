"""Delayed acceptance: a Markov chain on an inexpensive approximation of the target makes each proposal."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from emcee.moves import MHMove

from aero_bayes.arrays import FloatArray
from aero_bayes.sampling.moves.warped_student_t import WarpedStudentT


class DelayedAcceptanceMove(MHMove):  # type: ignore[misc]
    """Take ``steps`` independence steps on the approximation s, then accept or reject by the target p."""

    def __init__(
        self, approximation: Callable[[FloatArray], FloatArray], proposal: WarpedStudentT, steps: int = 20
    ) -> None:
        super().__init__(self.propose_from, ndim=proposal.mean.size)
        self.approximation, self.proposal, self.steps = approximation, proposal, steps

    def propose_from(self, coords: FloatArray, random: np.random.RandomState) -> tuple[FloatArray, FloatArray]:
        """Return where the inner chains from (n, d) end, and log s(x) - log s(x')."""
        n = len(coords)
        # Independence proposals do not depend on where the chain is: all are made and weighed at once.
        new = self.proposal.sample(random, n * self.steps)
        every = np.concatenate([coords, new])
        value = self.approximation(every)
        weight = np.where(np.isfinite(value), value - self.proposal.log_density(every), -np.inf)
        at = np.arange(n)
        for threshold, k in zip(np.log(random.rand(self.steps, n)), range(n, n * (self.steps + 1), n), strict=True):
            trial = np.arange(k, k + n)
            with np.errstate(invalid="ignore"):  # -inf after -inf: stay
                at = np.where(threshold < weight[trial] - weight[at], trial, at)
        with np.errstate(invalid="ignore"):
            ratio = value[:n] - value[at]
        return every[at], np.where(np.isnan(ratio), 0.0, ratio)


class DelayedAcceptanceWalkMove(MHMove):  # type: ignore[misc]
    """Delayed acceptance after a few short steps on s: leaves the places where s is poor, since it
    is poor around them."""

    def __init__(
        self, approximation: Callable[[FloatArray], FloatArray], proposal: WarpedStudentT, steps: int = 6
    ) -> None:
        super().__init__(self.propose_from, ndim=proposal.mean.size)
        self.approximation, self.steps = approximation, steps
        self.factor = proposal.factor / np.sqrt(proposal.mean.size)

    def propose_from(self, coords: FloatArray, random: np.random.RandomState) -> tuple[FloatArray, FloatArray]:
        """Return where the inner chains from (n, d) end, and log s(x) - log s(x')."""
        at, first = coords.copy(), self.approximation(coords)
        value = first.copy()
        for _ in range(self.steps):
            scale = np.exp(random.randn(len(at), 1))
            new = at + scale * random.randn(*at.shape) @ self.factor.T
            level = self.approximation(new)
            taken = np.log(random.rand(len(at))) < level - value
            at[taken], value[taken] = new[taken], level[taken]
        return at, first - value

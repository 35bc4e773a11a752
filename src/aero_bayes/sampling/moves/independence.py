"""Independence move: propose from a fixed heavy-tailed approximation of the target."""

from __future__ import annotations

import numpy as np
from emcee.moves import MHMove

from aero_bayes.arrays import FloatArray
from aero_bayes.sampling.moves.warped_student_t import WarpedStudentT


class IndependenceMove(MHMove):  # type: ignore[misc]
    """Propose x' from a fixed density q, accept with probability min(1, p(x') q(x) / (p(x) q(x'))).

    As long as q does not change the chain keeps its target; heavy tails keep the weights p / q bounded, so that the
    chain converges geometrically wherever q covers p."""

    def __init__(self, proposal: WarpedStudentT) -> None:
        super().__init__(self._propose, ndim=proposal.mean.size)
        self.proposal = proposal

    def _propose(self, coords: FloatArray, random: np.random.RandomState) -> tuple[FloatArray, FloatArray]:
        new = self.proposal.sample(random, len(coords))
        return new, self.proposal.log_density(coords) - self.proposal.log_density(new)

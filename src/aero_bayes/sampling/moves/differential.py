"""Differential evolution: jump by the difference of two other walkers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from emcee.moves import RedBlueMove

from aero_bayes.arrays import FloatArray


class DifferentialMove(RedBlueMove):  # type: ignore[misc]
    """Add a scaled difference of two walkers of the other half, plus a little noise.

    With x_a, x_b drawn from the other half, x' = x + g (x_a - x_b) + e; the proposal is symmetric. g is
    2.38 / sqrt(2 d) spread by 30 %, and 1 in a tenth of the steps, which jumps between modes."""

    def __init__(self, jump: float = 0.1, noise: float = 1e-5) -> None:
        super().__init__()
        self._jump, self._noise = jump, noise

    def get_proposal(
        self, sample: FloatArray, complement: Sequence[FloatArray], random: np.random.RandomState
    ) -> tuple[FloatArray, FloatArray]:
        """Return proposals for one half (n, d) from the other, and the logarithm of the proposal ratio (zero)."""
        others = np.concatenate(list(complement))
        n, d = sample.shape
        first = random.randint(len(others), size=n)
        second = (first + 1 + random.randint(len(others) - 1, size=n)) % len(others)
        scale = 2.38 / np.sqrt(2.0 * d) * np.exp(0.3 * random.randn(n))
        if random.rand() < self._jump:
            scale = np.ones(n)
        spread = self._noise * np.std(others, axis=0) * random.randn(n, d)
        return sample + scale[:, None] * (others[first] - others[second]) + spread, np.zeros(n)

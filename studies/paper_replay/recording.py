"""The paper's experiment on the simulated AERO; the paper's own recording is not public."""

from __future__ import annotations

import numpy as np

from aero_bayes.bench import default_truth, paper_step, simulate_recording, white
from aero_bayes.data import Recording


def paper_recording(seed: int = 0) -> Recording:
    """Simulate the paper's experiment: 24 V for 20 s, 0 V for 20 s, 2,001 samples with white noise.

    The rig is that of :func:`aero_bayes.bench.default_truth`; the seed decides the noise.
    """
    rng = np.random.default_rng([seed, 2])
    return simulate_recording(
        default_truth(), paper_step(), white(), rng, duration=40.0, rate_hz=50.0, name="paper_step"
    )

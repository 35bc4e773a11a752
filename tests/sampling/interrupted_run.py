"""Samples a slow two-dimensional density into a checkpoint: to be killed by the test that starts it."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from aero_bayes.estimate.convergence import SampleSettings
from aero_bayes.estimate.mcmc import run_chain
from aero_bayes.estimate.moves import WarpedStudentT

SETTINGS = SampleSettings(
    walkers=8,
    burn_in=15,
    max_rounds=3,
    settle=5,
    max_steps=150,
    checkpoint_seconds=0.0,
    max_minutes=1e7,
    ess=1e9,
)
PROPOSAL = WarpedStudentT.of(np.array([0.5, 0.5]), 3.0 * np.eye(2))


def banana(points: np.ndarray) -> np.ndarray:
    return -0.5 * points[:, 0] ** 2 - 0.5 * (points[:, 1] - points[:, 0] ** 2) ** 2


def slow(points: np.ndarray) -> np.ndarray:
    time.sleep(0.0005)
    return banana(points)


if __name__ == "__main__":
    run_chain(slow, PROPOSAL, SETTINGS, 5, checkpoint=Path(sys.argv[1]), identity="banana")

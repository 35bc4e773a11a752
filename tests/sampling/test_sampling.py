"""The sampler as a whole: known answers, honesty about short chains, and survival of kill -9."""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import interrupted_run
import numpy as np
import pytest
from emcee.moves import StretchMove
from facts import facts

from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.adaptation import Adaptation
from aero_bayes.estimate.convergence import SampleSettings
from aero_bayes.estimate.mcmc import Chain, run_chain
from aero_bayes.estimate.moves import WarpedStudentT

pytestmark = pytest.mark.long

QUICK = SampleSettings(walkers=16, ess=1500.0, max_rounds=6, max_steps=3000)


def stretch_only(adaptation: Adaptation, prior: object) -> list[tuple[StretchMove, float]]:
    return [(StretchMove(), 1.0)]


def off(chain: Chain, quantity: np.ndarray, truth: float) -> float:
    """Error of a mean over its standard error at the chain's smallest effective size."""
    ess = min(chain.worst.ess_bulk, chain.worst.ess_tail)
    return abs(float(np.mean(quantity)) - truth) / float(np.std(quantity) / np.sqrt(ess))


def test_a_corner_across_all_coordinates_is_sampled_at_few_evaluations() -> None:
    """Exponential to both sides of an oblique plane, a hundred times narrower than the start says, and else normal."""
    axes = np.array([[1.0, -0.6, 0.4, 0.2], [0.2, 1.0, 0.0, -0.3], [0.0, 0.5, 1.0, 0.0], [-0.4, 0.0, 0.3, 1.0]])

    def corner(x: np.ndarray) -> np.ndarray:
        y = x @ axes.T
        return -np.where(y[:, 0] > 0.0, 100.0, -1000.0) * y[:, 0] - 0.5 * np.sum(y[:, 1:] ** 2, axis=1)

    chain = run_chain(corner, WarpedStudentT.of(np.zeros(4), np.eye(4), axes=axes), SampleSettings(), 8)
    assert chain.converged
    assert chain.evaluations < 5.0 * min(chain.worst.ess_bulk, chain.worst.ess_tail)
    y = chain.points.reshape(-1, 4) @ axes.T
    right = 10.0 / 11.0
    assert off(chain, y[:, 0] > 0.0, right) < 5.0
    assert off(chain, y[:, 0], right / 100.0 - (1.0 - right) / 1000.0) < 5.0
    assert off(chain, y[:, 3] ** 2, 1.0) < 5.0


def test_two_near_modes_have_their_weights() -> None:
    def modes(x: np.ndarray) -> np.ndarray:
        one, two = -0.5 * ((x[:, 0] - 2.5) / 0.7) ** 2, -0.5 * ((x[:, 0] + 2.5) / 0.7) ** 2
        return np.logaddexp(np.log(0.3) + one, np.log(0.7) + two) - 0.5 * x[:, 1] ** 2

    chain = run_chain(modes, WarpedStudentT.of(np.zeros(2), np.diag([6.0, 1.0])), QUICK, 7)
    assert chain.converged
    assert off(chain, chain.points[..., 0] > 0.0, 0.3) < 5.0


def test_walkers_that_meet_need_fifty_autocorrelation_times() -> None:
    settings = SampleSettings(walkers=8, burn_in=10, max_rounds=1, settle=0, max_steps=60, lengths=1.0, ess=1.0)
    chain = run_chain(interrupted_run.banana, interrupted_run.PROPOSAL, settings, 3, moves=stretch_only)
    assert not chain.converged
    assert re.search(facts("50"), chain.reason)


def test_same_seed_same_chain_and_another_seed_another() -> None:
    settings = replace(interrupted_run.SETTINGS, checkpoint_seconds=1e9)
    one, two, three = (
        run_chain(interrupted_run.banana, interrupted_run.PROPOSAL, settings, s).points for s in (5, 5, 6)
    )
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(one, three)


def test_no_finite_start_is_said() -> None:
    with pytest.raises(CannotFinishError, match="no starting point"):
        run_chain(lambda x: np.full(len(x), -np.inf), interrupted_run.PROPOSAL, interrupted_run.SETTINGS, 1)


def test_kill_nine_at_any_moment_changes_no_bit(tmp_path: Path) -> None:
    whole = run_chain(interrupted_run.banana, interrupted_run.PROPOSAL, interrupted_run.SETTINGS, 5, identity="banana")
    path = tmp_path / "chain.npz"
    script = Path(interrupted_run.__file__)
    moments = random.Random(8)
    kills = 0
    for _ in range(12):
        process = subprocess.Popen([sys.executable, str(script), str(path)])
        while not path.exists() and process.poll() is None:
            time.sleep(0.01)
        size = path.stat().st_size
        deadline = time.monotonic() + 20
        while path.stat().st_size <= size and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.005)
        time.sleep(moments.uniform(0.0, 0.15))
        if process.poll() is None:
            os.kill(process.pid, signal.SIGKILL)
            kills += 1
        process.wait()
        if kills == 3:
            break
    assert kills >= 2
    resumed = run_chain(
        interrupted_run.banana,
        interrupted_run.PROPOSAL,
        interrupted_run.SETTINGS,
        5,
        checkpoint=path,
        identity="banana",
    )
    np.testing.assert_array_equal(resumed.points, whole.points)
    np.testing.assert_array_equal(resumed.log_density, whole.log_density)
    assert resumed.evaluations == whole.evaluations


def test_a_checkpoint_of_another_run_is_not_continued(tmp_path: Path) -> None:
    path = tmp_path / "chain.npz"
    settings = replace(interrupted_run.SETTINGS, max_steps=20)
    run_chain(interrupted_run.banana, interrupted_run.PROPOSAL, settings, 5, checkpoint=path, identity="one")
    fresh = run_chain(interrupted_run.banana, interrupted_run.PROPOSAL, settings, 5, identity="two")
    other = run_chain(interrupted_run.banana, interrupted_run.PROPOSAL, settings, 5, checkpoint=path, identity="two")
    assert other.evaluations == fresh.evaluations
    path.write_bytes(b"half a file")
    again = run_chain(interrupted_run.banana, interrupted_run.PROPOSAL, settings, 5, checkpoint=path, identity="two")
    np.testing.assert_array_equal(again.points, fresh.points)

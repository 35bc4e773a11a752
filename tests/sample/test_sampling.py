"""The sampler as a whole: known answers, honesty about short chains, and survival of kill -9."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import interrupted_run
import numpy as np
import pytest
from scipy import stats

from aero_bayes.errors import CannotFinishError
from aero_bayes.sample.mcmc import SampleSettings, run
from aero_bayes.sample.moves import HeavyTail


def test_long_chain_of_a_banana_has_its_moments() -> None:
    settings = SampleSettings(walkers=12, burn_in=(40, 60), ess=2500, max_steps=3000)
    chain = run(interrupted_run.banana, HeavyTail.of(np.zeros(2), np.diag([1.0, 3.0])), settings, 3)
    assert chain.converged
    assert chain.r_hat <= 1.01
    x = chain.points.reshape(-1, 2)
    ess = chain.ess_tail
    assert abs(x[:, 0].mean()) < 5 / np.sqrt(ess)
    assert x[:, 1].mean() == pytest.approx(1.0, abs=5 * np.sqrt(3 / ess))
    assert x[:, 1].var() == pytest.approx(3.0, rel=0.25)
    assert stats.kstest(x[:: int(3 * chain.tau), 0], "norm").pvalue > 1e-4


def test_never_converged_below_fifty_autocorrelation_times() -> None:
    settings = SampleSettings(walkers=8, burn_in=(10,), settle=0, max_steps=60, lengths=1.0, ess=1.0, r_hat=10.0)
    stretch_only = replace(settings, independence=0.0, differential=0.0, stretch=1.0)
    chain = run(interrupted_run.banana, interrupted_run.PROPOSAL, stretch_only, 3)
    assert not chain.converged
    assert "autocorrelation times, 50 are needed" in chain.reason


def test_two_separate_modes_are_not_called_converged() -> None:
    def modes(x: np.ndarray) -> np.ndarray:
        return np.logaddexp(-0.5 * ((x[:, 0] - 20) / 0.5) ** 2, -0.5 * ((x[:, 0] + 20) / 0.5) ** 2) - 0.5 * x[:, 1] ** 2

    settings = SampleSettings(walkers=8, burn_in=(20,), max_steps=800, independence=0.0, differential=0.0, stretch=1.0)
    chain = run(modes, HeavyTail.of(np.zeros(2), np.diag([400.0, 1.0])), settings, 5)
    assert not chain.converged


def test_same_seed_same_chain_and_another_seed_another() -> None:
    settings = replace(interrupted_run.SETTINGS, checkpoint_seconds=1e9)
    one, two, three = (run(interrupted_run.banana, interrupted_run.PROPOSAL, settings, s).points for s in (5, 5, 6))
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(one, three)


def test_no_finite_start_is_said() -> None:
    with pytest.raises(CannotFinishError, match="no starting point"):
        run(lambda x: np.full(len(x), -np.inf), interrupted_run.PROPOSAL, interrupted_run.SETTINGS, 1)


def test_kill_nine_at_any_moment_changes_no_bit(tmp_path: Path) -> None:
    whole = run(interrupted_run.banana, interrupted_run.PROPOSAL, interrupted_run.SETTINGS, 5, identity="banana")
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
    resumed = run(
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
    run(interrupted_run.banana, interrupted_run.PROPOSAL, settings, 5, checkpoint=path, identity="one")
    fresh = run(interrupted_run.banana, interrupted_run.PROPOSAL, settings, 5, identity="two")
    other = run(interrupted_run.banana, interrupted_run.PROPOSAL, settings, 5, checkpoint=path, identity="two")
    assert other.evaluations == fresh.evaluations
    path.write_bytes(b"half a file")
    again = run(interrupted_run.banana, interrupted_run.PROPOSAL, settings, 5, checkpoint=path, identity="two")
    np.testing.assert_array_equal(again.points, fresh.points)

"""A fit that was interrupted after any simulation and is resumed ends as it would have ended, and soon."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_form import FormulaSimulator, calibration, parameter

from aero_bayes.checkpoint import Checkpoint, digest
from aero_bayes.errors import InputError
from aero_bayes.estimate import NoiseModel, Uniform
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.fit import fit_calibration
from aero_bayes.estimate.levenberg_marquardt import FitSettings
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.simulation.interface import Problem, Trajectories

pytestmark = pytest.mark.fast

T = np.linspace(0.0, 4.0, 80)
SETTINGS = FitSettings(pso=SwarmSettings(particles=12, iterations=20))


def waves(t: np.ndarray, v: np.ndarray) -> np.ndarray:
    return (v[0] * np.sin(v[1] * t) + v[2] * t)[:, None]


@pytest.fixture(scope="module")
def problem() -> Calibration:
    rng = np.random.default_rng(5)
    y = waves(T, np.array([1.0, 2.0, 0.3])) + 0.1 * rng.normal(size=(T.size, 1))
    bounds = {"a": (0.5, 0.0, 4.0), "w": (1.0, 0.2, 6.0), "b": (0.0, -2.0, 2.0)}
    items = [parameter(n, s, low, high, Uniform(low, high)) for n, (s, low, high) in bounds.items()]
    return calibration([(T, y)], ["y"], items, NoiseModel())


class Rationed(FormulaSimulator):
    """Ends with what Ctrl-C raises once the ration of simulations is eaten up."""

    left = 0

    def simulate(self, values: np.ndarray, *, active=None) -> Trajectories:
        self.eat()
        return super().simulate(values, active=active)

    def eat(self) -> None:
        Rationed.left -= 1
        if Rationed.left < 0:
            raise KeyboardInterrupt


def rationed(problem: Calibration, ration: int, kept: Checkpoint | None) -> Fit:
    def opened(asked: Problem) -> Rationed:
        return Rationed(asked, waves)

    Rationed.left = ration
    return fit_calibration(problem, opened, SETTINGS, np.random.default_rng(3), checkpoint=kept)


def told(fit: Fit) -> dict[str, object]:
    """All that a fit says of itself, but for how long it took."""
    return {key: value for key, value in fit.to_dict().items() if key != "seconds"}


def test_whenever_it_was_interrupted(problem, tmp_path, monkeypatch):
    monkeypatch.setattr("aero_bayes.checkpoint.MIN_WRITE_INTERVAL", 0.0)
    monkeypatch.setattr("aero_bayes.checkpoint.MIN_INTERVAL_RATIO", 0.0)
    whole = rationed(problem, 10_000, None)
    needed = 10_000 - Rationed.left
    path = tmp_path / "fit.npz"
    for share in (0.1, 0.3, 0.5):
        with pytest.raises(KeyboardInterrupt):
            rationed(problem, round(share * needed), Checkpoint(path))
    resumed = rationed(problem, 10_000, Checkpoint(path))
    assert digest(told(resumed)) == digest(told(whole))
    np.testing.assert_array_equal(resumed.values, whole.values)
    np.testing.assert_array_equal(resumed.laplace.covariance, whole.laplace.covariance)
    # once more, now that everything is known: what is left is one simulation a search, and what is no search
    again = rationed(problem, 10_000, Checkpoint(path))
    assert digest(told(again)) == digest(told(whole))
    assert 10_000 - Rationed.left < 0.3 * needed


def test_other_data_find_nothing_in_it(problem, tmp_path):
    path = tmp_path / "fit.npz"
    rationed(problem, 10_000, Checkpoint(path))
    (run,) = problem.data.experiments
    shifted = replace(run, measured=run.measured + 0.01 * np.cos(T)[:, None])
    other = replace(problem, data=problem.data.with_experiments((shifted,)))
    fresh = rationed(other, 10_000, None)
    needed = Rationed.left
    resumed = rationed(other, 10_000, Checkpoint(path))
    assert Rationed.left == needed
    assert digest(told(resumed)) == digest(told(fresh))


def test_a_file_of_another_run_is_refused_and_half_a_file_is_none(tmp_path):
    path = tmp_path / "checkpoint.npz"
    Checkpoint(path, "one").put("key", {"x": np.arange(3.0)}, now=True)
    np.testing.assert_array_equal(Checkpoint(path, "one").get("key")["x"], [0.0, 1.0, 2.0])
    with pytest.raises(InputError, match="other data, model or settings"):
        Checkpoint(path, "two")
    path.write_bytes(path.read_bytes()[:100])
    assert Checkpoint(path, "two").get("key") is None


def test_what_differs_differs_in_its_digest():
    different = [
        (1.0, 2.0), (1.0, 2.0 + 2**-51), ([1.0], 2.0), ("1.0", 2.0), (np.array([1.0, 2.0]),), (np.array([[1.0, 2.0]]),),
        ({"a": 1.0, "b": 2.0},), ({"a": 2.0, "b": 1.0},), (Uniform(1.0, 2.0),), (Uniform(2.0, 3.0),), (None, True),
    ]  # fmt: skip
    assert len({digest(*items) for items in different}) == len(different)
    assert digest({"a": np.float64(0.1), "b": (2,)}) == digest({"b": [2], "a": 0.1})

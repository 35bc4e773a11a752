"""The trial of the diagnosis: faults are what they say they are, and rates count what they should."""

from __future__ import annotations

import tomllib
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest

import aero_bayes
from simulated_rigs.trial import draw_rig_trial
from study.fault_trial import FAULTS, Rig, attempt, draw, shortened, summary, tasks, with_fault

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    trial = shortened(draw_rig_trial("pendulum", 3, 11001, "none"))
    section = tomllib.loads(trial.toml.read_text(encoding="utf-8"))
    folder = tmp_path_factory.mktemp("pendulum")
    model = aero_bayes.load_model(section["model"]["name"], sources=[trial.model], folder=folder)
    return Rig(trial, model, list(section["parameters"]))


def test_faults_of_the_data_change_only_what_they_say(pendulum: Rig) -> None:
    trial, rng = pendulum.trial, np.random.default_rng(3)
    right, found = trial.train.outputs["angle"], {}
    for fault in FAULTS:
        given = with_fault(trial, fault, rng)
        assert given is not None or fault == "swapped"  # it has one channel of each unit
        if given is not None:
            found[fault] = given
    changed = {f: found[f].recording.outputs["angle"] != right for f in ("impossible", "outliers", "stuck", "clipped")}
    assert set(found["impossible"].recording.outputs["angle"][changed["impossible"]]) == {-999.0}
    assert changed["impossible"].sum() == 3
    assert changed["outliers"].mean() == pytest.approx(0.03)
    assert np.unique(found["stuck"].recording.outputs["angle"][changed["stuck"]]).size == 1
    assert 0.02 < changed["clipped"].mean() < 0.11
    assert np.max(np.diff(found["gap"].recording.time)) > 20.0 * trial.train.interval
    turns = (found["wrapped"].recording.outputs["angle"] - right) / (2.0 * np.pi)
    assert np.allclose(turns, np.round(turns))
    assert np.ptp(np.round(turns)) >= 1.0
    steps = np.unique(np.diff(np.unique(found["rounded"].recording.outputs["angle"])).round(12))
    assert np.allclose(steps / steps[0], np.round(steps / steps[0]))
    assert [n for n in ("ahead", "clock") if np.array_equal(found[n].recording.outputs["angle"], right)] == []
    turned = found["sign"].recording
    assert sum(np.array_equal(turned.inputs[n], -v) for n, v in trial.train.inputs.items() if v.any()) + np.array_equal(
        turned.outputs["angle"], -right
    ) == 1  # fmt: skip
    assert 4 < np.median(np.diff(np.flatnonzero(np.diff(found["held"].recording.outputs["angle"])))) < 26
    shift = found["zero_shifted"].recording.outputs["angle"] - right
    assert 0.1 <= abs(shift[0]) / np.ptp(trial.noise_free["train"].outputs["angle"]) <= 0.5
    assert shift == pytest.approx(shift[0])
    averaged, scaled = found["averaged"].recording, found["scaled"].recording
    every = round(averaged.interval / trial.train.interval)
    assert averaged.inputs["tau"][7] == pytest.approx(np.mean(trial.train.inputs["tau"][7 * every : 8 * every]))
    assert averaged.time[7] == trial.train.time[8 * every]
    driven = trial.train.inputs["tau"]
    ratios = np.ptp(scaled.outputs["angle"]) / np.ptp(right), np.ptp(scaled.inputs["tau"]) / np.ptp(driven)
    assert sorted(np.isclose(ratios, 1.0)) == [False, True]
    assert scaled.outputs["angle"] / ratios[0] == pytest.approx(right)
    assert found["prior"].prior is not None
    assert not 0.85 < found["prior"].prior[1].median / trial.parameters[found["prior"].prior[0]] < 1.15
    assert found["unlike"].second is not None
    assert found["solver"].recording is trial.train
    assert found["solver"].tolerance is not None


def test_a_fault_that_makes_no_sense_is_not_given() -> None:
    heat = draw_rig_trial("heat", 1, 11001, "none")
    rng = np.random.default_rng(1)
    # Temperatures in K are no angles, and all of about the same size.
    assert with_fault(heat, "wrapped", rng) is None
    assert with_fault(heat, "relative", rng) is None


def test_a_trial_is_repeatable_and_judged(tmp_path: Path) -> None:
    task = (11001, "impossible", 0)
    (rig, given), (_, again) = draw(task, tmp_path / "a"), draw(task, tmp_path / "b")
    assert np.array_equal(given.recording.outputs[given.output], again.recording.outputs[given.output])
    row = attempt(task)
    assert "error" not in row
    assert row["causes"][0] == "data"
    assert row["findings"] == ["sentinel"]
    assert row["rig"] == rig.trial.kind.name


def test_rates_count_what_was_asked() -> None:
    rows = [
        {"key": "1/stuck/0", "causes": ["data", "model"], "what": ["a", "b"]},
        {"key": "1/stuck/1", "causes": ["model"], "what": ["b"]},
        {"key": "1/solver/0", "causes": ["data", "solver"], "what": ["a", "c"]},
        {"key": "1/relative/0", "causes": ["noise"], "what": ["d"]},
        {"key": "1/clear/0", "causes": ["noise"], "what": ["d"], "correlated": True},
        {"key": "1/clear/1", "causes": ["noise"], "what": ["d"], "correlated": False},
    ]
    found = summary(rows)
    assert [(one["trials"], one["share"]) for one in found["rates"]] == [(4, 0.5), (4, 0.25), (2, 0.5)]
    assert {one["what"]: one["trials"] for one in found["kinds"]}["stuck"] == 2
    every = list(tasks(Namespace(seed=2)).values())
    assert {fault for _, fault, _ in every[: 2 * len(FAULTS)]} == {*FAULTS, "clear"}

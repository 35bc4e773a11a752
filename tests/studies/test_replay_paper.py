"""The whole replay: rows, ranks, curves and what goes into result.json."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from aero_closed_form import linear_run

from aero_bayes.report.schema_run import RunJson
from aero_bayes.simulation.interface import Outcome
from paper_replay import paper_recording, replay_paper, write_run
from paper_replay.paper import JOINT, PAPER, RERUN, SCALED, run_result
from paper_replay.published import TABLE_1, TABLE_PARAMETERS

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def replay(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper")
    return replay_paper(seed=4, workers=1, out=folder)


def test_every_model_of_the_paper_is_there(replay):
    for published in TABLE_1:
        row = replay.row(published.label, PAPER)
        assert row.paper_fitness == published.fitness
        assert row.fitness is not None
    for label in ("PSO Model 1", "PSO + data sheet", "fmincon"):
        assert {row.variant for row in replay.rows if row.model == label} == {PAPER, RERUN, SCALED}
    labels = [row.label for row in replay.rows]
    assert len(set(labels)) == len(labels)


def test_fitness_is_eq6_of_the_pitch(replay):
    """Every row under the linear law without nuisances, by an independent solution and a plain sum."""
    checked = 0
    for row in replay.rows:
        if set(row.parameters) != set(TABLE_PARAMETERS) or row.variant == JOINT:
            continue
        pitch = linear_run(row.parameters, replay.series["replay/time"])[:, 2]
        assert row.fitness == pytest.approx(
            sum((y - x) ** 2 for y, x in zip(replay.series["replay/measured"], pitch, strict=True)), rel=2e-4
        )
        assert row.rms["theta"] == pytest.approx(math.sqrt(row.fitness / pitch.size), rel=1e-9)
        checked += 1
    assert checked == 10


def test_the_joint_fit_ranks_first(replay):
    best = min(row.fitness for row in replay.rows if row.variant == JOINT)
    assert all(best <= row.fitness for row in replay.rows)
    for label in ("PSO Model 1", "PSO + data sheet", "fmincon"):
        assert replay.row(label, SCALED).fitness < replay.row(label, PAPER).fitness
    ends = replay.ends
    assert ends["swarm, scaled"][1].cost < 1e-2 * ends["swarm"][1].cost
    assert all(end.cost <= end.start_cost for end in ends["search, scaled"])
    assert ends["search, scaled"][0].cost <= ends["search"][0].cost


def test_data_choose_the_law_they_were_made_with(replay):
    linear, quadratic = (replay.row(law, JOINT) for law in ("Linear law", "Quadratic law"))
    assert quadratic.rms["i_m"] < linear.rms["i_m"]
    assert quadratic.parameters["k_d"] == pytest.approx(2.4e-8 * 1.08, rel=0.02)
    assert quadratic.parameters["R_a"] == pytest.approx(8.4 * 1.07, rel=0.02)


def test_curves_of_figure_6(replay):
    series = replay.series
    assert {"replay/time", "replay/measured", "replay/Joint fit"} <= set(series)
    assert all(values.shape == (2001,) and np.isfinite(values).all() for values in series.values())
    assert {f"replay/{one.label}" for one in TABLE_1} <= set(series)
    np.testing.assert_allclose(
        np.sum((series["replay/fmincon"] - series["replay/measured"]) ** 2), replay.row("fmincon", PAPER).fitness
    )


def test_goes_into_result_json(replay):
    entry = json.loads(json.dumps(run_result(replay), allow_nan=False))
    assert {"model", "parameters", "fitness", "paper_fitness", "note", "rms"} <= set(entry["replay"]["rows"][0])
    assert entry["simulated"] is True
    assert entry["failures"]["completed"] > 1000
    assert set(entry["failures"]) == {outcome.key for outcome in Outcome}


def test_table_and_figure_show_every_row_and_model(replay, tmp_path):
    text = write_run(replay, tmp_path).read_text("utf-8")
    assert all(f"| {row.label} |" in text for row in replay.rows)
    RunJson.model_validate_json((tmp_path / "result.json").read_text("utf-8"))
    drawing = (tmp_path / "figure_6.svg").read_text("utf-8")
    assert all(one.label in drawing for one in TABLE_1)


def test_same_seed_same_numbers(replay, tmp_path):
    """Other number of workers, same rows, notes and curves."""
    again = replay_paper(seed=4, workers=1, out=tmp_path)
    assert (replay.rows, replay.failures) == (again.rows, again.failures)
    for key, values in replay.series.items():
        np.testing.assert_array_equal(values, again.series[key])


def test_paper_recording() -> None:
    recording = paper_recording(0)
    assert recording.rows == 2001
    assert recording.duration == 40.0
    np.testing.assert_array_equal(recording.inputs["V_m"], np.where(recording.time < 20.0, 24.0, 0.0))
    assert paper_recording(0).sha256 == recording.sha256 != paper_recording(1).sha256
    assert 0.4 < np.nanmax(recording.outputs["theta"]) < 1.5

"""The many-rig trial's runner and table, with programs whose answers are known beforehand."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from aero_bayes.data import ColumnSpec, Layout, read_recording
from rig_trial import Answer, RigTrialTask, answer_of, rig_trial_tasks, run_rig_trial
from rig_trial_table import calibration, right_law, right_or_similar, right_pair, right_place, summarise
from simulated_rigs import LawPlace, LawTruth, draw_rig_trial
from simulated_rigs.nodes import joined_connectors, same_places
from trial_runs import run_trials, write_summary

pytestmark = pytest.mark.long


def says(*ids: str, folder: Path, equivalent: tuple[tuple[str, ...], ...] = ()) -> Answer:
    """A program that always answers the same, having looked at what it was given."""
    assert sorted(path.name for path in folder.iterdir()) == ["Rig.mo", "rig.toml", "test.csv", "train.csv"]
    layout = Layout((ColumnSpec("P", "W"),), (ColumnSpec("T_heater", "K"), ColumnSpec("T_plate", "K")))
    test = read_recording(folder / "test.csv", layout=layout)
    rms = {name: float(np.std(values)) for name, values in test.outputs.items()}
    found = tuple({"id": one, "port": one.partition("@")[2], "kind": "catalogue", "wins": 0.9} for one in ids)
    return Answer("extended" if ids else "adequate", found, equivalent, {"nothing": 1.0}, rms)


def test_a_program_that_knows_is_right_and_one_that_guesses_is_not(tmp_path: Path) -> None:
    task = RigTrialTask(11001, "heat", "law", 1)
    trial = draw_rig_trial("heat", 1)
    (law,) = trial.truth.laws
    ids = same_places(trial, law)
    rows = {}
    for name, answer, same in (
        ("right", ids[0], ()),
        ("equivalent", "delay@elsewhere", (("delay@elsewhere", ids[-1]),)),
        ("wrong", "delay@elsewhere", ()),
    ):
        program = lambda folder, answer=answer, same=same: says(answer, folder=folder, equivalent=same)  # noqa: E731
        (rows[name],) = run_trials([task], partial(run_rig_trial, program=program), tmp_path / name / "rows.sqlite")
        assert "error" not in rows[name]
    assert [right_law(row) for row in rows.values()] == [True, True, False]
    assert [right_place(row) for row in rows.values()] == [True, True, False]
    noise = trial.test.outputs["T_plate"] - trial.noise_free["test"].outputs["T_plate"]
    expected = np.std(trial.test.outputs["T_plate"]) / np.sqrt(np.mean(noise**2))
    assert rows["right"]["after_over_noise"]["T_plate"] == pytest.approx(expected)
    summary, text = summarise(list(rows.values()), 17001, 11001)
    assert summary["counts"]["d>=20"] + summary["counts"]["8<=d<20"] == (3 if law.d >= 8.0 else 0)
    assert "right law" in text


def test_finished_trials_are_kept_and_failures_are_rows(tmp_path: Path) -> None:
    tasks = rig_trial_tasks(11001, {"none": 2}, ("heat",))

    def fails(folder: Path) -> Answer:
        raise RuntimeError("no such thing")

    first = run_trials(tasks[:1], partial(run_rig_trial, program=_nothing), tmp_path / "rows.sqlite")
    both = run_trials(tasks, partial(run_rig_trial, program=fails), tmp_path / "rows.sqlite")
    assert both[0] == first[0]
    assert both[1]["error"] == "RuntimeError: no such thing"
    summary, text = summarise(both, 17001, 11001)
    assert summary["counts"]["failed"] == 1
    assert summary["false_name"] == 0.0
    assert summary["nothing_missing"] == 1.0
    assert "no such thing" in text
    write_summary(summary, tmp_path / "rig_trial.json")
    assert (tmp_path / "rig_trial.json").stat().st_size > 100


def _nothing(folder: Path) -> Answer:
    return says(folder=folder)


def row(what: str, truth: str, found: tuple[str, ...], wins: float = 0.5, **more) -> dict:
    laws = [{"law": one.partition("@")[0]} for one in truth.split()]
    return {
        "key": "k", "rig": "cart", "noise": "white", "what": what, "truth": laws, "d": [30.0] * len(laws),
        "ids": [[one] for one in truth.split()], "outcome": "extended" if found else "adequate", "equivalent": [],
        "found": [{"id": one, "port": one.partition("@")[2], "kind": "catalogue"} for one in found], "seconds": 1.0,
        "wins": dict.fromkeys(found, wins), "after_over_noise": {"y": 1.0}, **more,
    }  # fmt: skip


def test_rates_and_wins_are_counted() -> None:
    friction = row("law", "stribeck_friction@v", ("coulomb_friction@v",))
    assert not right_law(friction)
    assert right_or_similar(friction)
    assert right_place(friction)
    assert right_pair(row("pair", "offset@u lag@y", ("lag@y", "offset@u")))
    assert not right_pair(row("pair", "offset@u lag@y", ("lag@y", "offset@u", "gain@u")))
    rows = [row("law", "offset@u", ("offset@u",), 0.97) for _ in range(9)] + [row("law", "lag@y", ("offset@u",), 0.93)]
    rows += [row("none", "", ()), row("none", "", ("gain@u",), 0.92)]
    found = calibration(rows)
    assert found["given_90"] == {"answers": 11, "right": pytest.approx(9 / 11)}
    bins = {item["wins"][0]: item for item in found["bins"]}
    assert (bins[0.95]["answers"], bins[0.95]["right"]) == (9, 1.0)
    assert (bins[0.9]["answers"], bins[0.9]["right"]) == (2, 0.0)
    summary, _ = summarise(rows, 17001, 11001)
    assert summary["right_law"]["d>=20"] == pytest.approx(0.9)
    assert summary["false_name"] == 0.5
    shared = row("law", "offset@v", ("offset@u",), 0.95, equivalent=[["offset@u", "offset@v"]])
    assert calibration([shared])["given_90"] == {"answers": 1, "right": 1.0}


def test_places_go_by_all_their_names() -> None:
    text = "connect(a.p, b.p);\n connect( c.p , b.p ); connect(d.p, e.n);"
    assert sorted(map(sorted, joined_connectors(text))) == [["a.p", "b.p", "c.p"], ["d.p", "e.n"]]
    motor, circuit = (draw_rig_trial(name, 0, what="none") for name in ("motor", "circuit"))
    assert same_places(motor, LawTruth("offset", LawPlace("balance", "w"), {})) == ["offset@w"]
    assert same_places(motor, LawTruth("lag", LawPlace("output", "speed"), {})) == ["lag@speed", "lag@output_speed"]
    drop = {
        id_.partition("@")[2] for id_ in same_places(circuit, LawTruth("heating", LawPlace("balance", "coil.i"), {}))
    }
    assert drop == {"coil.i", "coil.p", "coil.n", "source.p"}
    cart = draw_rig_trial("cart", 0, what="none")
    names = same_places(cart, LawTruth("coulomb_friction", LawPlace("balance", "mass.v"), {}))
    assert names[0] == "coulomb_friction@mass.v"
    assert {"coulomb_friction@mass.flange", "coulomb_friction@drive.flange"} <= set(names)


def test_result_json_is_read_by_its_contract() -> None:
    result = {
        "loop": {
            "outcome": "extended",
            "effects": [{"id": "lag@u", "port": "u", "kind": "catalogue", "wins": 0.8, "parameters": {}}],
            "equivalent": [["lag@u", "delay@u"]],
            "after": {"train": {"y": 0.2}, "test": {"y": 0.1}},
        }
    }
    answer = answer_of(result)
    assert answer.found[0]["id"] == "lag@u"
    assert answer.equivalent == (("lag@u", "delay@u"),)
    assert answer.wins == {"lag@u": 0.8}
    assert answer.unseen == {"y": 0.1}

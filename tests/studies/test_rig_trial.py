"""The many-rig trial and the runner of studies, with programs whose answers are known beforehand."""

from __future__ import annotations

import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aero_bayes.data import ColumnSpec, Layout, read_recording
from simulated_rigs.trial import draw_rig_trial
from simulated_rigs.truth import LawPlace, LawTruth
from study.rig_trial import STUDY, attempt, joined_connectors, right_effect, right_pair, same_places, summary, table
from study.study import Row, keyed, run

pytestmark = pytest.mark.long


def answer(*ids: str, equivalent: tuple[tuple[str, ...], ...] = (), **more: object) -> Row:
    effects = [{"id": one, "port": one.partition("@")[2], "kind": "catalogue"} for one in ids]
    outcome = "extended" if ids else "adequate"
    return {"outcome": outcome, "effects": effects, "equivalent": [list(same) for same in equivalent], **more}


def test_a_program_that_knows_is_right_and_one_that_guesses_is_not() -> None:
    trial = draw_rig_trial("heat", 1)
    (law,) = trial.laws
    ids = same_places(trial, law)

    def row(name: str, *equivalent: tuple[str, ...]) -> Row:
        def program(folder: Path) -> Row:
            assert sorted(path.name for path in folder.iterdir()) == ["Rig.mo", "rig.toml", "test.csv", "train.csv"]
            layout = Layout((ColumnSpec("P", "W"),), (ColumnSpec("T_heater", "K"), ColumnSpec("T_plate", "K")))
            test = read_recording(folder / "test.csv", layout=layout)
            rms = {output: float(np.std(values)) for output, values in test.outputs.items()}
            return answer(name, equivalent=equivalent, after={"test": rms})

        return attempt((11001, "heat", "law", 1), program)

    rows = [row(ids[0]), row("delay@elsewhere", ("delay@elsewhere", ids[-1])), row("delay@elsewhere")]
    assert [right_effect(one) for one in rows] == [True, True, False]
    noise = trial.test.outputs["T_plate"] - trial.noise_free["test"].outputs["T_plate"]
    expected = np.std(trial.test.outputs["T_plate"]) / np.sqrt(np.mean(noise**2))
    assert rows[0]["after_over_noise"]["T_plate"] == pytest.approx(expected)


def judged(what: str, truth: str, found: tuple[str, ...], **more: object) -> Row:
    row = {"key": "k", "rig": "cart", "what": what, "d": [30.0] * len(truth.split()), "seconds": 1.0}
    return {**answer(*found), **row, "ids": [[one] for one in truth.split()], "after_over_noise": {"y": 1.0}, **more}


def test_rates_are_counted_and_shown() -> None:
    assert right_pair(judged("pair", "offset@u lag@y", ("lag@y", "offset@u")))
    assert not right_pair(judged("pair", "offset@u lag@y", ("lag@y", "offset@u", "gain@u")))
    rows = [judged("law", "offset@u", ("offset@u",)) for _ in range(9)] + [judged("law", "lag@y", ("offset@u",))]
    rows += [judged("none", "", ()), judged("none", "", ("gain@u",)), {"key": "f", "error": "stopped"}]
    found = summary(rows)
    assert [one["share"] for one in found["rates"]] == [pytest.approx(0.9), None, None, 0.5, None]
    assert (found["trials"], found["failed"]) == (13, 1)
    assert table(found)[1][0][1:] == ("90 %", "90 % (± 12)", 10)


def test_a_law_that_is_not_told_apart_is_right_in_its_class_and_no_false_discovery() -> None:
    one = judged("law", "offset@u", ("gain@u",))
    one["effects"][0] |= {"claim": "one of", "alternatives": [{"id": "offset@u", "port": "u", "error_ratio": 1.02}]}
    assert right_effect(one)
    assert summary([{**one, "what": "outside", "ids": []}])["rates"][4]["share"] == 1.0


OPTIONS = {"minutes": None, "workers": 0, "only": None, "seed": 2}


def test_finished_rows_are_kept_and_failures_are_rows(tmp_path: Path) -> None:
    calls = []

    def fails(task: tuple[object, ...]) -> Row:
        calls.append(task)
        raise RuntimeError("no such thing")

    tasks = [(11001, "heat", "none", k) for k in range(3)]
    study = replace(STUDY, tasks=lambda options: keyed(tasks), attempt=lambda task: judged("none", "", ()))

    def counts(attempt=study.attempt, **options: object) -> tuple[int, int, int]:
        found = run(replace(study, attempt=attempt), Namespace(out=tmp_path, **OPTIONS | options))
        return found["trials"], found["left"], found["failed"]

    assert counts(only=["*/0"]) == (1, 2, 0)
    assert counts(fails, minutes=0.0) == (1, 2, 0)
    assert counts(fails) == (3, 0, 2)
    assert calls == tasks[1:]
    assert json.loads((tmp_path / "rig_trial.json").read_text())["left"] == 0


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

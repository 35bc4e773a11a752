"""The cases of real rigs, and how answers are judged."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from facts import facts

import real_rigs
from aero_bayes.config import load_config
from real_rigs_table import Expectation, judge_answer, judge_names, table

pytestmark = pytest.mark.long


def test_every_case_has_its_model() -> None:
    for case in real_rigs.cases().values():
        config = load_config(case.folder / "rig.toml")
        assert config.model.name
        assert all(source.is_file() for source in config.model.sources)


def row(*named: str, equivalent: tuple[tuple[str, ...], ...] = ()) -> dict[str, object]:
    return {
        "key": "rig", "code": "0", "seconds": 1.0, "outcome": "extended", "named": list(named),
        "equivalent": [list(ids) for ids in equivalent], "before": {"train": {"y": 0.3}, "test": {"y": 0.4}},
        "after": {"train": {"y": 0.1}, "test": {"y": 0.2}},
    }  # fmt: skip


def test_names_are_right_missed_false_or_other() -> None:
    known = Expectation(
        expected=(("overflow@h1",), ("lag@u", "delay@u")), fine=("offset@*",), false=("gain@*",),
    )  # fmt: skip
    answer = row("overflow@h1", "offset@h2", "gain@u", "curve@y")
    one = judge_answer(answer, known)
    assert (one["right"], one["missed"]) == (["overflow@h1"], ["lag@u or delay@u"])
    assert (one["false"], one["other"], one["verdict"]) == (["gain@u"], ["curve@y"], "false")
    same = judge_answer(row("gain@u", equivalent=(("gain@u", "delay@u"),)), known)
    assert (same["right"], same["false"]) == (["gain@u"], [])
    alone = judge_answer(row("backlash@w", "offset@w"), Expectation(expected=(("backlash@w",),), false=("*",)))
    assert (alone["right"], alone["false"]) == (["backlash@w"], ["offset@w"])
    failed = judge_answer({"key": "other", "code": "0", "seconds": 2.0, "error": "stopped"}, known)
    text = table([one, failed])
    assert re.search(facts("1 of 2", "2 false"), text)
    assert re.search(facts("1 false", "1 failed", "stopped"), text)


@pytest.mark.parametrize(
    ("named", "verdict"),
    [
        (["square_law@u"], "right"),
        (["square_law@u", "lag@u"], "right"),
        (["curve@u"], "place_right"),
        (["lag@u"], "missed"),
        ([], "missed"),
        (["square_law@u", "dead_zone@u"], "false"),
        (["curve@u", "offset@y"], "false"),
    ],
)
def test_the_verdict_tells_a_name_from_a_place(named: list[str], verdict: str) -> None:
    known = Expectation(expected=(("square_law@u",),), place=("curve@u",), fine=("lag@u",), false=("dead_zone@u",))
    assert judge_names(named, [], known)["verdict"] == verdict


def test_silence_is_right_where_no_law_is_missing_or_readings_are_too_few() -> None:
    few = Expectation(expected=(("square_loss@N",),), silence=True)
    none = Expectation(place=("curve@i",), fine=("dead_zone@v",))
    assert [judge_names([], [], known)["verdict"] for known in (few, none)] == ["silent", "silent"]
    # A class of which none is named, but which holds the truth.
    untold = [["lag@u", "square_loss@N"]]
    assert judge_names([], untold, Expectation(expected=few.expected))["verdict"] == "place_right"
    assert judge_names([], [["lag@u", "gain@u"]], Expectation(expected=few.expected))["verdict"] == "missed"
    assert judge_names(["curve@i"], [], none)["verdict"] == "place_right"
    assert judge_names(["dead_zone@v"], [], none)["verdict"] == "right"
    assert judge_names(["lag@i"], [], none)["verdict"] == "false"


def test_a_case_whose_recordings_are_not_there_is_left_out(tmp_path: Path) -> None:
    case = real_rigs.RigCase("rig", ("a.csv",), ("b.csv",))
    (tmp_path / "a.csv").touch()
    assert case.find([tmp_path]) is None
    (tmp_path / "b.csv").touch()
    assert case.find([tmp_path / "none", tmp_path]) == {
        "train": [(tmp_path / "a.csv").resolve()], "test": [(tmp_path / "b.csv").resolve()]
    }  # fmt: skip

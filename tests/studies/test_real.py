"""The cases of real rigs, terms deleted from complete models of them, and how answers are judged."""

from __future__ import annotations

import tomllib
from argparse import Namespace
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from aero_bayes.config import load_config
from aero_bayes.laws.candidates import find_candidates, ports_with_laws
from aero_bayes.laws.law import shipped_laws
from aero_bayes.modelica.rumoca_front import load_flat
from study import real
from study.real import Expectation, RigCase, case_summary, case_table, judged
from study.study import Row

pytestmark = pytest.mark.long


def test_every_case_has_its_model() -> None:
    for case in real.cases().values():
        config = load_config(case.folder / "rig.toml")
        assert config.model.name
        assert all(source.is_file() for source in config.model.sources)


def row(*named: str, equivalent: tuple[tuple[str, ...], ...] = (), key: str = "servo", **claim: object) -> Row:
    effects = [{"id": one, "port": one.partition("@")[2], "kind": "catalogue", **claim} for one in named]
    return {
        "key": key, "seconds": 1.0, "outcome": "extended", "effects": effects,
        "equivalent": [list(ids) for ids in equivalent], "before": {"train": {"y": 0.3}, "test": {"y": 0.4}},
        "after": {"train": {"y": 0.1}, "test": {"y": 0.2}},
    }  # fmt: skip


def test_names_are_right_missed_or_false() -> None:
    known = Expectation(expected=(("overflow@h1",), ("lag@u", "delay@u")), fine=("offset@*",))
    one = judged(row("overflow@h1", "offset@h2", "gain@u", "curve@y"), known)
    assert (one["missed"], one["false"], one["verdict"]) == (["lag@u or delay@u"], ["gain@u", "curve@y"], "false")
    same = judged(row("gain@u", equivalent=(("gain@u", "delay@u"),)), known)
    assert same["false"] == []
    alone = judged(row("backlash@w", "offset@w"), Expectation(expected=(("backlash@w",),)))
    assert alone["false"] == ["offset@w"]
    assert judged({"key": "other", "error": "stopped"}, known)["verdict"] == "failed"


SQUARE = Expectation(expected=(("square_law@u",),), place=("curve@u",), fine=("lag@u",))
FRICTION = Expectation(expected=(("coulomb_friction@w",),))
#: A law is missing, but its readings are too few to name it; or none is missing.
FEW, LOUD = (Expectation(expected=(("square_loss@N",),), silence=silence) for silence in (True, False))
NONE = Expectation(place=("curve@i",), fine=("dead_zone@v",))
OTHERS = [{"id": "coulomb_friction@w", "port": "w", "error_ratio": 1.01}]


@pytest.mark.parametrize(("found", "known", "verdict"), [
    (row("square_law@u"), SQUARE, "right"),
    (row("square_law@u", "lag@u"), SQUARE, "right"),
    (row("curve@u"), SQUARE, "place_right"),
    (row("lag@u"), SQUARE, "missed"),
    (row(), SQUARE, "missed"),
    (row("square_law@u", "dead_zone@u"), SQUARE, "false"),
    (row("curve@u", "offset@y"), SQUARE, "false"),
    # a claim of a place, or of one of several laws, is no claim of a law
    (row("viscous_friction@w", claim="place"), FRICTION, "place_right"),
    (row("viscous_friction@x", claim="place"), FRICTION, "false"),
    (row("viscous_friction@w", claim="law"), FRICTION, "false law"),
    (row("offset@w", claim="one of", alternatives=OTHERS), FRICTION, "right"),
    (row(), FEW, "silent"),
    (row(), NONE, "silent"),
    # a class of which none is named, but which holds the truth
    (row(equivalent=(("lag@u", "square_loss@N"),)), LOUD, "place_right"),
    (row(equivalent=(("lag@u", "gain@u"),)), LOUD, "missed"),
    (row("curve@i"), NONE, "place_right"),
    (row("dead_zone@v"), NONE, "right"),
    (row("lag@i"), NONE, "false"),
])  # fmt: skip
def test_the_verdict_tells_a_name_from_a_place_and_from_silence(found: Row, known: Expectation, verdict: str) -> None:
    said = judged(found, known)
    assert said["verdict"] == verdict.removesuffix(" law")
    if known is FRICTION:
        assert said["false_law"] == (verdict == "false law")


def test_the_table_shows_each_case() -> None:
    found = case_summary([row("rate_limit@command"), {"key": "coil", "error": "x"}])
    assert (found["cases"], found["verdicts"]["right"], found["verdicts"]["failed"]) == (2, 1, 1)
    assert case_table(found)[1][0] == ("servo", "`rate_limit@command`", "right", "0.4 → 0.2")


def test_a_case_whose_recordings_are_not_all_there_is_left_out(tmp_path: Path) -> None:
    case = RigCase("rig", ("a.csv",), ("b.csv",))
    (tmp_path / "a.csv").touch()
    assert case.find([tmp_path]) == {}
    (tmp_path / "b.csv").touch()
    found = {name: (tmp_path / name).resolve() for name in ("a.csv", "b.csv")}
    assert case.find([tmp_path / "none", tmp_path]) == found


MODELS = real.complete_models()
TERMS = [(name, key) for name, model in MODELS.items() for key in model.terms]


def candidates(text: str, folder: Path) -> list[str]:
    path = folder / "Rig.mo"
    path.write_text(text, encoding="utf-8")
    return [c.id for c in find_candidates(ports_with_laws(load_flat("Rig", [path]), shipped_laws()), shipped_laws())]


@pytest.mark.parametrize(("rig", "key"), TERMS)
def test_a_law_of_the_library_can_take_the_place_of_a_deleted_term(rig: str, key: str, tmp_path: Path) -> None:
    model, term = MODELS[rig], MODELS[rig].terms[key]
    found = candidates(model.source(term), tmp_path)
    named = [id_ for id_ in found if any(fnmatchcase(id_, pattern) for pattern in term.expected)]
    assert named
    free = tomllib.loads(model.configuration(term))["parameters"]
    assert set(free) == set(model.free) - set(term.without)


def test_there_are_forty_tasks_and_a_complete_model_of_every_rig() -> None:
    rigs = {case.model or name for name, case in real.cases().items()}
    none = ("aero", "drives", "franka", "propeller", "well")  # of which no complete model is known
    assert {name for name in rigs if not name.startswith(none)} <= set(MODELS)
    assert len(TERMS) >= 40


def term_row(key: str, named: list[str], after: float = 2.0) -> Row:
    same = (("coulomb_friction@w", "offset@w"),)
    return row(*named, equivalent=same, key=key) | {"before": {"train": {"w": 1.0}, "test": {"w": after}}}


def test_the_summary_counts_what_is_right_by_class_and_what_a_term_matters() -> None:
    rows = [
        term_row("motor", [], 1.0),
        term_row("drives", ["lag@u"], 1.0),
        term_row("motor-friction", ["offset@w"]),
        term_row("motor-viscous", ["curve@w"], 1.1),
        term_row("drives-sign", ["unsigned@y", "overflow@m"]),
        term_row("drives-damping", []),
    ]
    found = real.term_summary(rows)
    assert [one["trials"] for one in found["rates"]] == [3, 3, 4, 2]
    assert [one["share"] for one in found["rates"]] == pytest.approx([1 / 3, 1 / 3, 0.25, 0.5])
    failed = real.term_summary([{"key": "motor-friction", "seconds": 1.0, "error": "stopped"}])
    assert [one["share"] for one in failed["rates"]] == [None, None, 0.0, None]


def test_tasks_are_complete_models_and_those_without_a_term(tmp_path: Path) -> None:
    case = MODELS["motor"].case
    for file in (*case.train, *case.test):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).touch()
    options = Namespace(recordings=[tmp_path], study="real_trial", out=tmp_path, seed=1, loop_minutes=None)
    tasks = real.term_tasks(options)
    assert set(tasks) == {"motor", *(f"motor-{key}" for key in MODELS["motor"].terms)}
    assert "F_c" in tasks["motor"].files["rig.toml"]
    assert "F_c" not in tasks["motor-friction"].files["rig.toml"]


def test_an_edit_that_does_not_stand_in_the_model_is_refused() -> None:
    gone = real.Term((("no such text", ""),), ("offset@w",))
    with pytest.raises(ValueError, match="0 times"):
        MODELS["motor"].source(gone)
    kept = real.Term((), ("offset@w",), ("B",))
    with pytest.raises(ValueError, match="B is used"):
        MODELS["motor"].source(kept)

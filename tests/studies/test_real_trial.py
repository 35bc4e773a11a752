"""Terms deleted from complete models of real rigs: the tasks are what they say, and rates are counted right."""

from __future__ import annotations

import tomllib
from argparse import Namespace
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.structure.candidates import find_candidates, ports_with_laws
from aero_bayes.structure.law import shipped_laws
from study import real_trial

pytestmark = pytest.mark.long

MODELS = real_trial.complete_models()
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
    rigs = {case.model or name for name, case in real_trial.cases().items()}
    assert {name for name in rigs if not name.startswith(("aero", "drives"))} <= set(MODELS)
    assert len(TERMS) >= 40


def row(key: str, named: list[str], after: float = 2.0) -> dict[str, object]:
    return {
        "key": key, "seconds": 3.0, "equivalent": [["coulomb_friction@w", "offset@w"]],
        "effects": [{"id": name, "port": name.partition("@")[2], "kind": "catalogue"} for name in named],
        "before": {"train": {"w": 1.0}, "test": {"w": after}},
    }  # fmt: skip


def test_the_summary_counts_what_is_right_by_class_and_what_a_term_matters() -> None:
    rows = [
        row("motor", [], 1.0),
        row("drives", ["lag@u"], 1.0),
        row("motor-friction", ["offset@w"]),
        row("motor-viscous", ["curve@w"], 1.1),
        row("drives-sign", ["unsigned@y", "overflow@m"]),
        row("drives-damping", []),
    ]
    found = real_trial.summary(rows)
    assert set(found) == {"deleted", "deleted_material", "complete", "seconds_median", "rows"}
    rates = dict.fromkeys(("right", "place_right", "false", "missed", "false_law"), 0.25)
    assert found["deleted"] == {"tasks": 4, **rates}
    assert found["complete"] == {"tasks": 2, "named": 0.5}
    assert found["deleted_material"]["tasks"] == 3
    assert found["seconds_median"] == 3.0
    assert len(found["rows"]) == 6
    assert "50 % got the name of a law" in real_trial.table(found)[-1]
    failed = real_trial.summary([{"key": "motor-friction", "seconds": 1.0, "error": "stopped"}])
    assert failed["deleted"]["missed"] == 1.0


def test_tasks_are_complete_models_and_those_without_a_term(tmp_path: Path) -> None:
    case = MODELS["motor"].case
    for file in (*case.train, *case.test):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).touch()
    options = Namespace(recordings=[tmp_path], out=tmp_path, seed=1, loop_minutes=None)
    tasks = {task.key: task for task in real_trial.tasks(options)}
    assert set(tasks) == {"motor", *(f"motor-{key}" for key in MODELS["motor"].terms)}
    assert "F_c" in tasks["motor"].files["rig.toml"]
    assert "F_c" not in tasks["motor-friction"].files["rig.toml"]


def test_an_edit_that_does_not_stand_in_the_model_is_refused() -> None:
    gone = real_trial.Term((("no such text", ""),), ("offset@w",))
    with pytest.raises(ValueError, match="0 times"):
        MODELS["motor"].source(gone)
    kept = real_trial.Term((), ("offset@w",), ("B",))
    with pytest.raises(ValueError, match="B is used"):
        MODELS["motor"].source(kept)

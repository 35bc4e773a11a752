"""Terms deleted from complete models of real rigs: the tasks are what they say, and rates are counted right."""

from __future__ import annotations

import json
import sys
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

import real_trial
from aero_bayes.export import load_flat
from aero_bayes.laws import find_candidates, ports_with_laws, shipped_laws

pytestmark = pytest.mark.long

MODELS = real_trial.complete_models()
TASKS = real_trial.tasks(MODELS)


def candidates(text: str, folder: Path) -> list[str]:
    path = folder / "Rig.mo"
    path.write_text(text, encoding="utf-8")
    return [c.id for c in find_candidates(ports_with_laws(load_flat("Rig", [path]), shipped_laws()), shipped_laws())]


@pytest.mark.parametrize("key", [key for key, (_, term) in TASKS.items() if term])
def test_a_law_of_the_library_can_take_the_place_of_a_deleted_term(key: str, tmp_path: Path) -> None:
    model, term = TASKS[key]
    assert term is not None
    found = candidates(model.source(term), tmp_path)
    named = [id_ for id_ in found if any(fnmatchcase(id_, pattern) for pattern in term.expected)]
    assert named
    free = real_trial.tomllib.loads(model.configuration(term))["parameters"]
    assert set(free) == set(model.free) - set(term.without)


def test_there_are_forty_tasks_and_a_complete_model_of_every_rig() -> None:
    rigs = {case.model or name for name, case in real_trial.cases().items()}
    assert {name for name in rigs if not name.startswith(("aero", "drives"))} <= set(MODELS)
    assert sum(term is not None for _, term in TASKS.values()) >= 40


def row(key: str, named: list[str], after: float = 2.0, task: str = "deleted") -> dict[str, object]:
    return {
        "key": key, "code": "0", "seconds": 3.0, "named": named, "equivalent": [["coulomb_friction@w", "offset@w"]],
        "before": {"train": {"w": 1.0}, "test": {"w": after}}, "task": task,
    }  # fmt: skip


def test_the_summary_counts_what_is_right_by_class_and_what_a_term_matters() -> None:
    rows = [
        row("motor", [], 1.0, "complete"),
        row("drives", ["lag@u"], 1.0, "complete"),
        row("motor-friction", ["offset@w"]),
        row("motor-viscous", ["curve@w"], 1.1),
        row("drives-sign", ["unsigned@y", "overflow@m"]),
        row("drives-damping", []),
    ]
    found = real_trial.summary([{**one, **real_trial.judged(one, *TASKS[one["key"]])} for one in rows])
    quarter = dict.fromkeys(("right", "place_right", "false", "missed"), 0.25)
    assert found["deleted"] == {"tasks": 4, **quarter}
    assert found["complete"] == {"tasks": 2, "named": 0.5}
    assert found["deleted_material"]["tasks"] == 3
    assert found["seconds_median"] == 3.0
    assert len(found["rows"]) == 6
    failed = {"key": "motor-friction", "code": "0", "seconds": 1.0, "error": "stopped", "task": "deleted"}
    failed |= real_trial.judged(failed, *TASKS["motor-friction"])
    assert real_trial.summary([failed])["deleted"]["missed"] == 1.0
    assert "stopped" in real_trial.table(real_trial.summary([failed]))


def test_the_report_has_the_keys_that_others_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = MODELS["motor"].case
    for file in (*case.train, *case.test):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).touch()
    kept = {"motor": row("motor", [], 1.0, "complete"), "motor-friction": row("motor-friction", ["offset@w"])}
    (tmp_path / "real_trial").mkdir()
    for key, one in kept.items():
        (tmp_path / "real_trial" / f"{key}.json").write_text(json.dumps(one), encoding="utf-8")
    command = ["real_trial.py", "--table", "--only", "motor", "--recordings", str(tmp_path), "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", command)
    real_trial.main()
    found = json.loads((tmp_path / "real_trial.json").read_text(encoding="utf-8"))
    assert set(found) == {"deleted", "deleted_material", "complete", "seconds_median", "rows", "left"}
    rates = {"right": 1.0, "place_right": 0.0, "false": 0.0, "missed": 0.0}
    assert found["deleted"] == {"tasks": 1, **rates}
    assert found["complete"] == {"tasks": 1, "named": 0.0}
    assert found["seconds_median"] == 3.0
    assert [one["verdict"] for one in found["rows"]] == ["silent", "right"]
    assert found["left"] == len(TASKS) - 2


def test_an_edit_that_does_not_stand_in_the_model_is_refused() -> None:
    gone = real_trial.Term((("no such text", ""),), ("offset@w",))
    with pytest.raises(ValueError, match="0 times"):
        MODELS["motor"].source(gone)
    kept = real_trial.Term((), ("offset@w",), ("B",))
    with pytest.raises(ValueError, match="B is used"):
        MODELS["motor"].source(kept)

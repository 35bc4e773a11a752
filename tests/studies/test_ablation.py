"""The ablation of the search: its fixed list of trials, what is left out, how rates and changes are counted."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from pathlib import Path

import pytest
from facts import facts

import ablation
from ablation_table import good, summarise, table
from rig_trial import Answer
from simulated_rigs import rig_kinds

pytestmark = pytest.mark.long


def test_the_list_is_fixed_and_its_beginning_balanced() -> None:
    tasks = ablation.trials()
    assert Counter(task.what for task in tasks) == ablation.COUNTS
    assert Counter(task.what for task in tasks[:20]) == {what: n // 2 for what, n in ablation.COUNTS.items()}
    assert {task.rig for task in tasks if task.what == "law"} == set(rig_kinds())
    assert len({task.key for task in tasks}) == 40
    first = ablation.ablations(("beam", "curve"), 20)
    assert [one.part for one in first[::10]] == ["", "beam", "curve"] * 2
    assert len({one.key for one in first}) == 60


def test_what_is_left_out_is_said_in_the_configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[object] = []

    def program(folder: Path) -> Answer:
        said.append(tomllib.loads((folder / "rig.toml").read_text(encoding="utf-8")).get("loop"))
        return Answer("adequate")

    monkeypatch.setattr(ablation, "close_loop_by_command", program)
    for part in ("", "beam"):
        (tmp_path / "rig.toml").write_text('[model]\nname = "Rig"\n', encoding="utf-8")
        ablation.close_without(tmp_path, part)
    assert said == [None, {"leave_out": ["beam"]}]


def row(part: str, what: str, number: int, *found: str) -> dict[str, object]:
    ids = {"law": [["lag@u"]], "pair": [["lag@u"], ["gain@y"]], "none": [], "outside": [[]]}[what]
    return {
        "key": f"{part or 'nothing'}/{what}/{number}", "trial": f"{what}/{number}", "part": part, "code": "0",
        "what": what, "ids": ids, "truth": [{"law": "fade", "named": ""} for _ in ids], "outcome": "adequate",
        "found": [{"id": one, "kind": "catalogue", "port": one.partition("@")[2]} for one in found],
        "equivalent": [], "seconds": 10.0,
    }  # fmt: skip


def test_rates_changes_and_their_errors() -> None:
    whole = [row("", "law", k, "lag@u") for k in range(4)] + [row("", "none", 0), row("", "outside", 0, "gain@y")]
    without = [row("beam", "law", k, *(["lag@u"] if k else [])) for k in range(4)]
    without += [row("beam", "none", 0), row("beam", "outside", 0), row("beam", "pair", 0, "lag@u", "gain@y")]
    idle = [row("curve", str(one["what"]), k, "lag@u") for k, one in enumerate(whole[:4])]
    failed = {"key": "beam/x", "trial": "x", "part": "beam", "code": "0", "error": "stopped"}
    summary = summarise([*whole, *without, *idle, failed])
    nothing, beam, curve = summary["parts"]
    assert nothing["right_law"] == {
        "trials": 4, "rate": 1.0, "standard_error": 0.0, "change": {"by": 0.0, "standard_error": 0.0}
    }  # fmt: skip
    assert beam["trials"] == 6
    assert beam["right_law"]["rate"] == 0.75
    assert beam["right_law"]["standard_error"] == pytest.approx((0.75 * 0.25 / 4) ** 0.5)
    assert beam["right_law"]["change"] == {"by": -0.25, "standard_error": pytest.approx((0.1875 / 4) ** 0.5)}
    assert [one["right"] for one in beam["changed"]] == [[True, False], [False, True]]
    assert beam["matters"]
    assert not curve["matters"]
    assert good(row("", "pair", 0, "gain@y", "lag@u"))
    assert not good(row("", "pair", 0, "lag@u"))
    text = table(summary)
    assert "| `beam` | 6 | 75 ± 22 | 0 ± 0 | - | 0 ± 0 | 10.0 | 1 | 1 |" in text
    assert re.search(facts("`curve`"), text)
    assert re.search(facts("law/0", "lag@u", "adequate", "lost"), text)
    assert "failed: beam/x: stopped" in text

"""The page of results says what was measured, and what was not run."""

from __future__ import annotations

import json
from pathlib import Path

from results import MARKS, page, readme
from study import real
from study.study import Row


def row(key: str, **after: dict[str, float]) -> Row:
    """A rig of which no effect was found."""
    return {"key": key, "effects": [], "equivalent": [], "before": {"test": {"angle": 0.2}}, "after": after}


def test_studies_that_were_not_run_are_said_to_be(tmp_path: Path) -> None:
    text = page(tmp_path)
    assert text.count("not run") == 7
    assert len(text.splitlines()) <= 80
    summary = {**real.case_summary([row("servo")]), "left": 3, "code": ["abc"]}
    (tmp_path / "real_rigs.json").write_text(json.dumps(summary), encoding="utf-8")
    (tmp_path / "bench.json").write_text(json.dumps({"engine_over_fmpy_me": 600.0}), encoding="utf-8")
    text = page(tmp_path)
    assert "| servo | nothing | missed | 0.2 → - |" in text
    assert "| ≥ 500 | 600 |" in text
    assert text.count("not run") == 5


def test_the_readme_keeps_its_table_until_there_is_a_new_one() -> None:
    text = f"above\n{MARKS[0]}old\n{MARKS[1]}below\n"
    assert readme(text, None) == text
    new = readme(text, real.case_summary([row("battery", test={"angle": 0.1})]))
    assert new.startswith(f"above\n{MARKS[0]}| rig ")
    assert "| battery | nothing | 0.2 → 0.1 |" in new
    assert new.endswith(f"{MARKS[1]}below\n")
    assert "old" not in new


def test_readme_has_the_marks() -> None:
    text = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    assert text.index(MARKS[0]) < text.index(MARKS[1])

"""The page of a run: whole, self-contained, and silent in a real browser."""

from __future__ import annotations

from pathlib import Path

import pytest
from report_runs import write_run

from aero_bayes.errors import InputError
from aero_bayes.report import write_report


@pytest.mark.parametrize("kind", ["fit", "posterior", "loop"])
def test_page_is_written_beside_the_run(kind: str, tmp_path: Path) -> None:
    page = write_report(write_run(tmp_path / kind, kind, rows=3001))
    assert page == tmp_path / kind / "report.html"
    assert page.read_text(encoding="utf-8").rstrip().endswith("</html>")


def test_directory_without_a_result_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no result.json"):
        write_report(tmp_path)
    assert list(tmp_path.iterdir()) == []

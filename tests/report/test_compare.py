"""Runs side by side."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from aero_bayes.cli import main
from aero_bayes.errors import InputError
from aero_bayes.report.compare import write_comparison


@pytest.fixture(scope="module")
def page(runs: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    out = tmp_path_factory.mktemp("c") / "c.html"
    return write_comparison([runs / "loop", runs / "posterior"], out).read_text("utf-8")


def rows_of(page: str) -> dict[str, list[str]]:
    """Cells of the table by the first of their row: unit, runs, how far apart."""
    (table,) = re.findall(r"<table>.*?</table>", page, re.DOTALL)
    cells = [[re.sub(r"<[^>]*>", "", cell) for cell in re.findall(r"<t[dh][^>]*>.*?</t[dh]>", row)]
             for row in re.findall(r"<tr.*?</tr>", table)]  # fmt: skip
    return {row[0]: row[1:] for row in cells[1:]}


def test_errors_are_those_of_the_series_and_only_what_differs_is_listed_of_the_settings(runs: Path, page: str) -> None:
    shown = rows_of(page)
    for kind, told in zip(("loop", "posterior"), shown["error of θtrain"][1:], strict=False):
        with np.load(runs / kind / "series.npz") as series:
            left = series["measured/train/theta"] - series["fitted/train/theta"]
        assert float(told) == pytest.approx(float(np.sqrt(np.mean(left**2))), rel=6e-3)
    assert shown["command"] == ["", "close-loop", "posterior", ""]
    results = [json.loads((runs / kind / "result.json").read_text("utf-8")) for kind in ("loop", "posterior")]
    settings = [result["settings"] for result in results]
    assert settings[0]["parameters"] != settings[1]["parameters"]
    assert any(key.startswith("parameters.K_sp") for key in shown)
    assert settings[0]["fit"] == settings[1]["fit"]
    assert not any(key.startswith(("fit.", "versions.", "seed")) for key in shown)
    for cell, result in zip(shown["verdict"][1:3], results, strict=True):
        assert result["verdict"]["text"][:12] in cell


@pytest.mark.parametrize(("out", "page"), [("page.html", "page.html"), ("both", "both/compare.html")])
def test_the_command_names_what_it_wrote(runs: Path, tmp_path: Path, out: str, page: str) -> None:
    given = ["compare", str(runs / "loop"), str(runs / "posterior"), "--out", str(tmp_path / out)]
    result = CliRunner().invoke(main, given)
    assert result.exit_code == 0, result.output
    assert (tmp_path / page).is_file()
    assert str(tmp_path / page) in result.output.replace("\n", "")


def test_runs_of_one_name_are_told_apart_and_one_run_alone_is_refused(runs: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name / "run").mkdir(parents=True)
        shutil.copy(runs / "loop" / "result.json", tmp_path / name / "run")
    page = write_comparison([tmp_path / "a" / "run", tmp_path / "b" / "run"], tmp_path / "p.html").read_text("utf-8")
    assert "a/run against b/run" in page
    assert "command" not in rows_of(page)  # all settings are the same
    with pytest.raises(InputError, match="expected 2 to 6"):
        write_comparison([runs / "loop"], tmp_path / "q.html")
    with pytest.raises(InputError, match="given twice"):
        write_comparison([runs / "loop", runs / "loop"], tmp_path / "q.html")
    assert not (tmp_path / "q.html").exists()

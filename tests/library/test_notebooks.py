"""The notebooks run from top to bottom, and find what they say."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

EXAMPLES = Path(__file__).parents[2] / "examples"
#: What each must say at its end.
FINDS = {
    "cart/posterior.ipynb": "RecordingPrediction of test",
    "cart/fmu.ipynb": "RunDirectory fmu, fit of Given",
}
#: The same of those that make test-long runs: what the README's example finds, and four other kinds of rigs.
FINDS_LONG = {
    "cart/effect.ipynb": "coulomb_friction@v: F_c = 0.40",
    "battery/battery.ipynb": "'R1': '0.0149 Ohm'",
    "play/play.ipynb": "backlash@w1-w2 {'k_b': '29.",  # made with 30
    "room/room.ipynb": "lag@P lowers the error of T",
    "tank/tank.ipynb": "root_loss@h {'k_h': '0.0008",
}


def test_every_notebook_is_run():
    assert {path.relative_to(EXAMPLES).as_posix() for path in EXAMPLES.glob("*/*.ipynb")} == {*FINDS, *FINDS_LONG}


@pytest.mark.parametrize("name", [*FINDS, *(pytest.param(name, marks=pytest.mark.long) for name in FINDS_LONG)])
def test_a_notebook_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    source = EXAMPLES / name
    book = nbformat.read(source, as_version=4)
    nbformat.validate(book)
    assert all(not cell.get("outputs") for cell in book.cells), "outputs are to be stripped"
    folder = shutil.copytree(source.parent, tmp_path / "here", ignore=shutil.ignore_patterns("out*"))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    NotebookClient(book, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(folder)}}).execute()
    outputs = [output for cell in book.cells for output in cell.get("outputs", [])]
    assert (FINDS | FINDS_LONG)[name] in "".join(text(output) for output in outputs)
    for cell in book.cells:
        pictures = ["image/svg+xml" in output.get("data", {}) for output in cell.get("outputs", [])]
        assert sum(pictures) == (".plot" in cell.source.strip().splitlines()[-1]), cell.source


def text(output: Any) -> str:
    """Printed or shown."""
    return str(output.get("text", "")) + str(output.get("data", {}).get("text/plain", ""))

"""result.json as the program writes it, against the classes that describe it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from aero_bayes.report.results import write_result
from aero_bayes.report.schema_run import RunJson

pytestmark = pytest.mark.fast


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["loop", "posterior"])
def test_every_key_that_a_run_writes_is_declared_and_read_back_unchanged(runs: Path, kind: str, tmp_path: Path) -> None:
    written = json.loads((runs / kind / "result.json").read_text("utf-8"))
    RunJson.model_validate(written, extra="forbid")
    write_result(tmp_path, written)
    assert json.loads((tmp_path / "result.json").read_text("utf-8")) == written


def test_a_key_that_no_class_names_is_kept() -> None:
    result = RunJson.model_validate({"loop": {"outcome": "adequate", "new": 1}, "odd": 3})
    told = result.model_dump(exclude_unset=True)
    assert (told["loop"]["new"], told["odd"]) == (1, 3)


def test_the_writer_refuses_what_readers_would_trip_over(tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match="status"):
        write_result(tmp_path, {"parameters": {"R": {"value": 1.0, "status": "fine"}}})
    assert list(tmp_path.iterdir()) == []


def test_what_is_not_finite_is_written_as_null(tmp_path: Path) -> None:
    write_result(tmp_path, {"parameters": {"R": {"value": np.float64("nan"), "sd": float("inf"), "unit": "V"}}})
    text = (tmp_path / "result.json").read_text("utf-8")
    assert json.loads(text)["parameters"]["R"] == {"value": None, "sd": None, "unit": "V"}

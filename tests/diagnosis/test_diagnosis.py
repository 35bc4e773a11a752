"""The frame of a diagnosis: its order, what it blames, and where it is told."""

from __future__ import annotations

import heated_room
import pytest

import aero_bayes
from aero_bayes.estimate.diagnosis import CAUSES, Diagnosis, DiagnosisRow
from aero_bayes.plain import plain
from aero_bayes.report.schema_run import RunJson, VerdictJson
from aero_bayes.report.words import verdict

pytestmark = pytest.mark.fast


def judged(diagnosis: Diagnosis) -> VerdictJson:
    return verdict(RunJson.model_validate({"diagnosis": plain(diagnosis.rows)}))


def test_a_fit_without_a_fault_is_clear(room: aero_bayes.Model) -> None:
    found = heated_room.fit(heated_room.recording(), room)
    assert tuple(row.cause for row in found.diagnosis) == CAUSES
    assert found.diagnosis.first is None
    assert judged(found.diagnosis).level == "good"
    assert [row["cause"] for row in found.to_dict()["diagnosis"]] == list(CAUSES)  # type: ignore[attr-defined]


def test_the_model_is_blamed_for_a_loss_that_it_lacks(room: aero_bayes.Model) -> None:
    found = heated_room.fit(heated_room.recording(loss=lambda x: 9.0 * x * abs(x)), room)
    assert [row.cause for row in found.diagnosis if row.found] == ["model"]
    assert "misses something" in judged(found.diagnosis).text


@pytest.mark.parametrize("cause", CAUSES[:-1])
def test_the_model_is_blamed_last(cause: str) -> None:
    rows = tuple(DiagnosisRow(c, c in (cause, "model"), f"Something of the {c}.", explains=True) for c in CAUSES)
    diagnosis = Diagnosis(rows)
    assert diagnosis.first is not None
    assert diagnosis.explanation is not None
    assert (diagnosis.first.cause, diagnosis.explanation.cause) == (cause, cause)
    text = judged(diagnosis).text
    assert f"Something of the {cause}" in text
    assert "misses something" not in text


def test_a_fault_that_was_mended_explains_nothing_that_is_left() -> None:
    rows = tuple(DiagnosisRow(c, c in ("data", "model"), "A sentence.", explains=c == "model") for c in CAUSES)
    assert Diagnosis(rows).explanation is None

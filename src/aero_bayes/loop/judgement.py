"""The models before and after a loop, judged by each recording on its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aero_bayes.check.recording_errors import JudgedPart, RecordingError, recording_errors

if TYPE_CHECKING:
    from aero_bayes.loop.result import LoopResult


def errors_by_recording(loop: LoopResult) -> tuple[RecordingError, ...]:
    """Return the errors of a loop's models on each recording, with what was fitted of it apart from what was not."""
    known = loop.recordings
    if known is None:
        return ()
    parts = known.unseen_from
    fitted: list[JudgedPart] = [(r, "train", None, parts.get(r.name)) for r in known.train]
    unseen: list[JudgedPart] = [(r, "test", parts[r.name], None) for r in known.train if r.name in parts]
    unseen += [(r, "test", None, None) for r in known.test]
    before, after = loop.predicted_before.fitted, loop.predicted_after.fitted
    return recording_errors([*fitted, *unseen], before, after, loop.floors, loop.noise)

"""A disturbance that belongs to a moment and not to a state."""

from __future__ import annotations

import math
from collections.abc import Sequence

from aero_bayes.check.residual_tests import ResidualReport, structured_residuals


def find_disturbance(reports: Sequence[ResidualReport], share: float = 0.8) -> tuple[str, float, float] | None:
    """Recording, start and end in s of a disturbance: a tenth of the recording has most of the squared residual."""
    structured = [r for r in structured_residuals(reports) if r.worst_share > share and math.isfinite(r.ratio)]
    if not structured:
        return None
    worst = max(structured, key=lambda r: r.worst_share)
    return worst.recording, *worst.worst_time

"""Starting points that are looked for once, also in a loop that was interrupted and resumed."""

from __future__ import annotations

import numpy as np

from aero_bayes.checkpoint import Arrays, pack_all, unpack_all
from aero_bayes.estimate.climb import ClimbSettings
from aero_bayes.loop import starting
from aero_bayes.physics.kin import Candidate


def starting_points(
    around: starting.Around, candidate: Candidate, steps: ClimbSettings, least: float = 0.0
) -> list[starting.Start]:
    """See :func:`.starting.starting_points`."""

    def look() -> Arrays:
        return pack_all(starting.starting_points(around, candidate, steps, least))

    asked = *_asked(around, candidate), steps, least
    return unpack_all(starting.Start, around.study.once("starts", asked, look))


def promised(around: starting.Around, candidate: Candidate) -> float:
    """See :func:`.starting.promised`."""

    def look() -> Arrays:
        return {"most": np.array(starting.promised(around, candidate))}

    return float(around.study.once("promise", _asked(around, candidate), look)["most"])


def _asked(around: starting.Around, candidate: Candidate) -> tuple[object, ...]:
    return around.base.coordinates, around.base.free, around.base.noise, candidate

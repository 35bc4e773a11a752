"""Angles that jump by a whole turn, since an encoder counts modulo one turn."""

from __future__ import annotations

import math

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.data.runs import Rows

#: A whole turn by unit of an angle.
TURNS = {"rad": 2.0 * math.pi, "deg": 360.0, "rev": 1.0}
#: A step of more than this share of a turn is a jump; all others must be shorter than the second share.
MIN_JUMP, MAX_STEP = 0.6, 0.4
#: Largest range of an angle that is counted modulo a turn, in turns.
MAX_RANGE = 1.05


def wrapped_rows(values: FloatArray, unit: str) -> Rows:
    """Find rows at which an angle jumps by a whole turn; none for another quantity or an angle that does not wrap."""
    turn = TURNS.get(unit)
    at = np.flatnonzero(np.isfinite(values))
    if turn is None or at.size < 3 or np.ptp(values[at]) > MAX_RANGE * turn:
        return np.empty(0, dtype=np.intp)
    steps = np.abs(np.diff(values[at]))
    jumps = steps > MIN_JUMP * turn
    if not jumps.any() or np.quantile(steps[~jumps], 0.99, method="higher") > MAX_STEP * turn:
        return np.empty(0, dtype=np.intp)
    # A single outlier jumps there and back; a turn is not taken back at the next reading.
    return np.asarray(at[1:][jumps], dtype=np.intp)


def unwrapped(values: FloatArray, unit: str) -> FloatArray:
    """Return the angle without its jumps of a whole turn, gaps left out; radians where the unit is no angle's."""
    found = values.copy()
    seen = np.isfinite(values)
    found[seen] = np.unwrap(values[seen], period=TURNS.get(unit, TURNS["rad"]))
    return found

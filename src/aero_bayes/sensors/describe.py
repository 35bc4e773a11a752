"""What sensors add that is neither white nor slow: ripple locked to the rotor, and the counts of an encoder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aero_bayes.sensors.quantisation import Quantisation, describe_quantisation, quantum
from aero_bayes.sensors.ripple import Ripple

FloatArray = NDArray[np.float64]
Json = dict[str, Any]

#: Share of the residual's variance below which quantisation is not reported.
MIN_VARIANCE_SHARE = 1e-3


def describe_sensors(
    outputs: Sequence[str],
    recordings: Sequence[tuple[FloatArray, FloatArray, FloatArray]],
    ripple: Mapping[str, Mapping[str, Ripple]],
    *,
    subtracted: bool,
) -> dict[str, Json]:
    """What a fit shows of its sensors, by output, as result.json takes it.

    Parameters
    ----------
    outputs : sequence of str, length m
    recordings : sequence of (time (n,), readings (n, m), fitted (n, m))
    ripple : mapping of str to mapping of str to Ripple
        What was found, by recording and output.
    subtracted : bool
        Whether the fit is to readings without it.

    Returns
    -------
    dict
        For each output that shows either: ``ripple`` by recording (amplitude and log-evidence of each order, noise with
        and without it), and ``encoder`` (quantum, what rounding adds, and whether the exact likelihood of counts would
        say more than a Gaussian) of the first recording that is read in counts.
    """
    table: dict[str, Json] = {}
    for column, output in enumerate(outputs):
        entry: Json = {}
        found = {name: by[output].to_dict() for name, by in ripple.items() if output in by}
        if found:
            entry["ripple"], entry["ripple_subtracted"] = found, subtracted
        counts = next((c for t, y, f in recordings if (c := _counts(t, y[:, column], f[:, column]))), None)
        if counts is not None:
            entry["encoder"] = counts.to_dict()
        if entry:
            table[output] = entry
    return table


def _counts(time: FloatArray, readings: FloatArray, fitted: FloatArray) -> Quantisation | None:
    step = quantum(readings)
    if step == 0.0 or step**2 / 12.0 < MIN_VARIANCE_SHARE * float(np.nanmean((readings - fitted) ** 2)):
        return None
    return describe_quantisation(time, readings, fitted)

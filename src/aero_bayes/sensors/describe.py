"""Ripple and quantisation of outputs, as a fit shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.sensors.quantisation import Quantisation, describe_quantisation, quantum
from aero_bayes.sensors.ripple import Ripple

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
    """Describe ripple and quantisation by output, as they go into result.json."""
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

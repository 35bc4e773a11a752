"""Quantisation of outputs, as a fit shows it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.sensors.quantisation import Quantisation, describe_quantisation, quantum

Json = dict[str, Any]

#: Share of the residual's variance below which quantisation is not reported.
MIN_VARIANCE_SHARE = 1e-3


def describe_sensors(
    outputs: Sequence[str], recordings: Sequence[tuple[FloatArray, FloatArray, FloatArray]]
) -> dict[str, Json]:
    """Describe quantisation by output, as it goes into result.json; times, readings and fit of each recording."""
    found = {
        output: next((c for t, y, f in recordings if (c := _counts(t, y[:, k], f[:, k]))), None)
        for k, output in enumerate(outputs)
    }
    return {output: {"encoder": counts.to_dict()} for output, counts in found.items() if counts is not None}


def _counts(time: FloatArray, readings: FloatArray, fitted: FloatArray) -> Quantisation | None:
    step = quantum(readings)
    if step == 0.0 or step**2 / 12.0 < MIN_VARIANCE_SHARE * float(np.nanmean((readings - fitted) ** 2)):
        return None
    return describe_quantisation(time, readings, fitted)

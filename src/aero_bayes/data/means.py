"""Columns that are means over the interval before or after their time, as meters and energy loggers write them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from aero_bayes.data.recording import Recording

Stamp = Literal["beginning", "end"]


def with_means(recording: Recording, stamps: Mapping[str, Stamp]) -> Recording:
    """Return the recording with some columns as means over the interval that begins or ends at their time.

    An input is moved to where its interval begins, from where it holds. Of an output, the mean is lost whose interval
    reaches beyond the recording."""
    inputs, outputs, means = dict(recording.inputs), dict(recording.outputs), dict(recording.means)
    for name, stamp in stamps.items():
        if name in inputs and stamp == "end":
            inputs[name] = np.concatenate([inputs[name][1:], inputs[name][-1:]])
        elif name in outputs:
            means[name] = stamp
            outputs[name] = outputs[name].copy()
            outputs[name][0 if stamp == "end" else -1] = np.nan
    return replace(recording, inputs=inputs, outputs=outputs, means=means, sha256="") if stamps else recording

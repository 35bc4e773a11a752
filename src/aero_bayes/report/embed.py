"""Series as the page carries them: every sample, small enough to inline."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping

import numpy as np
from markupsafe import Markup

from aero_bayes.arrays import FloatArray

#: Steps that a series' range is divided into, as a power of two: far below what a sensor resolves.
BITS = 18
_TIME_BITS = 22


def embedded(series: Mapping[str, FloatArray]) -> Markup:
    """Write all series as JSON, safe within a ``<script>`` element."""
    packed = {key: pack_series(values, _TIME_BITS if _increases(values) else BITS) for key, values in series.items()}
    return Markup(json.dumps(packed, separators=(",", ":")).replace("<", "\\u003c"))


def pack_series(values: FloatArray, bits: int = BITS) -> dict[str, object]:
    """Return a series as base64 of deflated byte planes of the differences between whole numbers.

    Zero stands for a gap."""
    size = len(values)
    known = np.isfinite(values)
    low, high = (float(np.min(values[known])), float(np.max(values[known]))) if known.any() else (0.0, 0.0)
    if size > 1 and known.all():
        spacing = (float(values[-1]) - float(values[0])) / (size - 1)
        if np.allclose(values, values[0] + spacing * np.arange(size), rtol=0, atol=1e-4 * abs(spacing)) and spacing:
            return {"n": size, "lo": float(values[0]), "step": spacing, "even": 1}
    step = (high - low) / 2**bits or 1.0
    whole = np.where(known, 1 + np.round((np.nan_to_num(values) - low) / step), 0).astype(np.int64)
    change = np.diff(whole, prepend=0)
    folded = np.where(change < 0, -2 * change - 1, 2 * change).astype(np.uint32)
    planes = np.concatenate([((folded >> shift) & 0xFF).astype(np.uint8) for shift in (0, 8, 16)])
    text = base64.b64encode(zlib.compress(planes.tobytes(), 9)).decode("ascii")
    return {"n": size, "lo": low, "step": step, "ends": [low, high], "d": text}


def _increases(values: FloatArray) -> bool:
    return len(values) > 1 and bool(np.all(np.diff(values) > 0))

"""Costs of a fit: the paper's Eq. 6, the noise-weighted squares, and errors by output."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from aero_bayes.arrays import FloatArray


def eq6(residual: Sequence[FloatArray]) -> float:
    """Sum of squared errors over samples and outputs, unweighted (Podlaski et al., Eq. 6)."""
    return float(sum(np.nansum(r**2) for r in residual))


def rms(residual: FloatArray) -> FloatArray:
    """Compute the root mean square of each output, shape (m,); NaN for an output without readings."""
    count = np.isfinite(residual).sum(axis=0)
    total = np.nansum(residual**2, axis=0)
    return np.asarray(np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan)))


def rms_table(
    residual: Sequence[FloatArray], names: Sequence[str], outputs: Sequence[str]
) -> Mapping[str, Mapping[str, float]]:
    """Compute errors by recording, then output; outputs without readings are left out."""
    return {
        name: {out: float(v) for out, v in zip(outputs, rms(r), strict=True) if np.isfinite(v)}
        for name, r in zip(names, residual, strict=True)
    }


def rms_overall(residual: Sequence[FloatArray], outputs: Sequence[str]) -> dict[str, float]:
    """Compute errors by output over all recordings."""
    values = rms(np.concatenate(list(residual)))
    return {out: float(v) for out, v in zip(outputs, values, strict=True) if np.isfinite(v)}

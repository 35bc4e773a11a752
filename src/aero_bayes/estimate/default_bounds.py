"""Bounds of a parameter where the user gives none: what the model says, else far from the start."""

from __future__ import annotations

import math

#: Default bounds of a parameter: its start over and times this factor.
DEFAULT_BOUND_FACTOR = 1e3
#: A model's lower bound below this share of the start only says that the parameter is positive.
MIN_BOUND_RATIO = 1e-12


def model_bound(bound: float | None, start: float) -> float | None:
    """Return a bound that the model gives; a tiny one (``Modelica.Constants.small``) counts as zero."""
    return 0.0 if bound is not None and abs(bound) < MIN_BOUND_RATIO * abs(start) else bound


def default_bounds(
    start: float, lower: float | None, upper: float | None, nominal: float | None
) -> tuple[float, float]:
    """Return bounds as given; where there is none, far from the start, without a change of sign."""
    low = lower if lower is not None and math.isfinite(lower) else None
    high = upper if upper is not None and math.isfinite(upper) else None
    if start > 0.0 and (low is None or low == 0.0):
        low = start / DEFAULT_BOUND_FACTOR
    if start < 0.0 and (high is None or high == 0.0):
        high = start / DEFAULT_BOUND_FACTOR
    size = abs(start) or abs(nominal or 0.0) or 1.0
    return (
        low if low is not None else start - DEFAULT_BOUND_FACTOR * size,
        high if high is not None else start + (DEFAULT_BOUND_FACTOR - 1.0) * size,
    )


def first_given(*values: float | None) -> float | None:
    return next((value for value in values if value is not None), None)
